"""What ArduCopter and ArduPlane share: streams, modes, their estimator and their flat earth."""

import math
import re
from collections.abc import Mapping
from typing import Final

from companion.geodesy import LocalFrame
from companion.mavlink import rules
from companion.mavlink.autopilots.common import Firmware
from companion.mavlink.autopilots.messages import echo_at
from companion.mavlink.dialect import Message, enum_word, wire
from companion.mavlink.fence import FenceSettings
from companion.mavlink.rules import Rule, only_read
from companion.mission.events import Echo, Estimator, Vector

INTERMITTENT = frozenset({wire.MAVLINK_MSG_ID_HOME_POSITION, wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN})
"""Until there is one."""
_NEEDED = (
    wire.EKF_ATTITUDE | wire.EKF_VELOCITY_HORIZ | wire.EKF_POS_HORIZ_ABS | wire.EKF_POS_VERT_ABS
)
"""Flags of an estimator with a valid horizontal position."""
_BAD = wire.EKF_CONST_POS_MODE | wire.EKF_UNINITIALIZED | wire.EKF_GPS_GLITCHING
_REJECTED = 1.0
"""Innovation test ratio: above this the estimator rejects the measurements, and 10 s later it
resets to them with a jump.  Healthy flights stay below 0.1 (recorded)."""
_NO_VELOCITY = (
    wire.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | wire.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | wire.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
_M_PER_DEG = 111_318.84502145034
"""Of ArduPilot's flat earth: one degree of latitude, anywhere."""
_MIN_SCALE = 0.01


def streams_hz(echo: int, echo_hz: float) -> Mapping[int, float]:
    """Message id -> rate, with the echo of setpoints that this kind of vehicle has."""
    return {
        wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        wire.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
        wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
        echo: echo_hz,
        wire.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
        wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
        wire.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        wire.MAVLINK_MSG_ID_ATTITUDE: 5.0,  # a clock when the position does not come
    }


def names_of(enum: str) -> Mapping[tuple[int, ...], str]:
    """Names of modes as in the dialect; enum: COPTER_MODE or PLANE_MODE."""
    numbers = [number for number, entry in wire.enums[enum].items() if "ENUM_END" not in entry.name]
    return {(number,): enum_word(enum, number).replace("_", " ") for number in numbers}


def estimator(message: Message, now_s: float, *_: object) -> Estimator:
    """EKF_STATUS_REPORT: whether the horizontal position may be believed (ardupilot.md 5)."""
    flags = message.flags
    sure = flags & _NEEDED == _NEEDED and not flags & _BAD
    variances = (message.pos_horiz_variance, message.velocity_variance)
    fits = all(0.0 <= v < _REJECTED for v in variances)
    return Estimator(time_s=now_s, good=sure and fits)


def local_echo(
    message: Message, now_s: float, frame: LocalFrame, origin_nea_m: Vector | None
) -> Echo | None:
    """POSITION_TARGET_LOCAL_NED, from the estimator's origin on ArduPilot's flat earth."""
    if origin_nea_m is None or message.type_mask & 0x7:
        return None
    latitude, longitude = frame.to_geodetic_deg(origin_nea_m[0], origin_nea_m[1])
    place = _offset_deg((latitude, longitude), message.x, message.y)
    velocity = (message.vx, message.vy, -message.vz)
    has_velocity = message.type_mask & _NO_VELOCITY == 0 and all(map(math.isfinite, velocity))
    altitude_m = origin_nea_m[2] - message.z
    return echo_at(place, altitude_m, now_s, frame, velocity if has_velocity else None)


def _offset_deg(
    origin_deg: tuple[float, float], north_m: float, east_m: float
) -> tuple[float, float]:
    """Latitude and longitude of a point of the flat earth about an origin."""
    latitude = origin_deg[0] + north_m / _M_PER_DEG
    middle = math.radians(0.5 * (origin_deg[0] + latitude))
    scale = max(math.cos(middle), _MIN_SCALE) if math.isfinite(middle) else 1.0
    return latitude, origin_deg[1] + east_m / (_M_PER_DEG * scale)


_GROUND_STATION: Final = rules.when(  # its heartbeats must not count as a ground station's
    lambda value, case: value == case.values.get("MAV_SYSID"),
    "the companion has the vehicle's system id, so its heartbeats would hide the loss of the "
    "ground station",
    "Set it to the ground station's own, 255",
)
RULES: Final = (
    Rule("MAV_SYSID", also="SYSID_THISMAV"),
    Rule("MAV_GCS_SYSID", _GROUND_STATION, also="SYSID_MYGCS"),
    *only_read("ARMING_CHECK ARMING_SKIPCHK FENCE_ENABLE FENCE_AUTOENABLE FENCE_TYPE FENCE_RADIUS"),
    *only_read("FENCE_ALT_MAX FENCE_ALT_MIN FENCE_MARGIN FENCE_OPTIONS FENCE_ACTION"),
)
"""Those of the fence are read by `_fence`."""


_ALT_MAX, _CIRCLE, _ALT_MIN = 1, 2, 8
"""Bits of FENCE_TYPE."""
_UNION = 2
"""Bit of FENCE_OPTIONS: the union of the inclusion zones is allowed."""
_KEPT = "FENCE_ENABLE = 0: the fence that is drawn is kept all the same"


def _fence(parameters: Mapping[str, float]) -> FenceSettings:
    """FENCE_*: on, or by itself at take-off or on arming, it is a cylinder about home as well."""
    finite = {name: value if math.isfinite(value) else 0.0 for name, value in parameters.items()}
    is_on = parameters.get("FENCE_ENABLE", 0.0) or parameters.get("FENCE_AUTOENABLE", 0.0)
    kinds = int(finite.get("FENCE_TYPE", 0.0)) if is_on else 0
    has_one = "FENCE_ENABLE" in parameters
    return FenceSettings(
        margin_m=max(finite.get("FENCE_MARGIN", 0.0), 0.0),
        union=not has_one or bool(int(finite.get("FENCE_OPTIONS", 0.0)) & _UNION),
        radius_m=finite.get("FENCE_RADIUS") if kinds & _CIRCLE else None,
        above_m=finite.get("FENCE_ALT_MAX") if kinds & _ALT_MAX else None,
        below_m=finite.get("FENCE_ALT_MIN") if kinds & _ALT_MIN else None,
        note="" if is_on or not has_one else _KEPT,
    )


FIRMWARE: Final = Firmware(
    name="ardupilot",
    number=wire.MAV_AUTOPILOT_ARDUPILOTMEGA,
    fence=_fence,
    breached=re.compile(r"\bfences? breached", re.IGNORECASE),  # ardupilot.md 4
    all_is_well=lambda: wire.MAVLink_ekf_status_report_message(_NEEDED, *[0.0] * 5),
    lasting_battery={"BATT_CAPACITY": 100_000.0},
    home_first=True,
)
