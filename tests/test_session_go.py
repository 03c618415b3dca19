"""Somebody says go, over the wire and in the terminal; it is recorded, and told again the same."""

import os
import select

import pytest
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import MISSION, Pair, Vehicle

from companion.mavlink import preflight
from companion.mavlink.link import Output
from companion.mission.state import Phase
from companion.replay.feed import Feeder
from companion.runtime.terminal import HOW_TO, Terminal
from companion.session import Session


def waiting(phase: Phase = Phase.READY) -> Pair:
    it = Pair(Session(MISSION, seed=1, lockstep=False), Vehicle(lockstep=False))
    return it.fly_to(phase)


def mission_start(it: Pair) -> int:
    """What a ground station is answered."""
    count = len(it.frames)
    it.ask(wire.MAV_CMD_MISSION_START)
    [ack] = [m for m in it.since(count) if m.get_type() == "COMMAND_ACK"]
    return int(ack.result)


def said(it: Pair) -> list[str]:
    return [entry["text"] for entry in it.journal if entry["kind"] == "say"]


def test_mission_start_is_the_go_and_comes_too_early_before_it_is_ready() -> None:
    it = waiting(Phase.PREPARING)
    assert mission_start(it) == wire.MAV_RESULT_TEMPORARILY_REJECTED
    assert said(it)[-1].startswith("start refused: it is not ready: ")
    it.fly_to(Phase.READY).run_for(60.0)
    assert not it.vehicle.armed
    assert sum("waits for go" in text for text in said(it)) == 1
    assert mission_start(it) == wire.MAV_RESULT_ACCEPTED
    it.run_until(lambda it: it.vehicle.armed, 30.0)


@pytest.mark.parametrize(("fails_s", "stays"), [(4.0, True), (7.0, False)])
def test_a_check_that_fails_for_a_few_seconds_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, fails_s: float, stays: bool
) -> None:
    it = waiting()
    with monkeypatch.context() as patched:
        refused = preflight.Check("battery", preflight.CheckStatus.REFUSED, "made up")
        patched.setattr(preflight, "_battery", lambda _session: refused)
        it.run_for(fails_s)
    assert (it.phase is Phase.READY) is stays
    assert any("battery: made up" in text for text in said(it)) is not stays


def test_a_go_is_an_input_and_the_flight_is_told_again_as_it_was() -> None:
    it = waiting()
    assert it.session.say_go() == ""
    it.take(it.session.run())
    it.run_until(lambda it: it.vehicle.armed, 30.0)
    told = [entry for entry in it.journal if entry.get("sender") == "terminal"]
    assert [entry["kind"] for entry in told] == ["command", "order"]
    feeder, journal = Feeder(lambda _: MISSION), []
    for each in it.inputs:
        output = feeder.take(each)
        journal += output.journal if isinstance(output, Output) else []
    assert journal == it.journal


def test_a_yes_is_typed_and_anything_else_is_told_how() -> None:
    ours, theirs = os.openpty()
    told: list[str] = []
    with os.fdopen(theirs, encoding="utf-8") as stream, Terminal(stream, told.append) as person:
        assert not person.says_go()
        for typed in (b"no\n", b"go\n", b" Yes \n", b"y\n"):
            is_yes = b"y" in typed.lower()
            count = len(told)
            os.write(ours, typed[:1])
            assert not person.says_go()  # the line is not over
            os.write(ours, typed[1:])
            select.select([theirs], (), (), 10.0)
            assert person.says_go() is is_yes
            assert told[count:] == ([] if is_yes else [HOW_TO])
            assert not person.says_go()  # once
        os.write(ours, b"\4")  # Ctrl-D
        select.select([theirs], (), (), 10.0)
        assert not person.says_go()
        os.write(ours, b"yes\n")
        assert not person.says_go()
    os.close(ours)
