"""The parameters of the four autopilots that matter for a mission: four tables of rules.

Names and units of ArduPilot 4.5 to 4.7 and of PX4 1.14 to 1.17.  `judgement` says how rules are
applied, `parameter_verdicts` what they say.
"""

from typing import Final

from companion.mavlink.judgement import (
    Alias,
    Case,
    Finding,
    Judge,
    ParameterRule,
    Severity,
    judge,
    names_of,
    value_of,
)
from companion.mavlink.parameter_verdicts import (
    ardupilot_loiter,
    avoidance,
    bank,
    bit,
    brakes,
    brakes_and_turns,
    climbs,
    cruise_note,
    fastest,
    fence_action,
    ground_station,
    guid_timeout,
    guided_options,
    manual_loss,
    off,
    offboard_loss,
    offboard_timeout,
    offboard_timeout_of_a_plane,
    only_speed,
    plane_climbs,
    plane_sinks,
    px4_fence_action,
    px4_loiter,
    receivers,
    sinks,
    slowest,
    speed_of_corrections,
    speed_of_offboard,
    take_off_height,
    take_off_speed,
    takes_it_away,
    tilt,
    tilt_and_drag,
)


def _only_read(name: str, meaning: str, *aliases: Alias, scale: float = 1.0) -> ParameterRule:
    return ParameterRule(name=name, scale=scale, aliases=aliases, meaning=meaning, if_missing=None)


def _optional(
    name: str, meaning: str, judge: Judge, *aliases: Alias, scale: float = 1.0
) -> ParameterRule:
    return ParameterRule(
        name=name, scale=scale, aliases=aliases, meaning=meaning, judge=judge, if_missing=None
    )


def _essential(
    name: str, meaning: str, judge: Judge, *aliases: Alias, scale: float = 1.0
) -> ParameterRule:
    return ParameterRule(
        name=name,
        scale=scale,
        aliases=aliases,
        meaning=meaning,
        judge=judge,
        if_missing=Severity.REFUSE,
    )


_ARDUPILOT: Final = (
    _only_read("MAV_SYSID", "the vehicle's system id", Alias("SYSID_THISMAV")),
    _optional(
        "MAV_GCS_SYSID",
        "whose heartbeats feed the ground station's failsafe",
        ground_station,
        Alias("SYSID_MYGCS"),
    ),
    _optional(
        "ARMING_CHECK",
        "which checks precede arming",
        off("no check precedes arming", "Set it to 1"),
    ),
    _optional(
        "ARMING_SKIPCHK",
        "which checks before arming are left out",
        takes_it_away("some checks before arming are left out"),
    ),
    _only_read("FENCE_ENABLE", "whether its fence is on"),
    _only_read("FENCE_AUTOENABLE", "whether its fence goes on by itself"),
    _only_read("FENCE_TYPE", "which kinds of fence count"),
    _only_read("FENCE_RADIUS", "radius of the fence about home"),
    _only_read("FENCE_ALT_MAX", "height of the fence above home"),
    _only_read("FENCE_ALT_MIN", "lowest height above home"),
    _only_read("FENCE_MARGIN", "distance to keep from the fence"),
    _only_read("FENCE_OPTIONS", "how inclusion zones count together"),
    _optional("FENCE_ACTION", "what it does outside of its fence", fence_action),
)

_GCS_FAILSAFE: Final = takes_it_away(
    "if its ground station is lost it leaves GUIDED by itself; the companion does not count as one"
)

ARDUCOPTER_RULES: Final = (
    _essential("GUID_TIMEOUT", "how long it flies on without setpoints", guid_timeout),
    _optional("GUID_OPTIONS", "how GUIDED works", guided_options),
    _essential(
        "ANGLE_MAX",
        "its tilt limits its speed",
        tilt_and_drag,
        Alias("ATC_ANGLE_MAX"),
        scale=0.01,
    ),
    ParameterRule(
        name="WPNAV_ACCEL",
        scale=0.01,
        aliases=(Alias("WP_ACC"),),
        meaning="how hard it brakes",
        judge=brakes_and_turns,
    ),
    _only_read("PSC_JERK_XY", "how fast braking builds up", Alias("PSC_JERK_NE")),
    _optional(
        "WPNAV_SPEED",
        "speed of corrections and of the return",
        speed_of_corrections,
        Alias("WP_SPD"),
        scale=0.01,
    ),
    ParameterRule(
        name="WPNAV_SPEED_UP",
        scale=0.01,
        aliases=(Alias("WP_SPD_UP"),),
        meaning="how fast it climbs",
        judge=take_off_speed,
    ),
    _only_read("WPNAV_SPEED_DN", "how fast it sinks", Alias("WP_SPD_DN"), scale=0.01),
    _only_read("LAND_SPEED", "how fast it lands", Alias("LAND_SPD_MS"), scale=0.01),
    _optional("FS_GCS_ENABLE", "what it does when its ground station is lost", _GCS_FAILSAFE),
    _optional(
        "FS_EKF_ACTION",
        "what it does when its position fails",
        off("it does nothing by itself when its position fails", "Set it to 1 (land)"),
    ),
    _optional("AVOID_ENABLE", "its own avoidance of obstacles", avoidance),
    *_ARDUPILOT,
)
"""ArduCopter.  Of velocity and position the velocity is not limited by WPNAV_SPEED."""

ARDUPLANE_RULES: Final = (
    _essential("AIRSPEED_MIN", "its least airspeed", slowest, Alias("ARSPD_FBW_MIN")),
    _essential("AIRSPEED_MAX", "its highest airspeed", fastest, Alias("ARSPD_FBW_MAX")),
    _optional(
        "AIRSPEED_CRUISE", "its own airspeed", cruise_note, Alias("TRIM_ARSPD_CM", scale=0.01)
    ),
    _essential("WP_LOITER_RAD", "the circles that it holds on", ardupilot_loiter),
    ParameterRule(
        name="ROLL_LIMIT_DEG",
        aliases=(Alias("LIM_ROLL_CD", scale=0.01),),
        meaning="how tightly it turns",
        judge=bank,
    ),
    _optional("TECS_CLMB_MAX", "how fast it climbs", plane_climbs),
    _optional("TECS_SINK_MAX", "how fast it sinks", plane_sinks),
    _optional("TKOFF_ALT", "height of its own take-off", take_off_height),
    _optional(
        "FS_GCS_ENABL",
        "what it does when its ground station is lost",
        _GCS_FAILSAFE,
        Alias("FS_GCS_ENABLE"),
    ),
    _optional(
        "Q_ENABLE",
        "whether it is a quadplane",
        takes_it_away("a quadplane: how it is driven was not measured"),
    ),
    *_ARDUPILOT,
)
"""ArduPlane.  GUIDED has no time-out: it circles its last point for ever."""

_PX4: Final = (
    _essential("COM_OBL_RC_ACT", "what it does when the stream stops", offboard_loss),
    _optional("COM_RCL_EXCEPT", "in which modes a lost remote control does not count", manual_loss),
    _only_read("COM_RC_IN_MODE", "where sticks come from"),
    _optional(
        "COM_RC_OVERRIDE",
        "whether sticks take over",
        bit(2, "sticks do not take over from OFFBOARD: the pilot has to change the mode"),
    ),
    _optional(
        "NAV_DLL_ACT",
        "what it does when its ground station is lost",
        takes_it_away("if its ground station is lost it leaves OFFBOARD by itself"),
    ),
    _optional(
        "COM_TAKEOFF_ACT",
        "what it does after a take-off",
        takes_it_away("after the take-off it begins its own mission until OFFBOARD is taken"),
    ),
    _optional("GF_ACTION", "what it does outside of its fence", px4_fence_action),
    _only_read("GF_MAX_HOR_DIST", "radius of the fence about home"),
    _only_read("GF_MAX_VER_DIST", "height of the fence above home"),
    _optional(
        "SYS_HAS_GPS",
        "whether it has a receiver",
        receivers,
    ),
    _only_read("MIS_TAKEOFF_ALT", "height of a take-off that names none"),
)

PX4_MULTICOPTER_RULES: Final = (
    _essential("COM_OF_LOSS_T", "how long it flies on without setpoints", offboard_timeout),
    _essential("MPC_XY_VEL_MAX", "its highest speed", speed_of_offboard),
    _essential("MPC_Z_VEL_MAX_UP", "how fast it climbs", climbs),
    _essential("MPC_Z_VEL_MAX_DN", "how fast it sinks", sinks),
    _optional("MPC_TILTMAX_AIR", "its tilt limits its speed", tilt),
    ParameterRule(name="MPC_ACC_HOR", meaning="how hard it brakes", judge=brakes),
    _only_read("MPC_JERK_AUTO", "how fast braking builds up"),
    _only_read("MPC_LAND_SPEED", "how fast it lands"),
    *_PX4,
)
"""PX4, multicopter."""

PX4_FIXED_WING_RULES: Final = (
    _essential(
        "COM_OF_LOSS_T", "how long it flies on without setpoints", offboard_timeout_of_a_plane
    ),
    _essential("FW_AIRSPD_TRIM", "the airspeed that it flies", only_speed),
    _optional("FW_AIRSPD_MIN", "its least airspeed", slowest),
    _optional("FW_AIRSPD_MAX", "its highest airspeed", fastest),
    _essential("NAV_LOITER_RAD", "the circles that it holds on", px4_loiter),
    _optional("FW_R_LIM", "how tightly it turns", bank),
    _optional("FW_T_CLMB_R_SP", "how fast it climbs", plane_climbs),
    _optional("FW_T_SINK_R_SP", "how fast it sinks", plane_sinks),
    *_PX4,
)
"""PX4, fixed wing."""

__all__ = [
    "ARDUCOPTER_RULES",
    "ARDUPLANE_RULES",
    "PX4_FIXED_WING_RULES",
    "PX4_MULTICOPTER_RULES",
    "Alias",
    "Case",
    "Finding",
    "ParameterRule",
    "Severity",
    "judge",
    "names_of",
    "value_of",
]
