"""How PX4 reads SET_POSITION_TARGET: masks and frames, each axis by itself (px4.md 4).

What is not given is NaN, as inside PX4.  Nothing is answered: a message that is not understood
counts as no setpoint, and OFFBOARD ends when that has lasted for a second.
"""

import math
from typing import Final, NamedTuple, final

from vehicle_sim.autopilots import Place, Setpoint

# --- PX4's local frame: azimuthal equidistant about the estimator's origin, on a sphere -----------
# MapProjection of PX4's geo library, radius 6371 km: what LOCAL_POSITION_NED and the setpoints of
# SET_POSITION_TARGET_LOCAL_NED are in, and what GLOBAL_INT setpoints are converted by.

_RADIUS_M = 6_371_000.0
_NEAR_RAD = 1e-9


@final
class Projection:
    """North and east metres about an origin."""

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self._latitude_rad = math.radians(latitude_deg)
        self._longitude_rad = math.radians(longitude_deg)
        self._sine = math.sin(self._latitude_rad)
        self._cosine = math.cos(self._latitude_rad)

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east of a place, in metres."""
        latitude_rad = latitude_deg * 0.017453292519943295
        east_rad = longitude_deg * 0.017453292519943295 - self._longitude_rad
        sine, cosine = math.sin(latitude_rad), math.cos(latitude_rad)
        cos_east = math.cos(east_rad)
        north = self._cosine * sine - self._sine * cosine * cos_east
        east = cosine * math.sin(east_rad)
        away = math.hypot(north, east)
        # atan2 where PX4 has acos: the same, but for rounding near the origin.
        angle = math.atan2(away, self._sine * sine + self._cosine * cosine * cos_east)
        scale = _RADIUS_M * (angle / away if away > _NEAR_RAD else 1.0)
        return scale * north, scale * east

    def to_geographic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude of a point, in degrees."""
        away_m = math.hypot(north_m, east_m)
        angle = away_m / _RADIUS_M
        if angle < 1e-12:
            return math.degrees(self._latitude_rad), math.degrees(self._longitude_rad)
        sine, cosine = math.sin(angle), math.cos(angle)
        north, east = north_m / away_m, east_m / away_m
        latitude_rad = math.asin(
            min(max(cosine * self._sine + north * sine * self._cosine, -1.0), 1.0)
        )
        longitude_rad = self._longitude_rad + math.atan2(
            east * sine, self._cosine * cosine - north * self._sine * sine
        )
        longitude_deg = math.degrees(math.remainder(longitude_rad, math.tau))
        return math.degrees(latitude_rad), longitude_deg

    def place(self, north_m: float, east_m: float, altitude_amsl_m: float) -> Place:
        """A point, at this height."""
        return Place(*self.to_geographic(north_m, east_m), altitude_amsl_m)


Vector = tuple[float, float, float]

_NAN: Final = math.nan
NOTHING: Final = (_NAN, _NAN, _NAN)
_FORCE, _IGNORE_YAW, _IGNORE_YAW_RATE = 0x200, 0x400, 0x800
_POSITION_BITS = 0x007
_LOCAL_NED, _BODY_NED = 1, 8
_AMSL, _ABOVE_HOME, _ABOVE_TERRAIN = 5, 6, 11


@final
class Target(NamedTuple):
    """A setpoint that was understood, in the local frame (north, east, down); NaN: not given."""

    position_m: Vector = NOTHING
    velocity_m_s: Vector = NOTHING
    acceleration_m_s2: Vector = NOTHING
    yaw_rad: float = _NAN
    yaw_rate_rad_s: float = _NAN


@final
class SetpointFrames(NamedTuple):
    """Reference frames of setpoints."""

    projection: Projection
    origin_amsl_m: float
    home_amsl_m: float
    ground_amsl_m: float
    heading_rad: float


def read_setpoint(setpoint: Setpoint, bearings: SetpointFrames) -> Target | None:
    """Decode a setpoint as PX4 does; None: it is dropped and does not count."""
    mask = setpoint.type_mask
    if not setpoint.is_global and setpoint.frame not in (_LOCAL_NED, _BODY_NED):
        return None
    acceleration = _given(setpoint.acceleration_ned_m_s2, mask >> 6)
    if mask & _FORCE and any(map(math.isfinite, acceleration)):
        return None
    velocity = _given(setpoint.velocity_ned_m_s, mask >> 3)
    position: Vector | None
    if setpoint.is_global:
        position = _global_position(setpoint, bearings)
    else:
        position = _given(setpoint.position, mask)
        if setpoint.frame == _BODY_NED:
            if any(map(math.isfinite, position)):
                return None
            velocity = _turned(velocity, bearings.heading_rad)
            acceleration = _turned(acceleration, bearings.heading_rad)
    if position is None or not any(map(math.isfinite, position + velocity + acceleration)):
        return None
    return Target(
        position_m=position,
        velocity_m_s=velocity,
        acceleration_m_s2=acceleration,
        yaw_rad=_finite(setpoint.yaw_rad) if not mask & _IGNORE_YAW else _NAN,
        yaw_rate_rad_s=_finite(setpoint.yaw_rate_rad_s) if not mask & _IGNORE_YAW_RATE else _NAN,
    )


def flyable(target: Target) -> bool:
    """Whether the position controller can fly it: all axes have something, north and east alike.

    Otherwise it stays in OFFBOARD, brakes to a standstill and says "Failsafe: stop and wait".
    """
    position, velocity, acceleration = target[:3]
    for part in (position, velocity, acceleration):
        if math.isfinite(part[0]) != math.isfinite(part[1]):
            return False
    return all(
        math.isfinite(position[axis])
        or math.isfinite(velocity[axis])
        or math.isfinite(acceleration[axis])
        for axis in range(3)
    )


def _global_position(setpoint: Setpoint, bearings: SetpointFrames) -> Vector | None:
    """In the local frame; NOTHING if any axis is masked; None: unknown frame."""
    if setpoint.type_mask & _POSITION_BITS:
        return NOTHING
    latitude_deg, longitude_deg, altitude_m = setpoint.position
    if setpoint.frame == _AMSL:
        above_origin_m = altitude_m - bearings.origin_amsl_m
    elif setpoint.frame == _ABOVE_HOME:
        # The sign of the difference is wrong in PX4 (px4.md 1, item 6), and so it is here.
        above_origin_m = altitude_m - (bearings.home_amsl_m - bearings.origin_amsl_m)
    elif setpoint.frame == _ABOVE_TERRAIN:
        above_origin_m = altitude_m + bearings.ground_amsl_m - bearings.origin_amsl_m
    else:
        return None
    if not (math.isfinite(latitude_deg) and math.isfinite(longitude_deg)):
        return NOTHING
    north_m, east_m = bearings.projection.to_local(latitude_deg, longitude_deg)
    return north_m, east_m, _finite(-above_origin_m)


def _given(vector: Vector, ignored: int) -> Vector:
    """NaN for the axes whose bit is set, and for those that are not finite."""
    x, y, z = vector
    return (
        _NAN if ignored & 1 else _finite(x),
        _NAN if ignored & 2 else _finite(y),
        _NAN if ignored & 4 else _finite(z),
    )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else _NAN


def _turned(vector: Vector, heading_rad: float) -> Vector:
    """From the body's heading to north and east; one masked axis leaves neither."""
    x, y, z = vector
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    return x * cosine - y * sine, x * sine + y * cosine, z
