"""A flight in one process: a session and a simulated vehicle in lockstep, without sockets.

    flown = fly_in_process(session, Simulation(world, seed=1), planner=plan)

The loop is the one that flies over UDP, here in the caller's thread: it is given the same
datagrams, and the vehicle the same answers, so the flight is the same to the byte (decision 0026).
Vehicle time goes on when all that the vehicle has said is answered.  Nothing waits, and a clock is
read only to say how long it took.
"""

import contextlib
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol, final

from companion.runtime.link import Link, datagrams
from companion.runtime.loop import Loop
from companion.runtime.planner_process import PlanFunction, PlannerHere
from companion.runtime.recorder import Recorder
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary
from companion.telemetry.run_folder import RunFolder

_PORTION = 2_000  # outputs, a minute: what is cut short here is flown again, not resumed


class SimulatedVehicle(Protocol):
    """A vehicle without sockets and clock; `vehicle_sim.simulation.Simulation` is one."""

    @property
    def now_us(self) -> int:
        """Its time since the start."""

    @property
    def companion(self) -> object | None:
        """Whose heartbeat it has heard; None: nobody's yet."""

    def send_heartbeat(self) -> None:
        """Queue its heartbeats; its time stands still."""

    def begin(self) -> None:
        """The flight begins: frames are counted from here."""

    def step(self) -> bool:
        """Fly one step; whether it ends a tick, which has to be answered."""

    def ask_for_sync(self) -> int:
        """Queue the TIMESYNC request that ends a tick."""

    def take_frames(self) -> list[tuple[int, bytes]]:
        """What it says by now: link and frame."""

    def receive(self, link: int, data: bytes) -> None:
        """Tell it something by a link."""


@final
class VehicleLink(Link):
    """A link to a vehicle in this process: with nothing left to receive, it flies on by a tick."""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        self._vehicle = vehicle
        self._waiting: deque[bytes] = deque()
        self._began = False

    def receive(self, timeout_s: float) -> bytes | None:  # noqa: ARG002 - nothing waits here
        """The next datagram; None if the vehicle said nothing in this tick."""
        if not self._waiting:
            self._fly_on()
        return self._waiting.popleft() if self._waiting else None

    def send(self, frames: list[bytes]) -> None:
        """Tell the vehicle, at its present time."""
        for datagram in datagrams(frames):
            self._vehicle.receive(0, datagram)

    def close(self) -> None:
        """There is nothing to let go of."""

    def _fly_on(self) -> None:
        vehicle = self._vehicle
        if vehicle.companion is None and not self._began:
            vehicle.send_heartbeat()
        else:
            if not self._began:
                self._began = True
                vehicle.begin()
            while not vehicle.step():
                pass
            vehicle.ask_for_sync()
        self._waiting.extend(datagrams([frame for _, frame in vehicle.take_frames()]))


def loop_in_process(
    session: Session,
    vehicle: SimulatedVehicle,
    *,
    planner: PlanFunction,
    stop_asked: Callable[[], bool] = lambda: False,
) -> Loop:
    """The loop of a session in lockstep, for callers that fly it turn by turn.

    They say who is to `record` it, if anybody.  stop_asked: ends the mission, as Ctrl-C does; it is
    asked in each turn.  Errors of session and planner are raised.
    """
    return Loop(
        session,
        VehicleLink(vehicle),
        PlannerHere(planner),
        clock=lambda: vehicle.now_us * 1e-6,
        stop_asked=stop_asked,
    )


def fly_in_process(
    session: Session,
    vehicle: SimulatedVehicle,
    *,
    planner: PlanFunction,
    folder: RunFolder | None = None,
    stop_asked: Callable[[], bool] = lambda: False,
) -> FlightSummary:
    """Fly a session until its mission ends, in a `loop_in_process`.

    folder: where it is recorded.
    """
    began_s = time.perf_counter()
    loop = loop_in_process(session, vehicle, planner=planner, stop_asked=stop_asked)
    with contextlib.ExitStack() as stack:
        if folder is not None:
            recorder = Recorder(folder, loop.clock, loop.lost, portion=_PORTION)
            stack.callback(recorder.close)
            loop.record = recorder.put
        loop.run()
    loop.flown.elapsed_s = time.perf_counter() - began_s
    return loop.flown
