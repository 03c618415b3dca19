"""Two sessions with the same ids on one link, and one whose link sends back what it says."""

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import MISSION, Pair, Vehicle, messages

from companion.mission import checkpoint
from companion.mission.events import Outcome
from companion.mission.state import Phase, Reason
from companion.session import Session

OURS = replace(MISSION, system_id=1)
COMMANDS = ("COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_GLOBAL_INT")
ASKS = (wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE)


def session(**keywords: Any) -> Session:
    return Session(OURS, seed=1, lockstep=False, go=True, **keywords)


class Bus:
    """A vehicle and its companions, each of whom hears all the others."""

    def __init__(self, *, reflects: int = 0) -> None:
        self.vehicle = Vehicle(lockstep=False)
        self.pairs: list[Pair] = []
        self.reflects, self.ticks = reflects, 0

    def joins(self, one: Session) -> Pair:
        self.pairs.append(Pair(one, self.vehicle))
        return self.pairs[-1]

    def tick(self) -> None:
        self.ticks += 1
        said = self.vehicle.tick()
        for pair in list(self.pairs):
            count = len(pair.frames)
            pair.feed(said)
            if pair.asked is not None and pair.out.plan is not None:
                pair.session.deliver(pair.planner(pair.asked))
            self.carry(pair, pair.frames[count:])

    def carry(self, speaker: Pair, frames: list[bytes]) -> None:
        for pair in self.pairs:
            if pair is not speaker and pair.out.end is None:
                pair.feed(b"".join(frames))
        for _ in range(self.reflects):
            speaker.feed(b"".join(frames))

    def run(self, seconds: float) -> "Bus":
        for _ in range(round(seconds * 10)):
            self.tick()
        return self

    def flying(self) -> Pair:
        """The first, on its way."""
        first = self.joins(session())
        while first.session.state.leg is None:
            assert self.ticks < 3000, first.phase
            self.tick()
        return first


def warned(it: Pair, text: str = Reason.NOT_ALONE.text) -> list[float]:
    """When people were told."""
    says = [entry for entry in it.journal if entry["kind"] == "say" and entry["warning"]]
    return [entry["t_s"] for entry in says if text in entry["text"]]


def commanded(it: Pair) -> list[Any]:
    """What moves or changes the vehicle; not what only asks it."""
    said = (message for message in messages(it.frames) if message.get_type() in COMMANDS)
    return [each for each in said if getattr(each, "command", 0) not in ASKS]


@pytest.mark.parametrize("reflects", [1, 2])
def test_a_link_that_sends_back_what_we_say_is_no_second_companion(reflects: int) -> None:
    bus = Bus(reflects=reflects)
    it = bus.flying()
    bus.run(20.0)
    assert it.session.state.phase is Phase.FLYING
    assert warned(it) == []
    assert not it.session.state.duplicate_id
    assert len(messages(it.frames)) > 300


@pytest.mark.parametrize("same_folder", [False, True])
def test_the_one_that_came_second_ends_in_the_air_and_the_first_flies_on(same_folder: bool) -> None:
    """Also one that has the path of the first, from the same run folder."""
    bus = Bus()
    first = bus.flying()
    bus.run(3.0)
    values = {"system_id": 1, **checkpoint.values_of(first.session.state)}
    resume = (values, first.session.state.flight.known) if same_folder else None
    second = bus.joins(session(resume=resume))
    bus.run(30.0)
    assert (second.end.outcome, second.end.reason) == (Outcome.FAILED, Reason.NOT_ALONE.text)
    assert commanded(second) == []
    assert len(warned(first)) == 1
    assert "another companion" in [entry["kind"] for entry in first.journal]
    assert Reason.NOT_ALONE.text in "".join(m.text for m in first.sent("STATUSTEXT"))
    assert first.session.warned[1].startswith(Reason.NOT_ALONE.text)
    assert first.session.state.phase is Phase.FLYING
