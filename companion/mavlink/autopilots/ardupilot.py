"""What ArduCopter and ArduPlane share: what their estimator says, and their flat earth."""

import math
from collections.abc import Mapping

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots.from_wire import echo_at
from companion.mavlink.autopilots.to_wire import command_long
from companion.mavlink.dialect import Message, wire
from companion.mission.events import Echo, Estimator, Mode, Vector

_NEEDED = (
    wire.EKF_ATTITUDE | wire.EKF_VELOCITY_HORIZ | wire.EKF_POS_HORIZ_ABS | wire.EKF_POS_VERT_ABS
)
_BAD = wire.EKF_CONST_POS_MODE | wire.EKF_UNINITIALIZED | wire.EKF_GPS_GLITCHING
_REJECTED = 1.0
"""Innovation over its gate: from here on the estimator throws the measurements away, and will give
in to them 10 s later with a jump.  Healthy flights stay below 0.1 (recorded)."""
_M_PER_DEG = 111_318.84502145034
"""Of ArduPilot's flat earth: one degree of latitude, anywhere."""
_LEAST_SCALE = 0.01


def estimator(message: Message, now_s: float) -> Estimator:
    """EKF_STATUS_REPORT: whether the horizontal position may be believed (ardupilot.md 5)."""
    flags = message.flags
    sure = flags & _NEEDED == _NEEDED and not flags & _BAD
    variances = (message.pos_horiz_variance, message.velocity_variance)
    fits = all(math.isfinite(v) and v < _REJECTED for v in variances)
    return Estimator(time_s=now_s, good=sure and fits)


def mode_message(number: int, system_id: int) -> Message:
    """DO_SET_MODE with the autopilot's own number."""
    flag = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return command_long(system_id, wire.MAV_CMD_DO_SET_MODE, flag, number)


def mode_names(enum: str) -> Mapping[int, str]:
    """The dialect's names of a vehicle's modes: COPTER_MODE, PLANE_MODE."""
    entries = wire.enums[enum].items()
    return {
        number: entry.name.removeprefix(f"{enum}_").replace("_", " ")
        for number, entry in entries
        if not entry.name.endswith("ENUM_END")
    }


def mode_in(table: Mapping[Mode, tuple[int, ...]], custom_mode: int) -> Mode:
    """The mode that a number stands for; the first number of each is the one that is asked for."""
    for mode, numbers in table.items():
        if custom_mode in numbers:
            return mode
    return Mode.OTHER


def local_echo(
    message: Message, now_s: float, frame: LocalFrame, origin_nea_m: Vector | None
) -> Echo | None:
    """POSITION_TARGET_LOCAL_NED, from the estimator's origin on ArduPilot's flat earth."""
    if origin_nea_m is None or message.type_mask & 0x7:
        return None
    latitude, longitude = frame.to_geodetic_deg(origin_nea_m[0], origin_nea_m[1])
    place = _offset_deg((latitude, longitude), message.x, message.y)
    velocity = None if message.type_mask & 0x38 else (message.vx, message.vy, message.vz)
    return echo_at(place, origin_nea_m[2] - message.z, velocity, now_s, frame)


def _offset_deg(
    origin_deg: tuple[float, float], north_m: float, east_m: float
) -> tuple[float, float]:
    """Latitude and longitude of a point of the flat earth about an origin."""
    latitude = origin_deg[0] + north_m / _M_PER_DEG
    middle = math.radians(0.5 * (origin_deg[0] + latitude))
    scale = max(math.cos(middle), _LEAST_SCALE) if math.isfinite(middle) else 1.0
    return latitude, origin_deg[1] + east_m / (_M_PER_DEG * scale)
