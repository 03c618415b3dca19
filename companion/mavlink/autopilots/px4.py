"""What PX4's multicopter and fixed wing share: setpoints in OFFBOARD; both hold in AUTO.LOITER.

PX4 acknowledges a mode change twice, the first time unconditionally: only the heartbeat counts.
OFFBOARD needs a running setpoint stream, and after a failsafe a running stream re-enters it: stop
streaming before requesting any other mode.  Measured: px4.md.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

import pyproj

from companion.geodesy import LocalFrame
from companion.mavlink import fence, rules
from companion.mavlink.autopilots import messages
from companion.mavlink.autopilots.common import Firmware, Modes
from companion.mavlink.dialect import Message, wire
from companion.mavlink.fence import FenceSettings
from companion.mavlink.plan_client import PlanItem
from companion.mavlink.rules import Case, Finding, Rule, only_read
from companion.mission.events import Echo, Estimator, Mode, Vector

_AUTO = 4
_MAIN_NAMES: Final = (
    *("", "Manual", "Altitude", "Position", "", "Acro", "Offboard", "Stabilized", "Rattitude"),
)
_AUTO_NAMES: Final = (
    *("", "Ready", "Takeoff", "Hold", "Mission", "Return", "Land", "", "Follow Target"),
    *("Precision Land", "VTOL Takeoff"),
)
"""By number, as PX4's ground stations call them; empty: there is none."""
_NEEDED = (
    wire.ESTIMATOR_ATTITUDE
    | wire.ESTIMATOR_VELOCITY_HORIZ
    | wire.ESTIMATOR_POS_HORIZ_ABS
    | wire.ESTIMATOR_POS_VERT_ABS
)
"""Flags of an estimator with a valid horizontal position."""
_BAD = wire.ESTIMATOR_GPS_GLITCH | wire.ESTIMATOR_ACCEL_ERROR
_REJECTED = 1.0
"""Innovation over its gate, where EKF2 throws the measurement away; healthy: below 0.4.  NaN of one
that it does not use."""
_SPHERE: Final = pyproj.Geod(a=6_371_000.0, f=0.0)
"""On which PX4 projects, metres: its local frame is the azimuthal equidistant map of it."""
KEEP_YAW = math.nan
"""Yaw of a command: MAVLink's "not given".  PX4 takes for radians what the message definition of
NAV_TAKEOFF has in degrees.  The one place where something not finite is sent, and never in a
setpoint."""
STREAMS_HZ: Mapping[int, float] = {
    wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    wire.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    wire.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 5.0,
    wire.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
    wire.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
INTERMITTENT = frozenset({wire.MAVLINK_MSG_ID_HOME_POSITION})  # until there is one
REQUESTED_ONCE = (wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, wire.MAVLINK_MSG_ID_HOME_POSITION)


def _numbers(custom_mode: int) -> tuple[int, int]:
    """Main and sub mode; custom_mode is main << 16 | sub << 24."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    return main, sub if main == _AUTO else 0


MODES: Final = Modes(  # the failsafe DESCEND is told as LAND
    meanings={
        (6, 0): Mode.GUIDED,
        (_AUTO, 2): Mode.TAKE_OFF,
        (_AUTO, 3): Mode.HOLD,
        (_AUTO, 5): Mode.RETURN,
        (_AUTO, 6): Mode.LAND,
        (_AUTO, 9): Mode.LAND,  # precisely
    },
    numbers=_numbers,
    names={
        **{(main, 0): name for main, name in enumerate(_MAIN_NAMES)},
        **{(_AUTO, sub): name for sub, name in enumerate(_AUTO_NAMES)},
    },
)


def take_off(to: messages.To, place_nea_m: Vector) -> list[Message]:
    """NAV_TAKEOFF to a place, its altitude AMSL; empty if it is not finite or out of range."""
    parameters = (0.0, 0.0, 0.0, KEEP_YAW)
    return messages.command_at(to, wire.MAV_CMD_NAV_TAKEOFF, parameters, place_nea_m)


def estimator(message: Message, now_s: float, *_: object) -> Estimator:
    """ESTIMATOR_STATUS: whether the horizontal position may be believed (px4.md 8)."""
    flags = message.flags
    sure = flags & _NEEDED == _NEEDED and not flags & _BAD
    rejects = message.pos_horiz_ratio >= _REJECTED or message.vel_ratio >= _REJECTED
    error_m = message.pos_horiz_accuracy
    known = math.isfinite(error_m) and error_m > 0.0
    return Estimator(
        time_s=now_s, good=bool(sure and not rejects), error_m=error_m if known else None
    )


def local_echo(
    message: Message, now_s: float, frame: LocalFrame, origin_nea_m: Vector | None
) -> Echo | None:
    """POSITION_TARGET_LOCAL_NED, from the estimator's origin on PX4's sphere."""
    if origin_nea_m is None or message.type_mask & 0x7:
        return None
    if not (math.isfinite(message.x) and math.isfinite(message.y)):
        return None
    latitude, longitude = frame.to_geodetic_deg(origin_nea_m[0], origin_nea_m[1])
    azimuth_deg = math.degrees(math.atan2(message.y, message.x))
    far_m = math.hypot(message.x, message.y)
    longitude, latitude, _ = _SPHERE.fwd(longitude, latitude, azimuth_deg, far_m)
    return messages.echo_at((latitude, longitude), origin_nea_m[2] - message.z, now_s, frame)


_WITHOUT_STREAM: Final = {
    0: "sinks without RC",
    1: "sinks without RC",
    2: "falls off level without RC",
    6: "stops its motors",
    7: "stops its motors",
}
"""COM_OBL_RC_ACT (px4.md 6): without RC, Position, Altitude and Stabilized sink."""
_STAYS: Final = (3, 4, 5)
"""It returns, lands or holds: left as it stands (docs/reference/parameters.md)."""


def _offboard_loss(value: float, _case: Case) -> Finding | None:
    if value in _STAYS:
        return None
    does = _WITHOUT_STREAM.get(int(value), "does so")
    return Finding(f"when the stream stops the vehicle {does}", set_to=5.0)


_NO_GPS: Final = rules.when(
    lambda value, _: not value,
    "the vehicle flies without GPS",
    "Set it to the number of its receivers",
)
RULES: Final = (
    Rule("COM_OBL_RC_ACT", _offboard_loss, "what it does when the stream stops"),
    *only_read(
        "COM_RCL_EXCEPT COM_RC_IN_MODE COM_RC_OVERRIDE NAV_DLL_ACT COM_TAKEOFF_ACT GF_ACTION"
    ),
    *only_read("GF_MAX_HOR_DIST GF_MAX_VER_DIST"),
    Rule("SYS_HAS_GPS", _NO_GPS),
    *only_read("MIS_TAKEOFF_ALT"),
)


def _fence(parameters: Mapping[str, float]) -> FenceSettings:
    """GF_*: a cylinder about home; of inclusion zones one is enough (px4.md 7)."""
    far_m, high_m = (parameters.get(f"GF_MAX_{way}_DIST", 0.0) for way in ("HOR", "VER"))
    return FenceSettings(
        union=True,
        radius_m=far_m if 0.0 < far_m < math.inf else None,
        above_m=high_m if 0.0 < high_m < math.inf else None,
    )


def _misread(items: Sequence[PlanItem], who: str) -> str:
    """Which polygons an autopilot of that name misreads, with the remedy; empty: none.

    After the first circle PX4's `geofence.cpp` takes each corner of a polygon for the beginning of
    another one, so that it keeps the vehicle out of places that no zone covers (px4.md 7).
    """
    circle = ""
    for number, (first, *_) in enumerate(fence.shapes_of(items), start=1):
        side = "inclusion" if first.command in (fence.POLYGON_IN, fence.CIRCLE_IN) else "exclusion"
        if first.command in (fence.CIRCLE_IN, fence.CIRCLE_OUT):
            circle = circle or f"{side} {number}"
        elif first.command in (fence.POLYGON_IN, fence.POLYGON_OUT) and circle:
            return (
                f"{who} misreads its fence, and may stop where no zone is: polygons come after a "
                f"circle ({side} {number} after {circle}). Upload polygons before circles"
            )
    return ""


def event_id(name: str) -> int:
    """The id of one of its events, without the component's byte: FNV-1a of its name (px4.md 7)."""
    value = 0x811C9DC5
    for byte in name.encode():
        value = (value ^ byte) * 0x01000193 & 0xFFFFFFFF
    return value & 0xFFFFFF


FIRMWARE: Final = Firmware(
    name="px4",
    number=wire.MAV_AUTOPILOT_PX4,
    fence=_fence,
    breached=re.compile(r"^geofence( violation)?: ", re.IGNORECASE),  # to a station alone
    breach_events=frozenset(
        event_id(f"check_gf_violation{why}")
        for why in ("", "_max_hor_dist", "_max_alt", "_custom_gf")
    ),
    misread=_misread,
    all_is_well=lambda: wire.MAVLink_estimator_status_message(0, _NEEDED, *[0.0] * 8),
    lasting_battery={"SIM_BAT_DRAIN": 10_000.0},
    is_bytewise=True,
    asks_time_often=True,  # px4.md 2
)
