"""Flies a simulated vehicle by a strategy of `companion.mavlink.autopilots`, and nothing else.

Both programs meet here as they do on the wire: bytes.  No mission machine and no planner: what a
strategy is worth, and which order of messages gets a vehicle into the air, is measured by itself.
"""

import copy
import copyreg
import functools
import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import ALL, Autopilot, LaunchPose, autopilot_of, heading_rad
from companion.mavlink.dialect import codec, wire
from companion.mission.events import (
    Echo,
    Estimator,
    Event,
    GpsFix,
    Home,
    Landed,
    LandedState,
    Mode,
    Origin,
    Position,
    SetMode,
    Setpoint,
    TakeOff,
    Vector,
    VehicleStatus,
)
from companion.mission.vehicle_traits import TakeoffSequence
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

copyreg.pickle(struct.Struct, lambda made: (struct.Struct, (made.format,)))  # to copy simulations

Firmware = Literal["ardupilot", "px4"]
Kind = Literal["copter", "plane"]
SYSTEM = 1
HOME = (47.397742, 8.545594, 488.0)
POSITION_HZ = 10.0
_STEP_S = 0.01
_ACCELERATION_M_S2 = 2.0
_ASK_S = 1.0
_READ = {
    wire.MAVLINK_MSG_ID_HEARTBEAT,
    wire.MAVLINK_MSG_ID_COMMAND_ACK,
    wire.MAVLINK_MSG_ID_STATUSTEXT,
    wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    *[number for autopilot in ALL for number in (*autopilot.streams_hz, *autopilot.requested_once)],
}


class Route:
    """A curve in the local frame: points a metre apart, and the tangents there."""

    def __init__(self, points_nea_m: Sequence[Vector]) -> None:
        self.points = np.asarray(points_nea_m, dtype=float)
        steps = np.diff(self.points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        self.lengths = np.concatenate(([0.0], np.cumsum(lengths)))
        self.tangents = np.gradient(self.points, self.lengths, axis=0)
        self.length_m = float(self.lengths[-1])

    @staticmethod
    def of(
        start_nea_m: Vector,
        heading_rad: float,
        pieces: Sequence[tuple[float, float]],
        climb: float = 0.0,
    ) -> "Route":
        """Pieces of a length in m and a curvature in 1/m (right turns positive)."""
        points, heading = [start_nea_m], heading_rad
        for length_m, curvature in pieces:
            for _ in range(round(length_m)):
                heading += 0.5 * curvature
                north, east, altitude = points[-1]
                step = (math.cos(heading), math.sin(heading))
                points.append((north + step[0], east + step[1], altitude + climb))
                heading += 0.5 * curvature
        return Route(points)

    def at(self, length_m: float) -> tuple[Vector, Vector]:
        """Point and unit tangent; beyond the end on along the last tangent."""
        k = min(max(length_m, 0.0), self.length_m)
        point = [float(np.interp(k, self.lengths, self.points[:, axis])) for axis in range(3)]
        slope = [float(np.interp(k, self.lengths, self.tangents[:, axis])) for axis in range(3)]
        norm = math.hypot(*slope)
        tangent = (slope[0] / norm, slope[1] / norm, slope[2] / norm)
        over_m = length_m - k
        place = tuple(p + over_m * t for p, t in zip(point, tangent, strict=True))
        return (place[0], place[1], place[2]), tangent

    def nearest_m(self, here_nea_m: Vector, about_m: float) -> float:
        """Length of the nearest point not far from another length."""
        near = (self.lengths > about_m - 50.0) & (self.lengths < about_m + 100.0)
        away = np.linalg.norm(self.points[near, :2] - np.asarray(here_nea_m[:2]), axis=1)
        return float(self.lengths[near][int(np.argmin(away))])

    def off_m(self, here_nea_m: Vector, about_m: float) -> float:
        """Distance of a point from the curve, in all three axes."""
        near = (self.lengths > about_m - 80.0) & (self.lengths < about_m + 120.0)
        away = np.linalg.norm(self.points[near] - np.asarray(here_nea_m), axis=1)
        return float(away.min())


class Flight:
    """What a stream along a route came to: distances from the route, true positions."""

    def __init__(self) -> None:
        self.off_m: list[float] = []
        """From the nearest point of the route."""
        self.behind_m: list[float] = []
        """From the reference point, of vehicles that have one in time."""
        self.speeds_m_s: list[float] = []
        self.echo_off_m: list[float] = []
        """Echoes from the newest setpoint sent before them."""

    @property
    def rms_m(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.off_m))))

    @property
    def most_m(self) -> float:
        return max(self.off_m)

    @property
    def speed_m_s(self) -> float:
        return float(np.mean(self.speeds_m_s))


class Driver:
    """One vehicle and what is known of it by its messages."""

    def __init__(
        self,
        firmware: Firmware,
        kind: Kind,
        *,
        home: tuple[float, float, float] = HOME,
        heading_deg: float = 0.0,
        faults: str = "",
        seed: int = 0,
        loiter_radius_m: float = 100.0,
    ) -> None:
        world = flat_world(
            kind,
            firmware,
            latitude_deg=home[0],
            longitude_deg=home[1],
            altitude_amsl_m=home[2],
            heading_deg=heading_deg,
        )
        self.simulation = Simulation(world, faults=faults, seed=seed)
        self.frame = LocalFrame(latitude_deg=home[0], longitude_deg=home[1])
        self.ground_amsl_m = home[2]
        self.loiter_radius_m = loiter_radius_m
        self.autopilot: Autopilot | None = None
        self.newest: dict[type, Any] = {}
        """The newest event of each type."""
        self.events: list[Event] = []
        self.messages: list[Any] = []
        """All that came but what comes more than once a second."""
        self.sent: list[Any] = []
        """Setpoints."""
        self.heading_rad = 0.0
        self.on_position: Callable[[Position], None] | None = None
        self._codec = codec(SYSTEM)
        self._heard_s: dict[int, float] = {}
        self._interval_s: dict[int, float] = {}
        self._asked_s = self._streams_s = self._setpoint_s = self._heartbeat_s = -math.inf

    def copy(self) -> "Driver":
        """The same again from here."""
        return copy.deepcopy(self)

    # --- what is known ------------------------------------------------------------------------

    @property
    def pilot(self) -> Autopilot:
        assert self.autopilot is not None
        return self.autopilot

    @property
    def now_s(self) -> float:
        return self.simulation.now_us * 1e-6

    @property
    def mode(self) -> Mode | None:
        return self.newest[VehicleStatus].mode if VehicleStatus in self.newest else None

    @property
    def armed(self) -> bool:
        return VehicleStatus in self.newest and self.newest[VehicleStatus].armed

    @property
    def landed(self) -> Landed:
        state = self.newest.get(LandedState)
        return Landed.UNKNOWN if state is None else state.landed

    @property
    def here(self) -> Vector:
        place: Vector = self.newest[Position].position_nea_m
        return place

    @property
    def believed(self) -> bool:
        """Whether fix and estimator are good."""
        return all(kind in self.newest and self.newest[kind].good for kind in (GpsFix, Estimator))

    @property
    def truly(self) -> Vector:
        """Where it really is."""
        vehicle = self.simulation.vehicle
        place = self.frame.to_local_m(vehicle.latitude_deg, vehicle.longitude_deg)
        return (*place, vehicle.altitude_amsl_m)

    @property
    def speed_m_s(self) -> float:
        vehicle = self.simulation.vehicle
        return math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)

    # --- time and messages --------------------------------------------------------------------

    def send(self, messages: Sequence[Any]) -> None:
        for message in messages:
            self.simulation.receive(0, bytes(message.pack(self._codec)))
            self._codec.seq = (self._codec.seq + 1) % 256

    def step(self) -> None:
        self.simulation.step()
        for _, frame in self.simulation.take_frames():
            if int.from_bytes(frame[7:10], "little") not in _READ:
                continue  # most of what a PX4 says
            for message in self._codec.parse_buffer(frame) or ():
                if (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, 1):
                    self._hear(message)
        if self.now_s - self._heartbeat_s >= 1.0:
            self._heartbeat_s = self.now_s
            self.send([wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)])
        if self.autopilot is not None and self.now_s - self._streams_s >= 2.0:
            self._request_streams()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / _STEP_S)):
            self.step()

    def until(
        self, reached: Callable[[], bool], within_s: float, ask: Callable[[], object] | None = None
    ) -> float:
        """Seconds until it is so, asking for it once a second."""
        start_s, asked_s = self.now_s, -math.inf
        while not reached():
            assert self.now_s - start_s < within_s, self.newest.get(VehicleStatus)
            if ask is not None and self.now_s - asked_s >= _ASK_S:
                asked_s = self.now_s
                ask()
            self.step()
        return self.now_s - start_s

    def _hear(self, message: Any) -> None:
        kind, number = message.get_type(), message.get_msgId()
        self._interval_s[number] = self.now_s - self._heard_s.get(number, -math.inf)
        self._heard_s[number] = self.now_s
        if kind == "HEARTBEAT" and self.autopilot is None:
            self.autopilot = autopilot_of(message)
        if self.autopilot is None:
            return
        if kind == "GLOBAL_POSITION_INT":
            self.heading_rad = heading_rad(message) or 0.0
        if kind in ("COMMAND_ACK", "STATUSTEXT"):
            self.messages.append(message)
        origin = self.newest.get(Origin)
        place = None if origin is None else origin.position_nea_m
        event = self.autopilot.event_of(message, self.now_s, self.frame, place)
        if event is not None:
            self.newest[type(event)] = event
            self.events.append(event)
        if isinstance(event, Position) and self.on_position is not None:
            self.on_position(event)

    def _request_streams(self) -> None:
        self._streams_s = self.now_s
        rates = {wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: POSITION_HZ, **self.pilot.streams_hz}
        for number, hz in rates.items():
            silent_s = self.now_s - self._heard_s.get(number, -math.inf)
            # a plane sends everything at 1 Hz unasked
            if max(silent_s, self._interval_s.get(number, 0.0)) > 1.5 / hz:
                self._command(wire.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / hz)
        for number in self.pilot.requested_once:
            if number not in self._heard_s:
                self._command(wire.MAV_CMD_REQUEST_MESSAGE, number)

    def _command(self, number: int, *parameters: float) -> None:
        padded = (*parameters, *([0.0] * (7 - len(parameters))))
        self.send([wire.MAVLink_command_long_message(SYSTEM, 1, number, 0, *padded)])

    # --- flying -------------------------------------------------------------------------------

    def find(self) -> None:
        """Until it is known, heard as asked, and where it is may be believed."""
        self.until(lambda: self.autopilot is not None, 10.0)
        known = (Position, Home, LandedState)
        self.until(lambda: self.believed and all(k in self.newest for k in known), 90.0)

    def set_mode(self, mode: Mode, at_nea_m: Vector | None = None) -> None:
        self.send(self.pilot.set_mode(SetMode(mode=mode, at_nea_m=at_nea_m), self.frame, SYSTEM))

    def ask_mode(self, mode: Mode, within_s: float = 20.0) -> float:
        return self.until(lambda: self.mode is mode, within_s, lambda: self.set_mode(mode))

    def take_off(self, height_m: float) -> None:
        """In the autopilot's own way, until it flies at this height above home."""
        home = self.newest[Home].position_nea_m
        command = TakeOff(above_home_m=height_m, altitude_amsl_m=home[2] + height_m)
        here = LaunchPose(position_nea_m=self.here, heading_rad=self.heading_rad)
        messages = self.pilot.take_off(command, here, self.frame, SYSTEM)
        flying = lambda: self.landed is Landed.IN_AIR  # noqa: E731
        arm = lambda: self.send(self.pilot.arm(SYSTEM))  # noqa: E731
        match self.pilot.traits.take_off:
            case TakeoffSequence.GUIDED_THEN_CLIMB:
                self.ask_mode(Mode.GUIDED)
                self.until(lambda: self.armed, 30.0, arm)
                self.until(
                    lambda: self.landed is not Landed.ON_GROUND, 20.0, lambda: self.send(messages)
                )
                self.until(flying, 30.0 + height_m)
            case TakeoffSequence.MODE_THEN_ARM:
                self.ask_mode(Mode.TAKE_OFF)
                self.until(lambda: self.armed, 30.0, arm)
                self.until(flying, 60.0)
                self.ask_mode(Mode.GUIDED)
                self.stay((*self.here[:2], command.altitude_amsl_m))
                self.until(lambda: abs(self.here[2] - command.altitude_amsl_m) < 5.0, 120.0)
            case TakeoffSequence.CLIMB_THEN_ARM:
                self.until(lambda: self.mode is Mode.TAKE_OFF, 20.0, lambda: self.send(messages))
                self.until(lambda: self.armed, 30.0, arm)
                self.until(lambda: self.mode is Mode.HOLD, 60.0 + height_m)

    def setpoint(self, setpoint: Setpoint) -> None:
        """Send one, if the last was long enough ago."""
        if setpoint.time_s - self._setpoint_s < self.pilot.traits.setpoint_period_s - 1e-6:
            return
        self._setpoint_s = setpoint.time_s
        messages = self.pilot.setpoint(
            setpoint, self.frame, SYSTEM, loiter_radius_m=self.loiter_radius_m
        )
        assert messages is not None
        self.sent.append(setpoint)
        self.send(messages)

    def stay(self, place_nea_m: Vector) -> None:
        """Stream a place to stay at, from now on."""
        self.on_position = _Stay(place_nea_m, self).send

    def silent(self) -> None:
        """Send no more setpoints."""
        self.on_position = None

    def follow(self, route: Route, speed_m_s: float, *, skip_m: float = 0.0) -> Flight:
        """Stream a route to its end; the first metres of it do not count."""
        flight, reference = Flight(), _Reference(route, speed_m_s, self)
        self.on_position = reference.send
        if self.mode is not Mode.GUIDED:
            self.until(lambda: self.mode is Mode.GUIDED, 20.0, lambda: self.set_mode(Mode.GUIDED))
        lead_m = self.pilot.traits.lead_s * speed_m_s
        while reference.length_m < route.length_m - lead_m - 1.0:
            self.run(0.1)
            assert self.mode is Mode.GUIDED
            if reference.length_m < skip_m:
                continue
            flight.off_m.append(route.off_m(self.truly, reference.length_m))
            flight.behind_m.append(math.dist(self.truly, route.at(reference.length_m)[0]))
            flight.speeds_m_s.append(self.speed_m_s)
            echo = self.newest.get(Echo)
            if echo is not None and self.sent:
                flight.echo_off_m.append(
                    min(math.dist(echo.position_nea_m, s.position_nea_m) for s in self.sent[-8:])
                )
        return flight


class _Stay:
    """A place to stay at.  No closure: those are not copied with their driver."""

    def __init__(self, place_nea_m: Vector, driver: Driver) -> None:
        self._place_nea_m, self._driver = place_nea_m, driver

    def send(self, position: Position) -> None:
        self._driver.setpoint(
            Setpoint(
                time_s=position.time_s,
                position_nea_m=self._place_nea_m,
                velocity_nea_m_s=(0.0, 0.0, 0.0),
                yaw_rad=0.0,
                stay=True,
            )
        )


class _Reference:
    """The point of a route where the vehicle ought to be: by the clock, or nearest to a plane."""

    def __init__(self, route: Route, speed_m_s: float, driver: Driver) -> None:
        self._route, self._speed_m_s, self._driver = route, speed_m_s, driver
        self.length_m = self.speed_m_s = 0.0
        self._last_s: float | None = None

    def send(self, position: Position) -> None:
        driver = self._driver
        traits = driver.pilot.traits
        elapsed_s = 0.0 if self._last_s is None else position.time_s - self._last_s
        self._last_s = position.time_s
        if traits.hovers:
            if driver.mode is Mode.GUIDED:
                grown = self.speed_m_s + _ACCELERATION_M_S2 * elapsed_s
                self.speed_m_s = min(grown, self._speed_m_s)
                self.length_m += self.speed_m_s * elapsed_s
        else:
            nearest_m = self._route.nearest_m(position.position_nea_m, self.length_m)
            self.length_m = max(self.length_m, nearest_m)
            self.speed_m_s = math.hypot(*position.velocity_nea_m_s)
        ahead_m = traits.lead_s * self.speed_m_s
        point, tangent = self._route.at(self.length_m + ahead_m)
        velocity = tuple(self.speed_m_s * t for t in tangent)
        driver.setpoint(
            Setpoint(
                time_s=position.time_s,
                position_nea_m=point,
                velocity_nea_m_s=(velocity[0], velocity[1], velocity[2]),
                yaw_rad=math.atan2(tangent[1], tangent[0]),
            )
        )


@functools.cache
def _found(firmware: Firmware, kind: Kind) -> Driver:
    driver = Driver(firmware, kind)
    driver.find()
    return driver


def found(firmware: Firmware, kind: Kind) -> Driver:
    """One on the ground, known, with its position good."""
    return _found(firmware, kind).copy()


@functools.cache
def _airborne(firmware: Firmware, kind: Kind, height_m: float) -> Driver:
    driver = found(firmware, kind)
    driver.take_off(height_m)
    return driver


def airborne(firmware: Firmware, kind: Kind, height_m: float = 60.0) -> Driver:
    """One in the air, after its own take-off, that stays or circles."""
    return _airborne(firmware, kind, height_m).copy()
