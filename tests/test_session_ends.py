"""Every end is said on the link before the heartbeat ends, by name and with its reason."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache

import pytest
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import BRAKE, LAND, MISSION, Pair, Vehicle, messages, pair

from companion.mission.mission import EndAction
from companion.mission.phases import Phase, Trigger
from companion.planner.request import NotPlanned, PlanOutcome, PlanRequest, Refusal
from companion.session import Session

PHASES = (Phase.WAITING, Phase.PREPARING, Phase.ARMING, Phase.TAKING_OFF, Phase.FLYING)
PHASES += (Phase.HOLDING, Phase.ARRIVED)
"""That a scripted vehicle comes through by itself, or by one order."""


def ended(it: Pair) -> bool:
    return it.out.end is not None


def texts(frames: list[bytes]) -> list[str]:
    """What a ground station shows: chunks put together."""
    said = [message for message in messages(frames) if message.get_type() == "STATUSTEXT"]
    whole = "".join(f"{'' if message.chunk_seq else chr(0)}{message.text}" for message in said)
    return whole.split("\0")[1:]


def in_phase(phase: Phase) -> Pair:
    return deepcopy(flown_to(phase))


@cache
def flown_to(phase: Phase) -> Pair:
    of = replace(MISSION, end_action=EndAction.HOLD)
    it = Pair(Session(of, seed=1, lockstep=True), Vehicle(lockstep=True))
    if phase is Phase.HOLDING:
        it.run_until(lambda it: it.session.state.leg is not None)
        it.ask(wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    if phase is Phase.WAITING:
        return it
    return it.run_until(lambda it: it.session.state.phase is phase)


def must_be_said(it: Pair) -> None:
    """The last text names the end, and went out with the very output that tells of it."""
    end = it.out.end
    assert end is not None
    last = texts(it.frames)[-1]
    assert last.startswith(f"ended, {end.outcome.value}: {end.reason}"[:190]), texts(it.frames)
    assert texts(it.out.frames)[-1] == last
    sent = len(it.frames)
    it.session.complain("refused: 7 unsigned")
    for _ in range(100):
        it.tick()
    it.take(it.session.farewell())
    assert texts(it.frames[sent:]) == []


def stopped(it: Pair) -> None:
    it.session.stop()
    it.take(it.session.run())


def part_dies(it: Pair) -> None:
    it.session.part_died("reader", "OSError: made up")
    it.take(it.session.run())


def falls_silent(it: Pair) -> None:
    it.session.silence(700.0)
    it.take(it.session.run())


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize(
    ("end", "trigger"),
    [(stopped, Trigger.STOP), (part_dies, Trigger.DIED), (falls_silent, Trigger.GIVE_UP)],
    ids=["a person", "a part", "silence"],
)
def test_whatever_ends_it_in_whatever_phase(
    end: Callable[[Pair], None], trigger: Trigger, phase: Phase
) -> None:
    it = in_phase(phase)
    assert phase in trigger.origins
    end(it)
    must_be_said(it)


@pytest.mark.parametrize("phase", [Phase.FLYING, Phase.LANDING])
def test_who_lands_it_in_the_moment_of_the_end_is_not_overruled(phase: Phase) -> None:
    """But a landing of ours, which a person has broken off, is told to stop until it does."""
    it = in_phase(Phase.FLYING)
    if phase is Phase.LANDING:
        it.ask(wire.MAV_CMD_NAV_LAND)
        it.run_until(lambda it: it.session.state.phase is phase)
    it.vehicle.deaf_to = {wire.MAV_CMD_DO_SET_MODE}
    stopped(it)
    it.vehicle.mode = LAND
    it.run_until(lambda it: it.vehicle.time_ms % 1000 == 0)  # its heartbeat says so
    count = len(it.frames)
    for _ in range(40):
        it.tick()
    told = [m for m in messages(it.frames[count:]) if m.get_type() == "COMMAND_LONG"]
    holds = [m for m in told if (m.command, m.param2) == (wire.MAV_CMD_DO_SET_MODE, BRAKE)]
    assert bool(holds) == (phase is Phase.LANDING)


def refuses(request: PlanRequest) -> PlanOutcome:
    return NotPlanned(
        plan_id=request.plan_id, refusal=Refusal.NOTHING_SAFE, broken=("floor",), evaluations=60
    )


def finds_no_plan(it: Pair) -> None:
    it.planner = refuses


def finds_no_way_back(it: Pair) -> None:
    it.run_until(lambda it: it.session.state.leg is not None)
    it.planner = refuses
    it.ask(wire.MAV_CMD_NAV_RETURN_TO_LAUNCH)


@pytest.mark.parametrize(
    ("happens", "said"),
    [
        (finds_no_plan, "failed: landed: no safe subpath was found: it broke floor"),
        (finds_no_way_back, "stopped: landed: told to return"),
    ],
)
def test_an_end_is_said_with_its_outcome_and_its_reason(
    happens: Callable[[Pair], None], said: str
) -> None:
    it = pair()
    happens(it)
    it.run_until(ended)
    assert texts(it.frames)[-1] == f"ended, {said}"
    must_be_said(it)


@pytest.mark.parametrize(
    "kind", [wire.MAV_TYPE_FIXED_WING, wire.MAV_TYPE_VTOL_QUADROTOR, wire.MAV_TYPE_GROUND_ROVER]
)
def test_a_vehicle_that_the_mission_is_not_for(kind: int) -> None:
    it, codec = pair(), wire.MAVLink(None, srcSystem=1, srcComponent=1)
    for _ in range(3):
        it.feed(wire.MAVLink_heartbeat_message(kind, 3, 0, 0, 4, 3).pack(codec))
        codec.seq += 1
    assert ended(it)
    assert "ended, failed: the vehicle is none" in texts(it.out.frames)[-1]
