"""For pytest users: a running simulator on a free port, a clock to step, and assertions.

`pytest_plugins = ["vehicle_sim.testing"]` in conftest.py brings the fixture `vehicle_sim`, which
starts a Simulator; docs/simulator.md has an example.  It runs in the test's own process and only
while the test advances it: between two calls vehicle time stands still.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, Final, NamedTuple, final

import pytest

from vehicle_sim.errors import SimulatorError
from vehicle_sim.geodesy import WGS84
from vehicle_sim.links import Endpoint, open_link
from vehicle_sim.parameters import Firmware
from vehicle_sim.simulation import STEP_US, Simulation
from vehicle_sim.stations import Station, Stations
from vehicle_sim.world import VehicleKind, World, flat_world

_TICK_STEPS: Final = 5
_TICK_S: Final = _TICK_STEPS * STEP_US * 1e-6
_AGAIN_S, _PATIENCE_S = 1.0, 30.0
"""Wall time after which a lockstep tick asks again, and gives up."""
_READY_S: Final = 60.0


@final
class Moment(NamedTuple):
    """Where the vehicle really was: ten a second."""

    t_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    speed_m_s: float
    """Over ground."""
    above_ground_m: float
    mode: str
    armed: bool
    landed: bool

    def away_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """Over the ground to a place."""
        place = (self.longitude_deg, self.latitude_deg)
        return float(WGS84.inv(*place, longitude_deg, latitude_deg)[2])


@final
class Simulator:
    """A vehicle on a free UDP port of this machine.

    `autopilot` is "ardupilot" or "px4", `vehicle` "copter" or "plane"; or give a `world` (as
    vehicle_sim.world.read_world returns it).  `scan_range_m` adds a terrain radar.  `ready` flies
    through the boot, until the autopilot would let itself be armed.  `faults` are lines of the
    timeline of faults.  With `lockstep`, once a client has sent a HEARTBEAT, each tick of 50 ms
    waits until it has answered the simulator's TIMESYNC (tc1 echoes ts1).  Unless `strict` is
    switched off, what the real autopilot does not survive is an AssertionError.
    """

    def __init__(
        self,
        *,
        autopilot: Firmware = "ardupilot",
        vehicle: VehicleKind = "copter",
        home: tuple[float, float, float] = (47.397742, 8.545594, 488.0),
        heading_deg: float = 0.0,
        scan_range_m: float | None = None,
        world: World | None = None,
        faults: str = "",
        seed: int = 0,
        ready: bool = False,
        lockstep: bool = False,
        strict: bool = True,
    ) -> None:
        names = ("latitude_deg", "longitude_deg", "altitude_amsl_m", "heading_deg")
        place: dict[str, Any] = dict(zip(names, (*home, heading_deg), strict=True))
        flat = flat_world(vehicle, autopilot, scan_range_m=scan_range_m, **place)
        self.simulation = Simulation(world or flat, seed=seed, faults=faults)
        self.simulation.on_message = self._heard
        self.fault, self.set_parameter = self.simulation.add_fault, self.simulation.set_parameter
        """A fault from now on, as "for 30 s: gps_off"; and a parameter, as PARAM_SET does it."""
        self._lockstep, self._strict = lockstep, strict
        self._link = open_link(Endpoint(kind="udpin", host="127.0.0.1", port=0))
        self.close = self._link.close
        self._stations = Stations([Station(simulation=self.simulation, links=[self._link])])
        self.moments = [self._moment()]
        """The whole flight so far."""
        self.heard_s: dict[str, list[float]] = {}
        """When each kind of message came in, in vehicle time, by its MAVLink name."""
        while ready and not self.simulation.armable:
            assert self.now_s < _READY_S, f"not ready after {_READY_S:.0f} s of vehicle time"
            self._step()

    @property
    def port(self) -> int:
        """The UDP port that it listens on, at 127.0.0.1."""
        return self._link.endpoint.port

    @property
    def connection(self) -> str:
        """What a client connects to, as pymavlink writes it."""
        return f"udpout:127.0.0.1:{self.port}"

    @property
    def now_s(self) -> float:
        """Vehicle time."""
        return self.simulation.now_us * 1e-6

    @property
    def moment(self) -> Moment:
        """Where it is."""
        return self.moments[-1]

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self.simulation.armed

    # --- time ---------------------------------------------------------------------------------

    def advance(self, seconds: float, *, meanwhile: Callable[[], object] | None = None) -> None:
        """Let so much vehicle time pass, in ticks of 50 ms.

        After each tick what was sent is on the wire and `meanwhile` is called: let your client read
        and answer there.
        """
        until_us = self.simulation.now_us + seconds * 1e6 - 0.5
        while self.simulation.now_us < until_us:
            for _ in range(_TICK_STEPS):
                self._step()
            self._exchange(meanwhile or (lambda: None))

    def advance_until(
        self,
        reached: Callable[[], bool],
        *,
        within_s: float,
        meanwhile: Callable[[], object] | None = None,
    ) -> None:
        """The same, until this is so; an AssertionError if it is not in time."""
        until_us = self.simulation.now_us + within_s * 1e6 - 0.5
        while not reached():
            late = self.simulation.now_us >= until_us
            assert not late, f"it never came to that within {within_s:g} s; {self._where()}"
            self.advance(_TICK_S, meanwhile=meanwhile)

    def _step(self) -> None:
        simulation = self.simulation
        simulation.step()
        simulation.take_notices()
        if simulation.take_truth():
            self.moments.append(self._moment())
        if self._strict and simulation.not_survived is not None:
            raise AssertionError(f"at {self.now_s:.2f} s: {simulation.not_survived}")

    def _moment(self) -> Moment:
        simulation, vehicle = self.simulation, self.simulation.vehicle
        return Moment(
            self.now_s,
            vehicle.latitude_deg,
            vehicle.longitude_deg,
            vehicle.altitude_amsl_m,
            math.hypot(*vehicle.velocity_neu_m_s[:2]),
            vehicle.altitude_amsl_m - simulation.contact.ground_amsl_m,
            simulation.mode_name,
            simulation.armed,
            simulation.landed,
        )

    def _heard(self, kind: str) -> None:
        self.heard_s.setdefault(kind, []).append(self.now_s)

    def _exchange(self, meanwhile: Callable[[], object]) -> None:
        """What is to go out goes out; what has come in is handled; in lockstep, wait for it."""
        stations = self._stations
        waits = self._lockstep and self.simulation.companion is not None
        if waits:
            self.simulation.ask_for_sync()

        def speak() -> None:
            stations.send()
            meanwhile()

        stations.send()
        stations.receive()
        speak()
        stations.receive()
        stations.send()
        if waits:
            try:
                stations.wait(_AGAIN_S, _PATIENCE_S, speak)
            except SimulatorError as error:
                raise AssertionError(str(error)) from None

    def _where(self) -> str:
        return f"at {self.now_s:.1f} s: {self.simulation.outcome()}"

    # --- assertions ---------------------------------------------------------------------------

    def assert_never_inside(
        self, latitude_deg: float, longitude_deg: float, radius_m: float
    ) -> None:
        """It has never been within this radius of this point, at any height."""
        for moment in self.moments:
            away_m = moment.away_m(latitude_deg, longitude_deg)
            where = f"{away_m:.1f} m from the middle, not {radius_m:g} m"
            assert away_m >= radius_m, f"inside at {moment.t_s:.1f} s: {where}"

    def assert_not_crashed(self) -> None:
        """It has hit nothing: no tree, and not the ground at more than 3 m/s in any direction.

        A plane on its wheels may be faster along a runway.
        """
        assert self.simulation.crash is None, self._where()

    def assert_stream_gap(self, at_most_s: float, *, message: str) -> None:
        """From its first message on, the client never paused for longer."""
        times = self.heard_s.get(message, [])
        assert times, f"no {message} came in at all"
        for start_s, end_s in zip(times, [*times[1:], self.now_s], strict=True):
            gap = f"{end_s - start_s:.2f} s without {message} from {start_s:.2f} s on"
            assert end_s - start_s <= at_most_s, f"{gap}, not {at_most_s:g} s"

    def assert_arrived(
        self, latitude_deg: float, longitude_deg: float, *, within_m: float, within_s: float
    ) -> None:
        """It has been within this distance of this point by this vehicle time."""
        flown = [moment for moment in self.moments if moment.t_s <= within_s]
        nearest_m = min((m.away_m(latitude_deg, longitude_deg) for m in flown), default=math.inf)
        near = f"not nearer than {nearest_m:.1f} m by {within_s:g} s, not {within_m:g} m"
        assert nearest_m <= within_m, f"{near}; {self._where()}"


@pytest.fixture
def vehicle_sim() -> Iterator[Callable[..., Simulator]]:
    """Start simulators: call it with the arguments of Simulator; they end with the test."""
    with ExitStack() as stack:

        def start(**arguments: Any) -> Simulator:
            simulator = Simulator(**arguments)
            stack.callback(simulator.close)
            return simulator

        yield start
