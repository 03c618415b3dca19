"""What the gate lets through and tells apart; `test_parts` has the watchdog at work."""

import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as wire

sys.path.insert(0, str(Path(__file__).parent))
from stub_session import HEARTBEAT, HOLD, SETPOINT, QueueLink, packed

from companion.runtime.watchdog import (
    IDLE_STALL_S,
    STALL_S,
    Failure,
    Gate,
    Part,
    Watchdog,
    waits_for_processor,
)
from companion.runtime.watchdog import is_setpoint as is_setpoint

LOCAL = wire.MAVLink_set_position_target_local_ned_message(
    0, 1, 1, 1, 2496, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
)


def command_int(command: int, **values: float) -> Any:
    zeros = {"param1": 0.0, "param2": 0.0, "param3": 0.0, "param4": 0.0, "z": 0.0, **values}
    return wire.MAVLink_command_int_message(
        1, 1, 5, command, 0, 0, x=470000000, y=80000000, **zeros
    )


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (SETPOINT, True),
        (packed(LOCAL), True),
        (packed(command_int(192, param1=-1.0, param2=1.0, z=500.0)), True),
        (packed(command_int(192)), True),
        (packed(command_int(176, param1=1.0)), False),
        (HEARTBEAT, False),
        (HOLD, False),
        (b"", False),
        (b"\xfd", False),
        (SETPOINT[:9], False),
    ],
)
def test_setpoints_are_told_from_everything_else(frame: bytes, expected: bool) -> None:
    assert is_setpoint(frame) is expected


class Rig:
    def __init__(self, **keywords: Any) -> None:
        self.now_s = 100.0
        self.link = QueueLink(self.clock)
        self.gate = Gate(self.link, self.clock)
        self.failures: list[tuple[Failure, list[bytes]]] = []
        self.losses: list[Failure] = []
        self.watchdog = Watchdog(
            self.gate,
            **{
                "clock": self.clock,
                "hold_frames": lambda: [HOLD],
                "on_failure": lambda failure, hold: self.failures.append((failure, hold)),
                "on_loss": self.losses.append,
                **keywords,
            },
        )

    def clock(self) -> float:
        return self.now_s

    def frames(self) -> list[bytes]:
        return [frame for _, frame in self.link.sent]


def test_a_gate_that_is_shut_lets_nothing_through_but_the_watchdogs_own() -> None:
    rig = Rig()
    assert rig.gate.send([SETPOINT])
    rig.gate.shut()
    assert not rig.gate.send([SETPOINT, HEARTBEAT])
    rig.gate.send_last([HOLD])
    assert rig.frames() == [SETPOINT, HOLD]


def test_a_part_may_stand_still_for_longer_while_nothing_is_streamed() -> None:
    rig = Rig()
    assert rig.gate.stall_limit_s() == IDLE_STALL_S
    rig.gate.send([HEARTBEAT])
    assert rig.gate.stall_limit_s() == IDLE_STALL_S
    rig.gate.send([SETPOINT])
    assert rig.gate.stall_limit_s() == STALL_S
    rig.now_s += 1.0
    assert rig.gate.stall_limit_s() == IDLE_STALL_S


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


def test_of_several_deaths_the_first_counts_and_the_hold_is_sent_for_it_once_in_full() -> None:
    rig = Rig()
    rig.watchdog.start()
    rig.watchdog.died(Part("reader"), "first")
    rig.watchdog.died(Part("planner"), "second")
    rig.watchdog.end(10.0)
    assert rig.failures == [(Failure(part="reader", error="first"), [HOLD])]
    assert rig.frames() == [HOLD] * 3
    assert rig.gate.is_shut


def test_a_part_that_is_not_vital_shuts_nothing() -> None:
    rig = Rig()
    rig.watchdog.start()
    rig.watchdog.died(Part("writer", vital=False), "disk")
    rig.watchdog.end(10.0)
    assert rig.losses == [Failure(part="writer", error="disk")]
    assert not rig.gate.is_shut
    assert rig.frames() == []


def test_after_the_end_of_a_flight_nothing_is_a_death() -> None:
    rig = Rig()
    rig.watchdog.start()
    rig.watchdog.end(10.0)
    rig.watchdog.died(Part("planner"), "its process was ended")
    assert not rig.gate.is_shut
    assert rig.watchdog.failure is None


def test_a_computer_that_was_asleep_for_a_minute_has_lost_nobody() -> None:
    """The watchdog slept as well: what it did not see is no sign of a death."""
    rig, part, leaving = Rig(), Part("decider"), threading.Event()
    part.beat(0.2)
    rig.watchdog.start()
    rig.watchdog.watch(part, lambda: leaving.wait() and None)
    for _ in range(3):
        rig.now_s += 60.0
        time.sleep(0.1)  # several looks
        part.beat(0.2)
    assert rig.watchdog.failure is None
    rig.watchdog.end(10.0)
    leaving.set()


def test_a_death_that_is_noticed_by_the_watchdog_itself_has_its_words() -> None:
    rig, part, leaving = Rig(), Part("decider"), threading.Event()
    part.beat(0.2)
    rig.watchdog.start()
    rig.watchdog.watch(part, lambda: leaving.wait() and None)
    until_s = time.monotonic() + 10.0
    while rig.watchdog.failure is None:
        rig.now_s += 0.03
        time.sleep(0.03)
        assert time.monotonic() < until_s
    assert "stood still for 0.2" in rig.watchdog.failure.error
    leaving.set()
    rig.watchdog.end(10.0)
    assert HOLD in rig.frames()


def test_a_part_that_gets_no_processor_is_excused_for_seconds_and_not_for_ever() -> None:
    waits = [True]
    rig, part = Rig(waits=lambda _part: waits[0]), Part("decider")
    part.beat(STALL_S)
    rig.watchdog._parts.append(part)
    rig.watchdog._look(0.05)  # sees the beat
    for _ in range(round(IDLE_STALL_S / 0.05)):
        rig.watchdog._look(0.05)
    assert rig.watchdog.failure is None
    for _ in range(round(STALL_S / 0.05) + 2):
        rig.watchdog._look(0.05)
    assert rig.watchdog.failure is not None


def test_a_part_that_sleeps_or_computes_does_not_wait_for_a_processor() -> None:
    rig, leaving = Rig(), threading.Event()
    sleeper, worker = Part("sleeper"), Part("worker")

    def work() -> None:
        while not leaving.is_set():
            pass

    rig.watchdog.watch(sleeper, lambda: leaving.wait() and None)
    rig.watchdog.watch(worker, work)
    for part in (sleeper, worker):
        waits_for_processor(part)
    looks = 0
    while waits_for_processor(worker) or waits_for_processor(sleeper):  # it will have run at last
        looks += 1
        assert looks < 1000
        time.sleep(0.01)
    leaving.set()
    assert not waits_for_processor(Part("one that never ran"))
