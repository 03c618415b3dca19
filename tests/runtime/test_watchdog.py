"""What the gate lets through and tells apart; `test_workers` has the watchdog at work."""

import threading

import pytest
from pymavlink.dialects.v20 import all as wire
from stub_session import HEARTBEAT, HOLD, PATIENCE_S, SETPOINT, QueueLink, packed

from companion.runtime.link import is_setpoint
from companion.runtime.watchdog import IDLE_STALL_S, STALL_S, Failure, Gate, Watchdog, Worker

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
        self.gate = Gate(self.link, self.clock)
        self.failures: list[tuple[Failure, list[bytes]]] = []
        self.losses: list[Failure] = []
        self.watchdog = Watchdog(
            self.gate,
            clock=self.clock,
            hold_frames=lambda: [HOLD],
            on_failure=lambda failure, hold: self.failures.append((failure, hold)),
            on_loss=self.losses.append,
        )

    def clock(self) -> float:
        with self._looked:
            self._looks += 1
            self._looked.notify_all()
            return self.now_s

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


@pytest.mark.parametrize("ended", [False, True])
def test_of_several_deaths_the_first_counts_and_the_hold_is_sent_for_it_once_in_full(
    ended: bool,
) -> None:
    """A part that is not vital shuts nothing; after the end of a flight nothing is a death."""
    rig = Rig()
    rig.watchdog.start()
    rig.watchdog.died(Worker("writer", vital=False), "disk")
    assert rig.losses == [Failure(part="writer", error="disk")]
    assert not rig.gate.is_shut
    if ended:
        rig.watchdog.end(10.0)
    rig.watchdog.died(Worker("reader"), "first")
    rig.watchdog.died(Worker("planner"), "second")
    rig.watchdog.end(10.0)
    first = Failure(part="reader", error="first")
    assert rig.failures == ([] if ended else [(first, [HOLD])])
    assert rig.watchdog.failure == (None if ended else first)
    assert rig.frames() == ([] if ended else [HOLD] * 3)
    assert rig.gate.is_shut is not ended


def test_a_computer_that_was_asleep_for_a_minute_has_lost_nobody() -> None:
    """The watchdog slept as well: what it did not see is no sign of a death."""
    rig, part, leaving = Rig(), Worker("decider"), threading.Event()
    part.beat(0.2)
    rig.watchdog.start()
    rig.watchdog.watch(part, lambda: leaving.wait() and None)
    for _ in range(3):
        rig.wait_for_looks(1)  # its beat is seen, and it stands still from now on
        rig.goes_on(60.0)
        rig.wait_for_looks(1)
        part.beat(0.2)
    assert rig.watchdog.failure is None
    rig.watchdog.end(10.0)
    leaving.set()


def test_a_setpoint_is_not_sent_long_after_its_position_or_through_a_gate_that_is_shut() -> None:
    rig = Rig()
    since_s, others = rig.now_s, [HEARTBEAT, HOLD]
    rig.goes_on(0.4)
    assert rig.gate.send([SETPOINT, HEARTBEAT], since_s=since_s) == [SETPOINT, HEARTBEAT]
    rig.goes_on(0.2)
    assert rig.gate.send([SETPOINT, *others], since_s=since_s) == others
    assert rig.gate.send([SETPOINT]) == [SETPOINT]  # in lockstep, where the vehicle waits
    assert rig.gate.stall_limit_s() == STALL_S
    rig.goes_on(1.0)  # nothing is streamed any more: a part may stand still for longer
    assert rig.gate.stall_limit_s() == IDLE_STALL_S
    rig.gate.shut()
    assert not rig.gate.send([SETPOINT, HEARTBEAT])
    assert rig.frames() == [SETPOINT, HEARTBEAT, *others, SETPOINT]
