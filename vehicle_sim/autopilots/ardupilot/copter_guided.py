"""GUIDED: the target that runs on between setpoints, its time-out, and how it is steered for.

Source: ardupilot.md 3 and the recorded flights; submodes and their changes as mode_guided.cpp.
"""

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple, final

from vehicle_sim.autopilots import (
    FRAMES_ABOVE_TERRAIN,
    Place,
    Setpoint,
    height_amsl_m,
)
from vehicle_sim.autopilots.ardupilot.copter_control import PositionControl
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector, flat_earth_place, offset
from vehicle_sim.geodesy import around, degrees_east, metres_per_degree

# --- How ArduCopter reads SET_POSITION_TARGET: masks, frames, and what it calls "stop" ------------
# Measured on ArduCopter 4.7 (ardupilot.md 3): any single ignored axis drops its whole group, bits
# above 11 are not read, and invalid setpoints stop the vehicle without an answer.  Where the real
# one aborts its process (a number that is not finite, a position in the millions), this one stops
# and sends a text that begins with "SIM:".

IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
_FORCE, IGNORE_YAW, IGNORE_YAW_RATE = 0x200, 0x400, 0x800
_LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED = 1, 7, 8, 9
_LOCAL_FRAMES = (_LOCAL_NED, _LOCAL_OFFSET_NED, _BODY_NED, _BODY_OFFSET_NED)
_FARTHEST_M = 1e6
_FASTEST_M_S = 1000.0


@final
class Target(NamedTuple):
    """A decoded setpoint; missing parts are None.  Vectors north, east, up."""

    place: Place | None
    velocity_neu_m_s: Vector | None
    acceleration_neu_m_s2: Vector
    yaw_rad: float | None = None
    yaw_rate_rad_s: float | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A setpoint that means "stop", with a text, if any."""

    text: str | None = None


@final
class SetpointFrames(NamedTuple):
    """Reference frames of setpoints."""

    vehicle: Place
    heading_rad: float
    home: Place
    origin: Place


def read_setpoint(setpoint: Setpoint, bearings: SetpointFrames) -> Target | Stop:
    """Decode a setpoint as ArduCopter does in GUIDED."""
    mask = setpoint.type_mask
    use_position = not mask & IGNORE_POSITION
    use_velocity = not mask & IGNORE_VELOCITY
    use_acceleration = not mask & IGNORE_ACCELERATION
    if use_acceleration and mask & _FORCE:
        return Stop()
    if use_velocity and not all(abs(v) <= _FASTEST_M_S for v in setpoint.velocity_ned_m_s):
        return Stop()  # NaN too
    dropped = setpoint.is_global and use_position and use_velocity
    honoured = use_acceleration and not dropped  # GLOBAL_INT takes position and velocity only
    if not setpoint.is_global and setpoint.frame not in _LOCAL_FRAMES:
        return Stop()
    if use_acceleration and use_position and not use_velocity:
        return Stop()
    if not (use_position or use_velocity or honoured):
        return Stop()
    text = _fatal(setpoint, use_position=use_position, use_acceleration=honoured)
    if text is not None:
        return Stop(text=text)
    place = _place(setpoint, bearings, use_velocity=use_velocity) if use_position else None
    if isinstance(place, Stop):
        return place
    velocity, acceleration = setpoint.velocity_ned_m_s, setpoint.acceleration_ned_m_s2
    relative = not setpoint.is_global and setpoint.frame in (_BODY_NED, _BODY_OFFSET_NED)
    yaw_rad = None if mask & IGNORE_YAW else setpoint.yaw_rad
    if yaw_rad is not None and relative:
        yaw_rad += bearings.heading_rad
    return Target(
        place=place,
        velocity_neu_m_s=_north_east_up(setpoint, velocity, bearings) if use_velocity else None,
        acceleration_neu_m_s2=_north_east_up(setpoint, acceleration, bearings)
        if honoured
        else (0.0, 0.0, 0.0),
        yaw_rad=yaw_rad,
        yaw_rate_rad_s=None if mask & IGNORE_YAW_RATE else setpoint.yaw_rate_rad_s,
    )


def _fatal(setpoint: Setpoint, *, use_position: bool, use_acceleration: bool) -> str | None:
    """Values that would abort the real autopilot: a floating point trap."""
    mask = setpoint.type_mask
    used = [
        *(setpoint.position if use_position else ()),
        *(setpoint.acceleration_ned_m_s2 if use_acceleration else ()),
        *(() if mask & IGNORE_YAW else (setpoint.yaw_rad,)),
        *(() if mask & IGNORE_YAW_RATE else (setpoint.yaw_rate_rad_s,)),
    ]
    if not all(map(math.isfinite, used)):
        return "SIM: setpoint not finite refused: aborts ArduPilot"
    if use_position and max(map(abs, setpoint.position)) > _FARTHEST_M:
        return "SIM: setpoint too far refused: aborts ArduPilot"
    return None


def _place(setpoint: Setpoint, bearings: SetpointFrames, *, use_velocity: bool) -> Place | Stop:
    """Where the setpoint is."""
    if not setpoint.is_global:
        return _local_place(setpoint, bearings)
    latitude_deg, longitude_deg, altitude_m = setpoint.position
    if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
        return Stop()
    if setpoint.frame in FRAMES_ABOVE_TERRAIN and use_velocity:
        return Stop()
    height_m = height_amsl_m(setpoint.frame, altitude_m, bearings.home.altitude_amsl_m)
    if height_m is None:
        return Stop()
    return Place(latitude_deg, longitude_deg, height_m)


def _local_place(setpoint: Setpoint, bearings: SetpointFrames) -> Place:
    if setpoint.frame == _LOCAL_NED:
        return flat_earth_place(bearings.origin, setpoint.position)
    return offset(bearings.vehicle, *_north_east_up(setpoint, setpoint.position, bearings))


def _north_east_up(setpoint: Setpoint, vector: Vector, bearings: SetpointFrames) -> Vector:
    """Turn a vector out of the setpoint's frame."""
    x, y, down = vector
    if setpoint.is_global or setpoint.frame not in (_BODY_NED, _BODY_OFFSET_NED):
        return x, y, -down
    sine, cosine = math.sin(bearings.heading_rad), math.cos(bearings.heading_rad)
    return x * cosine - y * sine, x * sine + y * cosine, -down


MIN_TIMEOUT_S = 0.1
NOTHING: Vector = (0.0, 0.0, 0.0)
KP_1_S2 = 0.75
KV_1_S = 4.0
"""Well damped (2.3): the vehicle's acceleration overshoots a step of the path's by 4 %."""
_STREAM_GAP_S = 0.5


class Submode(enum.Enum):
    """What GUIDED steers for."""

    TAKEOFF = enum.auto()
    POSITION = enum.auto()
    POSITION_VELOCITY = enum.auto()
    VELOCITY = enum.auto()
    """Also standing still: what every setpoint that is not liked leads to."""
    ACCELERATION = enum.auto()


_STANDS = (Submode.TAKEOFF, Submode.POSITION)
"""Without a target that runs on."""


@final
class Tracker:
    """A law for airframes without drag, which ArduCopter's controller was never tuned for.

    The bundled worlds fly a copter at 150 m/s with 9 m/s2 of lateral acceleration: no such vehicle
    exists, and WPNAV_ACCEL would not let the real controller correct so hard.  With a position and
    a velocity streamed it accelerates by the errors in both,

        a = KP (p_target - p) + KV (v_target - v),

    without a feed-forward of acceleration where ArduCopter drops it: in a steady turn it is a / KP
    to the outside.
    Between setpoints the velocity error is taken against a velocity that goes on changing as it
    has: held still, it would saw the acceleration up and down at the rate of the stream.
    """

    def __init__(self, control: PositionControl) -> None:
        self._control = control
        self.received_us = 0
        self.forget()

    def forget(self) -> None:
        """Forget the setpoint stream."""
        self._slope: Vector = (0.0, 0.0, 0.0)
        self._interval_s = 0.0

    def learn(self, before: Vector, velocity: Vector, now_us: int, *, streams: bool) -> None:
        """A setpoint with this velocity, after one with that."""
        gap_s = (now_us - self.received_us) * 1e-6
        self.received_us = now_us
        if gap_s < 1e-3:
            return
        limits = self._control.copter.limits
        slope = tuple((new - old) / gap_s for new, old in zip(velocity, before, strict=True))
        smooth = math.hypot(slope[0], slope[1]) <= limits.acceleration_m_s2 and (
            abs(slope[2]) <= limits.acceleration_vertical_m_s2
        )
        if streams and gap_s <= _STREAM_GAP_S and smooth:
            self._slope, self._interval_s = (slope[0], slope[1], slope[2]), gap_s
        else:
            self.forget()

    def wanted(self, guided: "Guided", now_us: int) -> Vector:
        """Acceleration north, east, up towards the target that moves."""
        estimate, tuning = self._control.estimate, self._control.tuning
        metres_north, metres_east = metres_per_degree(estimate.latitude_deg)
        north_m = (guided.latitude_deg - estimate.latitude_deg) * metres_north
        east_m = degrees_east(estimate.longitude_deg, guided.longitude_deg) * metres_east
        up_m = guided.altitude_amsl_m - estimate.altitude_amsl_m
        north, east = north_m * KP_1_S2, east_m * KP_1_S2
        square, most = north * north + east * east, KV_1_S * tuning.speed_m_s
        if square > most * most:
            share = most / math.sqrt(square)
            north, east = north * share, east * share
        most_up = KV_1_S * tuning.speed_up_m_s
        up = up_m * KP_1_S2
        up = -most_up if up < -most_up else most_up if up > most_up else up
        age_s = (now_us - self.received_us) * 1e-6
        ahead_s = age_s if age_s <= 2.0 * self._interval_s else 0.0
        v_n, v_e, v_u = guided.velocity
        s_n, s_e, s_u = self._slope
        a_n, a_e, a_u = guided.acceleration
        return (
            north + KV_1_S * (v_n + s_n * ahead_s - estimate.velocity_north_m_s) + a_n,
            east + KV_1_S * (v_e + s_e * ahead_s - estimate.velocity_east_m_s) + a_e,
            up + KV_1_S * (v_u + s_u * ahead_s - estimate.velocity_up_m_s) + a_u,
        )


@final
class Guided:
    """The target, and what it makes the position controller do."""

    def __init__(self, control: PositionControl, timeout_s: float) -> None:
        self.control = control
        copter = control.copter
        self.tracker = None if copter.drag_1_s else Tracker(control)
        self.latitude_deg = self.longitude_deg = self.altitude_amsl_m = 0.0
        self.received_us = 0
        self.paused = False
        self.submode = Submode.VELOCITY
        self.velocity: Vector = NOTHING
        self.acceleration: Vector = NOTHING
        self._was_tracking = False
        self.set_timeout(timeout_s)

    def set_timeout(self, timeout_s: float) -> None:
        """GUID_TIMEOUT."""
        self.timeout_us = max(timeout_s, MIN_TIMEOUT_S) * 1e6

    def stop(self) -> None:
        """Reset to zero velocity: mode_guided.init."""
        self._begin(Submode.VELOCITY)
        self.velocity = self.acceleration = NOTHING

    def _begin(self, submode: Submode) -> None:
        self.submode = submode
        control = self.control
        control.start()
        if self.tracker is not None:
            self.tracker.forget()
            copter = control.copter
            control.follow(copter.acceleration_north_m_s2, copter.acceleration_east_m_s2)
        self._was_tracking = False

    def take_off(self, place: Place) -> None:
        """Climb straight up to there."""
        self._begin(Submode.TAKEOFF)
        self.velocity = self.acceleration = NOTHING
        self.hold(place)

    def hold(self, place: Place) -> None:
        """Put the target here."""
        self.latitude_deg, self.longitude_deg = place.latitude_deg, place.longitude_deg
        self.altitude_amsl_m = place.altitude_amsl_m

    @property
    def place(self) -> Place:
        """Where the target is."""
        return Place(self.latitude_deg, self.longitude_deg, self.altitude_amsl_m)

    def take(self, target: Target, now_us: int) -> None:
        """Take a setpoint."""
        submode = _submode(target)
        velocity = target.velocity_neu_m_s or NOTHING
        if self.tracker is not None:
            streams = submode is self.submode is Submode.POSITION_VELOCITY
            streams = streams and not any(target.acceleration_neu_m_s2)
            self.tracker.learn(self.velocity, velocity, now_us, streams=streams)
        if submode is not self.submode:
            received_us = now_us if self.tracker is None else self.tracker.received_us
            self._begin(submode)
            if self.tracker is not None:
                self.tracker.received_us = received_us
        if target.place is not None:
            self.hold(target.place)
        self.velocity, self.acceleration = velocity, target.acceleration_neu_m_s2
        self.received_us = now_us

    def run(self, now_us: int, dt_s: float) -> None:
        """Let the target run on with its velocity."""
        submode = self.submode
        if submode in _STANDS:
            return
        if now_us - self.received_us > self.timeout_us:
            self.velocity = self.acceleration = NOTHING
            if submode is Submode.ACCELERATION:
                self.submode = Submode.VELOCITY
            return
        north, east, up = self.velocity
        a_n, a_e, a_u = self.acceleration
        if submode is Submode.POSITION_VELOCITY:
            metres_north, metres_east = metres_per_degree(self.latitude_deg)
            half = 0.5 * dt_s * dt_s
            self.latitude_deg += (north * dt_s + a_n * half) / metres_north
            moved_deg = (east * dt_s + a_e * half) / metres_east
            self.longitude_deg = around(self.longitude_deg + moved_deg)
            self.altitude_amsl_m += up * dt_s + a_u * half
        if submode is not Submode.ACCELERATION:
            self.velocity = (north + a_n * dt_s, east + a_e * dt_s, up + a_u * dt_s)

    def wanted(self, now_us: int, dt_s: float) -> Vector:
        """Acceleration north, east and up, in m/s^2."""
        control, submode = self.control, self.submode
        if self.tracker is not None:
            if (
                submode is Submode.POSITION_VELOCITY
                and now_us - self.received_us <= self.timeout_us
                and not self.paused
            ):
                self._was_tracking = True
                return self.tracker.wanted(self, now_us)
            if self._was_tracking:
                self._was_tracking = False
                copter = control.copter
                control.start_vertical()
                control.follow(copter.acceleration_north_m_s2, copter.acceleration_east_m_s2)
        control.moved(dt_s)
        if self.paused or submode is Submode.VELOCITY:
            north, east, up = NOTHING if self.paused else self.velocity
            a_n, a_e, a_u = NOTHING if self.paused else self.acceleration
            control.towards_velocity(north, east, a_n, a_e, dt_s)
            control.towards_climb(up, a_u, dt_s)
        elif submode is Submode.ACCELERATION:
            self._accelerate(dt_s)
        elif submode is Submode.POSITION_VELOCITY:
            north, east, up = self.velocity
            a_n, a_e, a_u = self.acceleration
            control.towards_place(
                self.latitude_deg,
                self.longitude_deg,
                (north, east),
                (a_n, a_e),
                control.speed_m_s,
                dt_s,
            )
            control.towards_altitude(self.altitude_amsl_m, up, a_u, dt_s)
        else:
            control.fly_to(self.latitude_deg, self.longitude_deg, self.altitude_amsl_m, dt_s)
        return control.wanted(dt_s)

    def _accelerate(self, dt_s: float) -> None:
        control = self.control
        a_n, a_e, a_u = self.acceleration
        jerk = control.tuning.jerk_m_s3 * dt_s
        step_n, step_e = a_n - control.acceleration_north, a_e - control.acceleration_east
        size = math.hypot(step_n, step_e)
        share = 1.0 if size <= jerk else jerk / size
        control.acceleration_north += step_n * share
        control.acceleration_east += step_e * share
        control.towards_climb(control.velocity_up, a_u, dt_s)


def _submode(target: Target) -> Submode:
    if target.place is None:
        return Submode.ACCELERATION if target.velocity_neu_m_s is None else Submode.VELOCITY
    return Submode.POSITION if target.velocity_neu_m_s is None else Submode.POSITION_VELOCITY
