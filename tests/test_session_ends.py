"""Every end is said on the link before the heartbeat ends, by name and with its reason."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache

import pytest
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import BRAKE, LAND, MISSION, Pair, Vehicle, messages

from companion.mission.events import Outcome
from companion.mission.mission import EndAction
from companion.mission.phases import Phase, Trigger
from companion.mission.state import Reason
from companion.session import Session

PHASES = (Phase.WAITING, Phase.PREPARING, Phase.ARMING, Phase.TAKING_OFF, Phase.FLYING)
PHASES += (Phase.HOLDING, Phase.ARRIVED)
"""That a scripted vehicle comes through by itself, or by one order."""


def texts(frames: list[bytes]) -> list[str]:
    """What a ground station shows: chunks put together."""
    said = [message for message in messages(frames) if message.get_type() == "STATUSTEXT"]
    whole = "".join(f"{'' if message.chunk_seq else chr(0)}{message.text}" for message in said)
    return whole.split("\0")[1:]


@cache
def flown_to(phase: Phase) -> Pair:
    of = replace(MISSION, end_action=EndAction.HOLD)
    it = Pair(Session(of, seed=1, lockstep=True), Vehicle())
    if phase is Phase.HOLDING:
        it.fly_out().ask(wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    return it if phase is Phase.WAITING else it.fly_to(phase)


ENDS: dict[str, tuple[Trigger, Callable[[Session], object], Outcome, str]] = {
    "a person": (Trigger.STOP, lambda it: it.stop(), Outcome.STOPPED, Reason.STOPPED.text),
    "a part": (
        *(Trigger.DIED, lambda it: it.part_died("writer", "OSError: made up"), Outcome.FAILED),
        f"{Reason.PLANNER_DIED.text}: writer: OSError: made up",
    ),
    "silence": (Trigger.GIVE_UP, lambda it: it.silence(700.0), Outcome.FAILED, ""),
}


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("end", ENDS)
def test_whatever_ends_it_in_whatever_phase(end: str, phase: Phase) -> None:
    """The last text names the end, and goes out with the very output that tells of it.

    Led in the air it is left holding, and settled when it says so.
    """
    it, (trigger, ends, outcome, why) = deepcopy(flown_to(phase)), ENDS[end]
    assert phase in trigger.origins
    ends(it.session)
    out = it.take(it.session.run())
    assert (it.end.outcome, it.end.reason) == (outcome, why or it.end.reason)
    assert ("part died" in it.kinds()) is (end == "a part")
    last = texts(out.frames)[-1]
    assert last.startswith(f"ended, {it.end.outcome.value}: {it.end.reason}"[:190])
    count, is_led = len(it.frames), phase is Phase.FLYING and end != "silence"
    it.session.complain("refused: 7 unsigned")
    assert not (is_led and out.settled)
    it.run_for(10.0).take(it.session.farewell())
    assert texts(it.frames[count:]) == []
    assert not is_led or (it.out.settled and it.vehicle.mode == BRAKE)


@pytest.mark.parametrize("phase", [Phase.FLYING, Phase.LANDING])
def test_who_lands_it_in_the_moment_of_the_end_is_not_overruled(phase: Phase) -> None:
    """But a landing of ours, which a person has broken off, is told to stop until it does."""
    it = deepcopy(flown_to(Phase.FLYING))
    if phase is Phase.LANDING:
        it.ask(wire.MAV_CMD_NAV_LAND)
        it.fly_to(phase)
    it.vehicle.deaf_to = {wire.MAV_CMD_DO_SET_MODE}
    it.session.stop()
    it.take(it.session.run())
    it.vehicle.mode = LAND
    it.run_until(lambda it: it.vehicle.time_ms % 1000 == 0)  # its heartbeat says so
    count = len(it.frames)
    told = [m for m in it.run_for(4.0).since(count) if m.get_type() == "COMMAND_LONG"]
    holds = [m for m in told if (m.command, m.param2) == (wire.MAV_CMD_DO_SET_MODE, BRAKE)]
    assert bool(holds) == (phase is Phase.LANDING)
