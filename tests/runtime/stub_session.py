"""A session that only streams, and links of its own: the runtime's parts without a mission."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, ClassVar

from planning import BLANK, TASK, ask
from wires import Speaker, wire

from companion.config import load_mission
from companion.mavlink.link import Output
from companion.mission.events import End, Outcome
from companion.planner.request import PlanRequest
from companion.runtime.link import Link

PATIENCE_S, PERIOD_S = 20.0, 0.02
NOWHERE = SimpleNamespace(position_nea_m=None)
packed = Speaker(srcComponent=195).frame


def setpoint(at_s: float = 0.0) -> bytes:
    made, place = wire.MAVLink_set_position_target_global_int_message, (470000000, 80000000, 500.0)
    return packed(made(round(at_s * 1000), 1, 1, 5, 2496, *place, *[1.0] * 8))


def heartbeat() -> bytes:
    return packed(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))


SETPOINT, HEARTBEAT = setpoint(), heartbeat()
HOLD = packed(wire.MAVLink_command_long_message(1, 1, 176, 0, 1.0, 17.0, *[0.0] * 5))


def request_of(plan_id: int, *, planning_time_s: float = 0.5) -> PlanRequest:
    settings = replace(TASK.settings, planning_time_s=planning_time_s)
    task = replace(TASK, settings=settings)
    return ask(task, BLANK, (0.0, 0.0, 500.0), plan_id=plan_id)


@dataclass
class StubSession:
    """Answers each datagram with a setpoint and a heartbeat.

    on_datagram(number) is called with the number of each, in the decider's thread.
    """

    on_datagram: Callable[[int], object] = lambda _number: None
    out: Output = field(default_factory=Output)
    now_s: float = 0.0
    received: list[bytes] = field(default_factory=list)
    silences_s: list[float] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    end: End | None = None
    has_left: bool = False
    context: Any = field(default_factory=lambda: SimpleNamespace(lockstep=False))
    mission: Any = field(default_factory=lambda: load_mission("valley"))
    state: ClassVar[Any] = SimpleNamespace(vehicle=NOWHERE, flight=SimpleNamespace(target=0))

    def receive(self, data: bytes, _at_s: float) -> bool:
        """Whether it is the vehicle's."""
        self.received.append(data)
        self.now_s += 0.05
        self.on_datagram(len(self.received))
        for frame in (setpoint(self.now_s), heartbeat()):
            self.out.frames.append(frame)
            self.out.record.append((self.now_s, frame))
        return data != b"another's"

    def take_output(self) -> Output:
        out, self.out = self.out, Output()
        out.end, out.settled = self.end, True
        return out

    run = take_output

    def farewell(self) -> Output:
        self.has_left = True
        return self.take_output()

    def signed(self, frames: list[bytes]) -> list[bytes]:
        return frames

    def deliver(self, _outcome: object) -> None:
        pass

    def silence(self, silent_s: float) -> None:
        self.silences_s.append(silent_s)

    def stop(self) -> None:
        self.end = End(outcome=Outcome.STOPPED, reason="asked to", remedy="")

    def final_text(self, _why: str) -> list[bytes]:
        return []

    def hold_frames(self) -> list[bytes]:
        return [HOLD]

    def part_died(self, part: str, error: str) -> None:
        self.out.frames.append(HOLD)
        self.out.record.append((self.now_s, HOLD))
        self.out.journal.append({"t_s": 1.0, "kind": "part died", "part": part, "error": error})
        self.end = End(outcome=Outcome.FAILED, reason=f"{part} died", remedy="")

    def complain(self, text: str) -> None:
        self.complaints.append(text)


class SpeakingLink(Link):
    """A vehicle that speaks at 50 Hz; what it is told is kept, with times."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.sent: list[tuple[float, bytes]] = []
        self._more_sent, self._speaks_s = threading.Condition(), time.monotonic()

    def receive(self, timeout_s: float) -> bytes | None:
        """What it says; if nobody listens it waits."""
        wait_s = self._speaks_s - time.monotonic()
        time.sleep(max(min(wait_s, timeout_s), 0.0))
        if wait_s > timeout_s:
            return None
        self._speaks_s += PERIOD_S
        return b"position"

    def send(self, frames: list[bytes]) -> None:
        now_s = self.clock()
        with self._more_sent:
            self.sent += [(now_s, frame) for frame in frames]
            self._more_sent.notify_all()

    def wait_until(self, done: Callable[[], bool]) -> None:
        """Until it is so, as seen whenever something was sent."""
        with self._more_sent:
            assert self._more_sent.wait_for(done, PATIENCE_S)

    def times_of(self, frame: bytes) -> list[float]:
        """When messages of its kind were sent."""
        return [time_s for time_s, each in self.sent if each[7:10] == frame[7:10]]
