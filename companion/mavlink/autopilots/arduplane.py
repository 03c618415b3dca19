"""ArduPlane: DO_REPOSITION, streamed, to a point well ahead on the path.

SET_POSITION_TARGET moves it up and down only.  In GUIDED it flies to the point, then circles it
indefinitely: there is no stream time-out.  It has no mode that lands in place, and LOITER circles
where it is entered.  Measured: ardupilot.md 7.
"""

import math
from typing import Final

from companion.geodesy import LocalFrame, deg
from companion.mavlink import rules
from companion.mavlink.autopilots import ardupilot, messages
from companion.mavlink.autopilots.common import Autopilot, Modes
from companion.mavlink.autopilots.messages import To
from companion.mavlink.dialect import Message, wire
from companion.mavlink.rules import CENTI, Case, Finding, Rule, only_read
from companion.mission.events import Echo, Mode, Setpoint, TakeOff, Vector
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.envelope import PLANE

_ECHO = wire.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT
_FOLLOWING_RADIUS_M = 10.0
"""With a larger one it circles beside the path (ardupilot.md 7)."""
_WIDER_M = 20.0
"""Its circles are this much wider than requested, at 23 m/s (17 to 20 m measured)."""
_CIRCLE_M = 60.0
"""Radius to request if no limit is given."""
_FASTEST_M_S = 300.0
_CLOCKWISE = 0.0


def _take_off(_command: TakeOff, _here: Vector, _heading_rad: float, to: To) -> list[Message]:
    """Mode TAKEOFF, which climbs to its parameter TKOFF_ALT straight ahead, then circles.

    It starts rolling as soon as it is armed, and takes no height.  The rest of the climb to the
    mission's height is flown in GUIDED, on a circle.
    """
    return [messages.set_mode(to.system_id, wire.PLANE_MODE_TAKEOFF)]


def _set_speed(speed_m_s: float, system_id: int) -> list[Message]:
    """GUIDED_CHANGE_SPEED, an airspeed; forgotten whenever the mode changes."""
    if not 0.0 < speed_m_s < _FASTEST_M_S:
        return []
    values = wire.SPEED_TYPE_AIRSPEED, speed_m_s, 0.0, 0.0, 0, 0, 0.0
    return [messages.command_int(system_id, wire.MAV_CMD_GUIDED_CHANGE_SPEED, *values)]


def _setpoint(setpoint: Setpoint, to: To, loiter_radius_m: float) -> list[Message] | None:
    """DO_REPOSITION without the change to GUIDED: a pilot who took over keeps control."""
    whole = messages.position_target(setpoint, to)  # None: no number of it is sent
    if whole is None or not math.isfinite(loiter_radius_m):
        return None
    radius_m = _FOLLOWING_RADIUS_M
    if setpoint.stay:
        narrower_m = max(loiter_radius_m - _WIDER_M, 0.5 * loiter_radius_m)
        radius_m = narrower_m if loiter_radius_m > 0.0 else _CIRCLE_M
    there = setpoint.position_nea_m
    return messages.reposition(to, there, switch=False, radius_m=radius_m, yaw_rad=_CLOCKWISE)


def _hold_about(at_nea_m: Vector, to: To) -> list[Message]:
    """In GUIDED on its circle, as wide as it was told last: LOITER has no place."""
    return messages.reposition(to, at_nea_m, switch=False, radius_m=0.0, yaw_rad=_CLOCKWISE)


def _echo(message: Message, now_s: float, frame: LocalFrame, *_: object) -> Echo | None:
    """POSITION_TARGET_GLOBAL_INT, in every automatic mode."""
    place = (deg(message.lat_int), deg(message.lon_int))
    return messages.echo_at(place, message.alt, now_s, frame)


def _take_off_height(value: float, case: Case) -> Finding | None:
    """The autopilot's own take-off ends there; the companion climbs on."""
    limits, home_amsl_m = case.limits, case.home_amsl_m
    if home_amsl_m is None or home_amsl_m + value <= limits.ceiling_amsl_m:
        return None
    return Finding(
        f"its take-off ends at {home_amsl_m + value:.0f} m AMSL, above the ceiling of "
        f"{limits.ceiling_amsl_m:g} m",
        f"Set it to {max(case.mission.task.take_off_amsl_m - home_amsl_m, 0.0):.0f}",
    )


_RULES: Final = (
    Rule("AIRSPEED_MIN", rules.slowest, "its least airspeed", also="ARSPD_FBW_MIN"),
    Rule("AIRSPEED_MAX", rules.fastest, "its highest airspeed", also="ARSPD_FBW_MAX"),
    Rule("AIRSPEED_CRUISE", also="TRIM_ARSPD_CM"),
    Rule(
        "WP_LOITER_RAD", rules.circles(_WIDER_M, "ROLL_LIMIT_DEG"), "the circles that it holds on"
    ),
    Rule("ROLL_LIMIT_DEG", rules.bank, also="LIM_ROLL_CD", also_scale=CENTI),
    Rule("TECS_CLMB_MAX", rules.plane_climbs),
    Rule("TECS_SINK_MAX", rules.plane_sinks),
    Rule("TKOFF_ALT", _take_off_height),
    *only_read("FS_GCS_ENABL/FS_GCS_ENABLE Q_ENABLE"),
    *ardupilot.RULES,
)

ARDUPLANE = Autopilot(
    firmware=ardupilot.FIRMWARE,
    traits=VehicleTraits(
        name="ArduPlane",
        kind="plane",
        take_off=TakeoffSequence.MODE_THEN_ARM,
        handling=PLANE,
        lead_s=5.5,
        setpoint_period_s=0.25,
        holds_in_guided=True,
        lands=False,
    ),
    rules=_RULES,
    parameters_for=lambda limits: {"AIRSPEED_CRUISE": limits.speed_m_s},
    modes=Modes(
        meanings={
            (wire.PLANE_MODE_GUIDED,): Mode.GUIDED,
            (wire.PLANE_MODE_LOITER,): Mode.HOLD,
            (wire.PLANE_MODE_RTL,): Mode.RETURN,
            (wire.PLANE_MODE_TAKEOFF,): Mode.TAKE_OFF,
        },
        names=ardupilot.names_of("PLANE_MODE"),
    ),
    streams_hz=ardupilot.streams_hz(_ECHO, 4.0),
    intermittent=ardupilot.INTERMITTENT | {_ECHO},  # it does not come in MANUAL
    decoders={
        wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ardupilot.estimator,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: _echo,
    },
    take_off=_take_off,
    set_speed=_set_speed,
    setpoint=_setpoint,
    hold_about=_hold_about,
    acknowledges_setpoints=True,  # refused when not in GUIDED, or outside of its fence
)
