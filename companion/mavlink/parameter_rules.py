"""The parameters of the four autopilots that matter for a mission: four tables of rules.

Names and units of ArduPilot 4.5 to 4.7 and of PX4 1.14 to 1.17; `parameter_checks` says how rules
are applied.  Sources: ardupilot.md (0, 3, 5, 7), px4.md (1, 4, 5, 6, 7, 10).  First the checks that
need more than a comparison; each takes a value in SI (angles in degrees) and the case.
"""

import math
from typing import Final

from companion.mavlink.parameter_checks import (
    EQUAL_WITHIN,
    Alias,
    CheckContext,
    ParameterCheck,
    ParameterIssue,
    ParameterRule,
    Severity,
    at_least,
    at_most,
    is_set,
    is_zero,
    note,
    refused,
    to_set,
    up_to_tenths,
    when,
)
from companion.mission.mission import Mission
from companion.path.limits import Limits

_GRAVITY_M_S2: Final = 9.81
_SHORTEST_TIMEOUT_S: Final = 0.5
"""A 5 to 10 Hz stream on a lossy link must not trigger it."""
_USUAL_TIMEOUT_S: Final = 1.0
_EASY: Final = 1.5
"""Minimum ratio of the loiter radius to the tightest turn, to leave bank angle for wind."""
_WIND_M_S: Final = 5.0
"""Allowance for unknown head wind: a moderate breeze."""
_CORNERS: Final = 0.6
"""Share of WPNAV_ACCEL that ArduCopter follows a curve with; at 0.8 it was 14 m off."""


# --- when the setpoints end -----------------------------------------------------------------------


def _begins_to_brake_s(
    case: CheckContext, braking: str, jerk: str, usual: tuple[float, float]
) -> float:
    """Equivalent delay from the time-out to braking with full acceleration.

    0.25 s to notice, and half the time in which the acceleration builds up (jerk-limited): 0.5 s
    with ArduCopter's defaults, which is what was measured (ardupilot.md 3, "Stream stops").
    """
    acceleration = max(case.value(braking, usual[0]), 0.1)
    return 0.25 + 0.5 * acceleration / max(case.value(jerk, usual[1]), 0.1)


def _timeout(
    value: float, slack_s: float, case: CheckContext, what: str = "the vehicle flies on"
) -> ParameterIssue | None:
    """A time-out of the stream: short enough for the certified reach, long enough for a radio."""
    what = f"after the last setpoint {what}"
    dead_man_s = case.limits.dead_man_s
    shortest_s = max(_SHORTEST_TIMEOUT_S, 3.0 * case.mission.task.settings.position_period_s)
    longest_s = math.floor((dead_man_s - slack_s + EQUAL_WITHIN) * 10.0) / 10.0
    if longest_s < shortest_s:
        return refused(
            f"{what}; with {shortest_s:g} s, the least for a radio, that is "
            f"{shortest_s + slack_s:.1f} s, and vehicle.dead_man_s = {dead_man_s:g}",
            f"Set vehicle.dead_man_s to {up_to_tenths(shortest_s + slack_s):g} or more",
        )
    if value > dead_man_s - slack_s + EQUAL_WITHIN:
        rule = (
            f"{what} for {value + slack_s:.1f} s, longer than vehicle.dead_man_s = {dead_man_s:g}"
        )
        return to_set(longest_s, rule)
    if value < shortest_s - EQUAL_WITHIN:
        rule = f"shorter than the {shortest_s:g} s in which a radio may lose setpoints"
        return to_set(min(_USUAL_TIMEOUT_S, longest_s), rule)
    return None


def _guid_timeout(value: float, case: CheckContext) -> ParameterIssue | None:
    """ArduCopter's GUID_TIMEOUT, at least 0.1 s (ardupilot.md 3)."""
    slack_s = _begins_to_brake_s(case, "WPNAV_ACCEL", "PSC_JERK_XY", (2.5, 5.0))
    return _timeout(max(value, 0.1), slack_s, case)


def _offboard_timeout(value: float, case: CheckContext) -> ParameterIssue | None:
    """PX4's COM_OF_LOSS_T; the mode changes 0.12 s after it (px4.md 6)."""
    slack_s = 0.12 + _begins_to_brake_s(case, "MPC_ACC_HOR", "MPC_JERK_AUTO", (3.0, 4.0))
    return _timeout(value, slack_s, case)


def _offboard_timeout_of_a_plane(value: float, case: CheckContext) -> ParameterIssue | None:
    """PX4's COM_OF_LOSS_T; then it circles where it is (px4.md 10)."""
    return _timeout(value, 0.5, case, "the plane flies straight on")


_WITHOUT_STREAM: Final = {
    0: "sinks without RC",
    1: "sinks without RC",
    2: "falls off level without RC",
    6: "stops its motors",
    7: "stops its motors",
}
"""COM_OBL_RC_ACT (px4.md 6): without RC, Position, Altitude and Stabilized sink."""
_OFFBOARD_LOSS: Final[tuple[ParameterCheck, ...]] = (
    when(
        lambda value, _: value == 3,
        "when the stream stops it returns on a straight way that nobody has certified",
    ),
    when(lambda value, _: value == 4, "when the stream stops it lands, whatever is below"),
    lambda value, _: (
        None
        if value in (3, 4, 5)
        else to_set(
            5.0, "when the stream stops the vehicle " + _WITHOUT_STREAM.get(int(value), "does so")
        )
    ),
)


# --- speeds, tilt and turns -----------------------------------------------------------------------


def _turning_m_s2(limits: Limits) -> float:
    return limits.speed_m_s**2 / limits.turn_radius_m


def _turns(value: float, case: CheckContext) -> ParameterIssue | None:
    """ArduCopter's WPNAV_ACCEL limits how curves are followed, too."""
    turn_m_s2 = _turning_m_s2(case.limits)
    if turn_m_s2 <= _CORNERS * value + EQUAL_WITHIN:
        return None
    return note(
        f"the mission's tightest turns take {turn_m_s2:.1f} m/s2: beyond {_CORNERS * value:.1f} it "
        "leaves the path by more than 10 m",
        f"Set vehicle.turn_radius_m to {math.ceil(case.limits.speed_m_s**2 / (_CORNERS * value))}",
    )


def _tilt(value: float, case: CheckContext) -> ParameterIssue | None:
    """The tilt limit as acceleration, without drag, which is unknown."""
    needed_m_s2 = max(case.limits.acceleration_m_s2, _turning_m_s2(case.limits))
    has_m_s2 = _GRAVITY_M_S2 * math.tan(math.radians(min(max(value, 0.0), 80.0)))
    if has_m_s2 >= needed_m_s2:
        return None
    degrees = math.degrees(math.atan(needed_m_s2 / _GRAVITY_M_S2))
    return refused(
        f"{value:g} deg of tilt give {has_m_s2:.1f} m/s2, and the mission's speed, turn radius "
        f"and acceleration ask for {needed_m_s2:.1f}",
        f"Allow {math.ceil(degrees)} deg or more, or fly slower and wider turns",
    )


def _drag(value: float, case: CheckContext) -> ParameterIssue | None:
    """Of ArduCopter's own airframe: 10.2 m/s at 30 deg, 15.5 m/s at 45 deg (ardupilot.md 3)."""
    held_m_s = 15.5 * math.tan(math.radians(min(value, 80.0))) ** 0.762
    speed = case.limits.speed_m_s
    if speed <= held_m_s - _WIND_M_S:
        return None
    return note(
        f"a usual quadcopter holds {held_m_s:.0f} m/s through the air at {value:g} deg of tilt: "
        f"{max(held_m_s - speed, 0.0):.0f} m/s more than the mission's speed, for head wind",
        "See that yours has less drag, allow more tilt, or fly slower",
    )


def _speed_of_offboard(value: float, case: CheckContext) -> ParameterIssue | None:
    """At MPC_XY_VEL_MAX it falls behind without recovery (px4.md 5)."""
    speed = case.limits.speed_m_s
    if speed <= 0.8 * value + EQUAL_WITHIN:
        return None
    if speed <= 0.85 * value + EQUAL_WITHIN:
        return note(
            f"vehicle.speed_m_s = {speed:g} leaves less than 20 % to catch up with",
            f"Better {0.8 * value:.1f} m/s or less",
        )
    return refused(
        f"vehicle.speed_m_s = {speed:g} is more than 85 % of it: nothing is left to catch up with",
        f"Raise it to {math.ceil(speed / 0.8)} or more, or fly {0.8 * value:.1f} m/s or less",
    )


def _own_speed(value: float, case: CheckContext) -> ParameterIssue | None:
    """The speed of the autopilot's own modes."""
    speed = case.limits.speed_m_s
    if abs(value - speed) <= 0.05 * speed:
        return None
    return note(f"on its own (return, loiter) it flies {value:g} m/s, the mission {speed:g}")


def _only_speed(value: float, case: CheckContext) -> ParameterIssue | None:
    """PX4's fixed wing always flies at this speed (px4.md 10)."""
    speed = case.limits.speed_m_s
    if value > 1.05 * speed:
        return refused(
            f"it always flies this airspeed, and the mission counts on {speed:g} m/s or less",
            f"Set vehicle.speed_m_s to {value:g}",
        )
    if value < 0.95 * speed:
        return note(f"it always flies this airspeed; the mission counts on {speed:g} m/s")
    return None


def _tightest_circle_m(speed_m_s: float, bank_deg: float) -> float:
    bank = math.radians(min(max(bank_deg, 1.0), 80.0))
    return speed_m_s**2 / (_GRAVITY_M_S2 * math.tan(bank))


def _bank(value: float, case: CheckContext) -> ParameterIssue | None:
    """The bank limits how tightly it turns."""
    limits = case.limits
    tightest_m = _tightest_circle_m(limits.speed_m_s, value)
    if tightest_m <= limits.turn_radius_m + EQUAL_WITHIN:
        return None
    return refused(
        f"with {value:g} deg of bank its tightest turn at {limits.speed_m_s:g} m/s has a radius of "
        f"{tightest_m:.0f} m, and the mission turns with {limits.turn_radius_m:g} m",
        f"Set vehicle.turn_radius_m to {math.ceil(tightest_m)} or more",
    )


def _circles(wider_m: float, bank: str) -> ParameterCheck:
    """Whether the autopilot's loiter circles, which are wider by this, stay in the cleared ones.

    bank: the parameter that limits the bank.
    """

    def check(value: float, case: CheckContext) -> ParameterIssue | None:
        limits, flown_m = case.limits, abs(value) + wider_m
        if limits.hovers or flown_m <= limits.loiter_radius_m + EQUAL_WITHIN:
            return None
        rule = (
            f"its circles are flown with {flown_m:g} m, and the mission keeps "
            f"vehicle.loiter_radius_m = {limits.loiter_radius_m:g} clear"
        )
        fits_m = math.floor(limits.loiter_radius_m - wider_m)
        if fits_m < _EASY * _tightest_circle_m(limits.speed_m_s, case.value(bank, 45.0)):
            return refused(rule, f"Set vehicle.loiter_radius_m to {flown_m:g} or more")
        return to_set(math.copysign(fits_m, value), rule)

    return check


def _take_off_height(value: float, case: CheckContext) -> ParameterIssue | None:
    """The autopilot's own take-off ends there; the companion climbs on."""
    limits, home_amsl_m = case.limits, case.home_amsl_m
    if home_amsl_m is None or home_amsl_m + value <= limits.ceiling_amsl_m:
        return None
    return refused(
        f"its take-off ends at {home_amsl_m + value:.0f} m AMSL, above the ceiling of "
        f"{limits.ceiling_amsl_m:g} m",
        f"Set it to {max(case.mission.task.take_off_amsl_m - home_amsl_m, 0.0):.0f}",
    )


def _climb_m_s(limits: Limits) -> float:
    return min(limits.climb_rate_m_s, limits.speed_m_s)


def _sink_m_s(limits: Limits) -> float:
    return min(limits.climb_rate_m_s, _plane_sink_m_s(limits))


def _plane_climb_m_s(limits: Limits) -> float:
    """A plane flies every climb at its speed."""
    return limits.speed_m_s * math.sin(limits.climb_angle_rad)


def _plane_sink_m_s(limits: Limits) -> float:
    return limits.speed_m_s * math.sin(limits.dive_angle_rad)


_VERTICAL: Final = (
    "it {verb} with {{value:g}} m/s at most, and the mission asks for {{planned:.1f}}"
)
_CLIMBS: Final = _VERTICAL.format(verb="climbs")
_SINKS: Final = _VERTICAL.format(verb="sinks")
_RAISE: Final = "Raise it to {up:g}, or set "
_OTHER_RATE: Final = _RAISE + "vehicle.climb_rate_m_s to {value:g}"
_PLANE_CLIMBS: Final = at_least(
    _plane_climb_m_s, _CLIMBS, _RAISE + "a smaller vehicle.climb_angle_deg"
)
_PLANE_SINKS: Final = at_least(_plane_sink_m_s, _SINKS, _RAISE + "a smaller vehicle.dive_angle_deg")
_AT_TAKE_OFF: Final = (
    "it climbs with {value:g} m/s at take-off, and the mission counts on {planned:g}"
)
_BRAKES: Final = at_least(
    lambda limits: limits.acceleration_m_s2,
    "it brakes with {value:g} m/s2, and the mission counts on {planned:g}",
    "Raise it, or set vehicle.acceleration_m_s2 to {value:g} or less",
)
_SLOWEST: Final = at_most(
    lambda limits: limits.speed_m_s,
    "vehicle.speed_m_s = {planned:g} is slower than it may fly",
    "Fly {value:g} m/s or faster",
)
_FASTEST: Final = at_least(
    lambda limits: limits.speed_m_s,
    "vehicle.speed_m_s = {planned:g} is faster than it may fly",
    "Fly {value:g} m/s or slower",
)


# --- who else may take the vehicle ----------------------------------------------------------------


def _guided_options(value: float, case: CheckContext) -> ParameterIssue | None:
    """GUID_OPTIONS: bits that change what setpoints mean."""
    del case
    if int(value) & (16 | 32):
        rule = "bits 4 and 5 let the vehicle drift off its setpoints' position or velocity"
        return refused(rule, f"Set it to {int(value) & ~(16 | 32)}")
    if int(value) & 64:
        return note("bit 6 flies positions as waypoints, which was not measured", "Clear bit 6")
    return None


def _by_its_own_lidar(mission: Mission) -> bool:
    """Whether the sensor of near things is one of the autopilot."""
    near = mission.near
    return near is not None and near.kind == "distance_sensor"


_GROUND_STATION: Final = when(  # its heartbeats must not count as a ground station's
    lambda value, case: value == case.value("MAV_SYSID", -1.0),
    "the companion has the vehicle's system id, so its heartbeats would hide the loss of the "
    "ground station",
    "Set it to the ground station's own, 255",
    severity=Severity.REFUSE,
)
_FENCE_ACTION: Final = when(
    lambda value, case: case.value("FENCE_ENABLE", 0.0) and not value,
    "the fence is on and only reports: nothing but the companion keeps to it",
)
_AVOIDANCE: Final = when(  # bit 1: proximity
    lambda value, case: case.mission.sends_obstacles and int(value) & 2,
    "its own avoidance will act on the OBSTACLE_DISTANCE that the companion sends",
)
_ITS_OWN_LIDAR: Final = when(  # position with velocity is never touched (proximity.md 2)
    lambda value, case: _by_its_own_lidar(case.mission) and int(value) & 2,
    "with the lidar it refuses to arm near things, and changes setpoints of velocity alone",
    "Set it to 1 or 0",
)
_ITS_OWN_WAY: Final = when(
    lambda value, _: value,
    "with the lidar and GUID_OPTIONS 64 it flies ways of its own",
    "Set it to 0, then reboot",
)
_RC_LOST: Final = when(  # bit 2 exempts OFFBOARD (px4.md 6)
    lambda value, case: not int(value) & 4 and case.value("COM_RC_IN_MODE", 0.0) != 4,
    "bit 2 is not set: if the remote control is lost, PX4 takes OFFBOARD away",
    "Add 4 if the flight may go on without it",
)
_NO_STICKS: Final = when(
    lambda value, _: not int(value) & 2,
    "sticks do not take over from OFFBOARD: the pilot has to change the mode",
)
_PX4_FENCE: Final = (  # px4.md 7
    when(lambda value, _: value == 4, "crossing its fence stops the motors"),
    when(
        lambda value, _: value in (0, 1),
        "its fence only warns: nothing but the companion keeps to it",
    ),
)
_NO_GPS: Final = is_zero(
    "the vehicle flies without GPS",
    "Set it to the number of its receivers",
    severity=Severity.REFUSE,
)
_GCS_FAILSAFE: Final = is_set(
    "if its ground station is lost it leaves GUIDED by itself; the companion does not count as one"
)


# --- the tables -----------------------------------------------------------------------------------

_ESSENTIAL, _WANTED = Severity.REFUSE, Severity.NOTE
_P: Final = ParameterRule
_CENTI: Final = 0.01

_ARDUPILOT: Final = (
    _P("MAV_SYSID", "the vehicle's system id", also=Alias("SYSID_THISMAV")),
    _P(
        "MAV_GCS_SYSID",
        "whose heartbeats feed the ground station's failsafe",
        (_GROUND_STATION,),
        also=Alias("SYSID_MYGCS"),
    ),
    _P(
        "ARMING_CHECK",
        "which checks precede arming",
        (is_zero("no check precedes arming", "Set it to 1"),),
    ),
    _P(
        "ARMING_SKIPCHK",
        "which checks before arming are left out",
        (is_set("some checks before arming are left out"),),
    ),
    _P("FENCE_ENABLE", "whether its fence is on"),
    _P("FENCE_AUTOENABLE", "whether its fence goes on by itself"),
    _P("FENCE_TYPE", "which kinds of fence count"),
    _P("FENCE_RADIUS", "radius of the fence about home"),
    _P("FENCE_ALT_MAX", "height of the fence above home"),
    _P("FENCE_ALT_MIN", "lowest height above home"),
    _P("FENCE_MARGIN", "distance to keep from the fence"),
    _P("FENCE_OPTIONS", "how inclusion zones count together"),
    _P("FENCE_ACTION", "what it does outside of its fence", (_FENCE_ACTION,)),
)

ARDUCOPTER_RULES: Final = (
    _P("GUID_TIMEOUT", "how long it flies on without setpoints", (_guid_timeout,), _ESSENTIAL),
    _P("GUID_OPTIONS", "how GUIDED works", (_guided_options,)),
    _P(
        "ANGLE_MAX",
        "its tilt limits its speed",
        (_tilt, _drag),
        _ESSENTIAL,
        _CENTI,
        also=Alias("ATC_ANGLE_MAX"),
    ),
    _P(
        "WPNAV_ACCEL",
        "how hard it brakes",
        (_BRAKES, _turns),
        _WANTED,
        _CENTI,
        also=Alias("WP_ACC"),
    ),
    _P("PSC_JERK_XY", "how fast braking builds up", also=Alias("PSC_JERK_NE")),
    _P(
        "WPNAV_SPEED",  # it does not limit velocities that are asked for (ardupilot.md 3)
        "speed of corrections and of the return",
        (
            at_least(
                lambda limits: limits.speed_m_s,
                "corrections and the autopilot's own return are no faster than {value:g} m/s",
                severity=Severity.NOTE,
            ),
        ),
        scale=_CENTI,
        also=Alias("WP_SPD"),
    ),
    _P(
        "WPNAV_SPEED_UP",  # the machine waits twice as long for a take-off as it plans with
        "how fast it climbs",
        (
            at_least(
                lambda limits: limits.climb_rate_m_s,
                _AT_TAKE_OFF,
                "Raise it, or set vehicle.climb_rate_m_s to {value:g}",
                share=0.5,
            ),
            at_least(lambda limits: limits.climb_rate_m_s, _AT_TAKE_OFF, severity=Severity.NOTE),
        ),
        _WANTED,
        _CENTI,
        also=Alias("WP_SPD_UP"),
    ),
    _P("WPNAV_SPEED_DN", "how fast it sinks", scale=_CENTI, also=Alias("WP_SPD_DN")),
    _P("LAND_SPEED", "how fast it lands", scale=_CENTI, also=Alias("LAND_SPD_MS")),
    _P("FS_GCS_ENABLE", "what it does when its ground station is lost", (_GCS_FAILSAFE,)),
    _P(
        "FS_EKF_ACTION",
        "what it does when its position fails",
        (is_zero("it does nothing by itself when its position fails", "Set it to 1 (land)"),),
    ),
    _P("AVOID_ENABLE", "its own avoidance of obstacles", (_AVOIDANCE, _ITS_OWN_LIDAR)),
    _P("OA_TYPE", "its own ways round things", (_ITS_OWN_WAY,), matters=_by_its_own_lidar),
    *_ARDUPILOT,
)
"""ArduCopter.  Of velocity and position the velocity is not limited by WPNAV_SPEED."""

ARDUPLANE_RULES: Final = (
    _P("AIRSPEED_MIN", "its least airspeed", (_SLOWEST,), _ESSENTIAL, also=Alias("ARSPD_FBW_MIN")),
    _P(
        "AIRSPEED_MAX", "its highest airspeed", (_FASTEST,), _ESSENTIAL, also=Alias("ARSPD_FBW_MAX")
    ),
    _P("AIRSPEED_CRUISE", "its own airspeed", (_own_speed,), also=Alias("TRIM_ARSPD_CM", _CENTI)),
    _P(
        "WP_LOITER_RAD",  # 17 to 20 m larger than asked at 23 m/s (ardupilot.md 7)
        "the circles that it holds on",
        (_circles(20.0, "ROLL_LIMIT_DEG"),),
        _ESSENTIAL,
    ),
    _P(
        "ROLL_LIMIT_DEG",
        "how tightly it turns",
        (_bank,),
        _WANTED,
        also=Alias("LIM_ROLL_CD", _CENTI),
    ),
    _P("TECS_CLMB_MAX", "how fast it climbs", (_PLANE_CLIMBS,)),
    _P("TECS_SINK_MAX", "how fast it sinks", (_PLANE_SINKS,)),
    _P("TKOFF_ALT", "height of its own take-off", (_take_off_height,)),
    _P(
        "FS_GCS_ENABL",
        "what it does when its ground station is lost",
        (_GCS_FAILSAFE,),
        also=Alias("FS_GCS_ENABLE"),
    ),
    _P(
        "Q_ENABLE",
        "whether it is a quadplane",
        (is_set("a quadplane: how it is driven was not measured"),),
    ),
    *_ARDUPILOT,
)
"""ArduPlane.  GUIDED has no time-out: it circles its last point for ever."""

_PX4: Final = (
    _P("COM_OBL_RC_ACT", "what it does when the stream stops", _OFFBOARD_LOSS, _ESSENTIAL),
    _P("COM_RCL_EXCEPT", "in which modes a lost remote control does not count", (_RC_LOST,)),
    _P("COM_RC_IN_MODE", "where sticks come from"),
    _P("COM_RC_OVERRIDE", "whether sticks take over", (_NO_STICKS,)),
    _P(
        "NAV_DLL_ACT",
        "what it does when its ground station is lost",
        (is_set("if its ground station is lost it leaves OFFBOARD by itself"),),
    ),
    _P(
        "COM_TAKEOFF_ACT",
        "what it does after a take-off",
        (is_set("after the take-off it begins its own mission until OFFBOARD is taken"),),
    ),
    _P("GF_ACTION", "what it does outside of its fence", _PX4_FENCE),
    _P("GF_MAX_HOR_DIST", "radius of the fence about home"),
    _P("GF_MAX_VER_DIST", "height of the fence above home"),
    _P("SYS_HAS_GPS", "whether it has a receiver", (_NO_GPS,)),
    _P("MIS_TAKEOFF_ALT", "height of a take-off that names none"),
)

PX4_MULTICOPTER_RULES: Final = (
    _P("COM_OF_LOSS_T", "how long it flies on without setpoints", (_offboard_timeout,), _ESSENTIAL),
    _P("MPC_XY_VEL_MAX", "its highest speed", (_speed_of_offboard,), _ESSENTIAL),
    _P(
        "MPC_Z_VEL_MAX_UP",
        "how fast it climbs",
        (at_least(_climb_m_s, _CLIMBS, _OTHER_RATE),),
        _ESSENTIAL,
    ),
    _P(
        "MPC_Z_VEL_MAX_DN",
        "how fast it sinks",
        (at_least(_sink_m_s, _SINKS, _OTHER_RATE),),
        _ESSENTIAL,
    ),
    _P("MPC_TILTMAX_AIR", "its tilt limits its speed", (_tilt,)),
    _P("MPC_ACC_HOR", "how hard it brakes", (_BRAKES,), _WANTED),
    _P("MPC_JERK_AUTO", "how fast braking builds up"),
    _P("MPC_LAND_SPEED", "how fast it lands"),
    *_PX4,
)
"""PX4, multicopter."""

PX4_FIXED_WING_RULES: Final = (
    _P(
        "COM_OF_LOSS_T",
        "how long it flies on without setpoints",
        (_offboard_timeout_of_a_plane,),
        _ESSENTIAL,
    ),
    _P("FW_AIRSPD_TRIM", "the airspeed that it flies", (_only_speed,), _ESSENTIAL),
    _P("FW_AIRSPD_MIN", "its least airspeed", (_SLOWEST,)),
    _P("FW_AIRSPD_MAX", "its highest airspeed", (_FASTEST,)),
    _P(
        "NAV_LOITER_RAD",  # held within 0.4 m (px4.md 10)
        "the circles that it holds on",
        (_circles(5.0, "FW_R_LIM"),),
        _ESSENTIAL,
    ),
    _P("FW_R_LIM", "how tightly it turns", (_bank,)),
    _P("FW_T_CLMB_R_SP", "how fast it climbs", (_PLANE_CLIMBS,)),
    _P("FW_T_SINK_R_SP", "how fast it sinks", (_PLANE_SINKS,)),
    *_PX4,
)
"""PX4, fixed wing."""
