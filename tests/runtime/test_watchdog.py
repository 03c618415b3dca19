"""What the gate lets through and tells apart; `test_workers` has the watchdog at work."""

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from harness import setpoint
from pymavlink.dialects.v20 import all as wire
from stub_session import HEARTBEAT, HOLD, SETPOINT, SpeakingLink, packed

from companion.runtime.link import is_setpoint
from companion.runtime.watchdog import IDLE_STALL_S, STALL_S, Failure, Gate, Watchdog


def command_int(command: int, *parameters: float) -> bytes:
    four = [*parameters, *[0.0] * (4 - len(parameters))]
    place = (470000000, 80000000, 500.0)
    return packed(wire.MAVLink_command_int_message(1, 1, 5, command, 0, 0, *four, *place))


def test_setpoints_are_told_from_everything_else() -> None:
    leads = [SETPOINT, packed(setpoint((1.0, 2.0, -3.0))), command_int(192), command_int(192, -1.0)]
    other = [HEARTBEAT, HOLD, SETPOINT[:9], command_int(176, 1.0), command_int(192, -1.0, 1.0)]
    assert [is_setpoint(frame) for frame in leads + other] == [True] * 4 + [False] * 5


class Rig:
    """A watchdog, and a clock that goes on when it is told to."""

    def __init__(self, link: SpeakingLink | None = None) -> None:
        self.now_s, self.signings = 100.0, 0
        self.link = link or SpeakingLink(lambda: self.now_s)
        self.gate = Gate(self.link, lambda: self.now_s, self._signed)
        self.failures: list[tuple[Failure, list[bytes]]] = []
        session: Any = SimpleNamespace(hold_frames=lambda: [HOLD], final_text=lambda _why: [])
        self.watchdog = Watchdog(
            *(self.gate, session),
            clock=lambda: self.now_s,
            on_failure=lambda failure, hold: self.failures.append((failure, hold)),
        )

    def _signed(self, frames: list[bytes]) -> list[bytes]:
        self.signings += 1
        return frames

    def frames(self) -> list[bytes]:
        return [frame for _, frame in self.link.sent]


def test_a_link_that_is_stuck_in_the_middle_of_a_frame_does_not_keep_the_hold_back() -> None:
    stuck, released = threading.Event(), threading.Event()

    class Stuck(SpeakingLink):
        def send(self, frames: list[bytes]) -> None:
            if frames == [SETPOINT]:
                stuck.set()
                released.wait()
            super().send(frames)

    rig = Rig(Stuck())
    thread = threading.Thread(target=rig.gate.send, args=([SETPOINT],))
    thread.start()
    stuck.wait()
    rig.gate.shut()
    rig.gate.send_last([HOLD])
    assert rig.frames() == [HOLD]
    released.set()
    thread.join()


@pytest.mark.parametrize(("says", "fails"), [(lambda why: [why.encode()], 0), (None, 1)])
def test_of_a_death_and_no_end_the_hold_is_sent_three_times_and_what_died_is_said_once(
    says: Any, fails: int
) -> None:
    """Of a session that cannot even say so, too; and on if the link fails the first time."""

    class Failing(SpeakingLink):
        def send(self, frames: list[bytes]) -> None:
            if rig.signings <= fails:
                raise OSError("made up")
            super().send(frames)

    rig, ended = Rig(Failing()), threading.Event()
    rig.watchdog._session.final_text = says  # type: ignore[method-assign]
    ended.set()
    rig.watchdog.watch(ended)
    assert (rig.watchdog.failure, rig.signings, rig.gate.is_shut) == (None, 0, False)
    rig.watchdog.died("x")
    for _ in range(2):
        rig.watchdog.watch(ended)
    told = [HOLD, b"the decider has died (x)"] if says else [HOLD]
    assert rig.failures == [(Failure(part="decider", error="x"), told)]
    assert rig.failures[0][0] == rig.watchdog.failure
    assert rig.frames() == [*told * (1 - fails), HOLD, HOLD]
    assert rig.signings == 3  # a signature that was sent before would be refused
    assert rig.gate.is_shut


def test_a_computer_that_was_asleep_for_a_minute_has_lost_nobody() -> None:
    """The watchdog slept as well: what it did not see is no sign of a death."""
    rig = Rig()

    def meanwhile() -> Iterator[bool]:
        """The watchdog looks once after each step."""
        for _ in range(3):
            rig.gate.send([SETPOINT])
            rig.watchdog.beat()
            yield False  # its beat is seen, and it stands still from now on
            rig.now_s += 60.0
            yield False
        yield True

    rig.watchdog.watch(threading.Event(), meanwhile().__next__)
    assert rig.watchdog.failure is None


def test_a_setpoint_is_not_sent_long_after_its_position_or_through_a_gate_that_is_shut() -> None:
    """Of several that are due together only the newest is sent; the vehicle may wait for all."""
    rig, now = Rig(), [SETPOINT, HEARTBEAT, SETPOINT, HOLD]
    since_s = rig.now_s
    rig.now_s += 0.4
    assert rig.gate.send(now, since_s=since_s) == [0]
    rig.now_s += 0.2
    assert rig.gate.send(now, since_s=since_s) == [0, 2]
    assert rig.gate.send([SETPOINT]) == []  # in lockstep, where the vehicle waits
    assert rig.gate.stall_limit_s() == STALL_S
    rig.now_s += 1.0  # nothing is streamed any more: the loop may stand still for longer
    assert rig.gate.stall_limit_s() == IDLE_STALL_S
    rig.gate.shut()
    assert rig.gate.send(now) == [0, 1, 2, 3]
    assert rig.frames() == [HEARTBEAT, SETPOINT, HOLD, HEARTBEAT, HOLD, SETPOINT]
