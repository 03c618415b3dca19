"""What the gate lets through and tells apart; `test_workers` has the watchdog at work."""

import threading
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import all as wire
from stub_session import HEARTBEAT, HOLD, PATIENCE_S, SETPOINT, QueueLink, as_any, packed

from companion.runtime.link import is_setpoint
from companion.runtime.watchdog import IDLE_STALL_S, STALL_S, Failure, Gate, Watchdog

LOCAL = wire.MAVLink_set_position_target_local_ned_message(
    0, 1, 1, 1, 2496, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
)


def command_int(command: int, *parameters: float) -> bytes:
    four = [*parameters, *[0.0] * (4 - len(parameters))]
    place = (470000000, 80000000, 500.0)
    return packed(wire.MAVLink_command_int_message(1, 1, 5, command, 0, 0, *four, *place))


def test_setpoints_are_told_from_everything_else() -> None:
    leads = [SETPOINT, packed(LOCAL), command_int(192), command_int(192, -1.0)]
    other = [HEARTBEAT, HOLD, SETPOINT[:9], command_int(176, 1.0), command_int(192, -1.0, 1.0)]
    assert [is_setpoint(frame) for frame in leads + other] == [True] * 4 + [False] * 5


class Rig:
    """A watchdog, and a clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self._looks, self._looked = 0, threading.Condition()
        self.link = QueueLink(self.clock)
        self.signings = 0
        self.gate = Gate(self.link, self.clock, self._signed)
        self.failures: list[tuple[Failure, list[bytes]]] = []
        session = SimpleNamespace(hold_frames=lambda: [HOLD], final_text=lambda _why: [])
        self.watchdog = Watchdog(
            self.gate,
            as_any(session),
            clock=self.clock,
            on_failure=lambda failure, hold: self.failures.append((failure, hold)),
        )

    def clock(self) -> float:
        with self._looked:
            self._looks += 1
            self._looked.notify_all()
            return self.now_s

    def _signed(self, frames: list[bytes]) -> list[bytes]:
        self.signings += 1
        return frames

    def goes_on(self, seconds: float) -> None:
        """The clock does, between two looks."""
        with self._looked:
            self.now_s += seconds

    def wait_for_looks(self, count: int) -> None:
        """Until the watchdog has looked so many times more, and once again has begun to."""
        with self._looked:
            enough = self._looks + count + 1
            assert self._looked.wait_for(lambda: self._looks >= enough, PATIENCE_S)

    def frames(self) -> list[bytes]:
        return [frame for _, frame in self.link.sent]


def test_a_link_that_is_stuck_in_the_middle_of_a_frame_does_not_keep_the_hold_back() -> None:
    rig, stuck, released = Rig(), threading.Event(), threading.Event()

    class Stuck(QueueLink):
        def send(self, frames: list[bytes]) -> None:
            if frames == [SETPOINT]:
                stuck.set()
                released.wait()
            super().send(frames)

    link = Stuck(rig.clock)
    gate = Gate(link, rig.clock)
    thread = threading.Thread(target=gate.send, args=([SETPOINT],))
    thread.start()
    stuck.wait()
    gate.shut()
    gate.send_last([HOLD])
    assert [frame for _, frame in link.sent] == [HOLD]
    released.set()
    thread.join()


@pytest.mark.parametrize("dies", [False, True])
def test_the_hold_is_sent_once_in_full_for_a_death_and_not_for_an_end(dies: bool) -> None:
    rig, ended = Rig(), threading.Event()
    if dies:
        rig.watchdog.died("OSError: made up")
    ended.set()
    for _ in range(2):
        rig.watchdog.watch(ended)
    died = Failure(part="decider", error="OSError: made up")
    assert rig.failures == ([(died, [HOLD])] if dies else [])
    assert rig.watchdog.failure == (died if dies else None)
    assert rig.frames() == [HOLD] * 3 * dies
    assert rig.signings == 3 * dies  # a signature that was sent before would be refused
    assert rig.gate.is_shut is dies


def test_a_computer_that_was_asleep_for_a_minute_has_lost_nobody() -> None:
    """The watchdog slept as well: what it did not see is no sign of a death."""
    rig, ended = Rig(), threading.Event()
    thread = threading.Thread(target=rig.watchdog.watch, args=(ended,))
    rig.gate.send([SETPOINT])
    rig.watchdog.beat()
    thread.start()
    for _ in range(3):
        rig.wait_for_looks(1)  # its beat is seen, and it stands still from now on
        rig.goes_on(60.0)
        rig.wait_for_looks(1)
        rig.gate.send([SETPOINT])
        rig.watchdog.beat()
    assert rig.watchdog.failure is None
    ended.set()
    thread.join(PATIENCE_S)


def test_a_setpoint_is_not_sent_long_after_its_position_or_through_a_gate_that_is_shut() -> None:
    """Of several that are due together only the newest is sent; the vehicle may wait for all."""
    rig, now = Rig(), [SETPOINT, HEARTBEAT, SETPOINT, HOLD]
    since_s = rig.now_s
    rig.goes_on(0.4)
    assert rig.gate.send(now, since_s=since_s) == [0]
    rig.goes_on(0.2)
    assert rig.gate.send(now, since_s=since_s) == [0, 2]
    assert rig.gate.send([SETPOINT]) == []  # in lockstep, where the vehicle waits
    assert rig.gate.stall_limit_s() == STALL_S
    rig.goes_on(1.0)  # nothing is streamed any more: the loop may stand still for longer
    assert rig.gate.stall_limit_s() == IDLE_STALL_S
    rig.gate.shut()
    assert rig.gate.send(now) == [0, 1, 2, 3]
    assert rig.frames() == [HEARTBEAT, SETPOINT, HOLD, HEARTBEAT, HOLD, SETPOINT]
