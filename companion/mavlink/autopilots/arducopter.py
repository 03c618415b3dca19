"""ArduCopter: position + velocity + yaw in GUIDED; it holds in BRAKE.

Not in LOITER, which sinks without a throttle stick.  It refuses to arm while there is no position
estimate: ask again, once a second.  There is no take-off mode, and it flies at the velocity of its
setpoints, which it does not acknowledge: the echo tells.  Measured: ardupilot.md 2 and 3.
"""

import math
from typing import Final

from companion.geodesy import LocalFrame
from companion.mavlink import parameter_checks as check
from companion.mavlink.autopilots import ardupilot, messages
from companion.mavlink.autopilots.common import Autopilot, LaunchPose
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.parameter_checks import CENTI, ESSENTIAL, WANTED, Alias, Rule
from companion.mission.events import Mode, TakeOff
from companion.mission.mission import Mission
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.envelope import Handling

_ECHO = wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED


def _take_off(
    command: TakeOff, here: LaunchPose, frame: LocalFrame, system_id: int
) -> list[Message]:
    """NAV_TAKEOFF to a height above home, in GUIDED and armed.

    Any setpoint before EXTENDED_SYS_STATE says `in air` abandons it.
    """
    del here, frame
    height_m = command.above_home_m
    if not 0.0 < height_m < messages.HIGHEST_AMSL_M:
        return []
    return [messages.command_long(system_id, wire.MAV_CMD_NAV_TAKEOFF, *([0.0] * 6), height_m)]


_WIND_M_S: Final = 5.0
"""Allowance for unknown head wind: a moderate breeze."""
_CORNERS: Final = 0.6
"""Share of WPNAV_ACCEL that ArduCopter follows a curve with; at 0.8 it was 14 m off."""


def _guid_timeout(value: float, case: check.CheckContext) -> check.ParameterIssue | None:
    """ArduCopter's GUID_TIMEOUT, at least 0.1 s (ardupilot.md 3)."""
    slack_s = check.begins_to_brake_s(case, "WPNAV_ACCEL", "PSC_JERK_XY", (2.5, 5.0))
    return check.timeout(max(value, 0.1), slack_s, case)


def _turns(value: float, case: check.CheckContext) -> check.ParameterIssue | None:
    """ArduCopter's WPNAV_ACCEL limits how curves are followed, too."""
    turn_m_s2 = check.turning_m_s2(case.limits)
    if turn_m_s2 <= _CORNERS * value + check.EQUAL_WITHIN:
        return None
    return check.note(
        f"the mission's tightest turns take {turn_m_s2:.1f} m/s2: beyond {_CORNERS * value:.1f} it "
        "leaves the path by more than 10 m",
        f"Set vehicle.turn_radius_m to {math.ceil(case.limits.speed_m_s**2 / (_CORNERS * value))}",
    )


def _drag(value: float, case: check.CheckContext) -> check.ParameterIssue | None:
    """Of ArduCopter's own airframe: 10.2 m/s at 30 deg, 15.5 m/s at 45 deg (ardupilot.md 3)."""
    held_m_s = 15.5 * math.tan(math.radians(min(value, 80.0))) ** 0.762
    speed = case.limits.speed_m_s
    if speed <= held_m_s - _WIND_M_S:
        return None
    return check.note(
        f"a usual quadcopter holds {held_m_s:.0f} m/s through the air at {value:g} deg of tilt: "
        f"{max(held_m_s - speed, 0.0):.0f} m/s more than the mission's speed, for head wind",
        "See that yours has less drag, allow more tilt, or fly slower",
    )


def _guided_options(value: float, case: check.CheckContext) -> check.ParameterIssue | None:
    """GUID_OPTIONS: bits that change what setpoints mean."""
    del case
    if int(value) & (16 | 32):
        rule = "bits 4 and 5 let the vehicle drift off its setpoints' position or velocity"
        return check.refused(rule, f"Set it to {int(value) & ~(16 | 32)}")
    if int(value) & 64:
        return check.note(
            "bit 6 flies positions as waypoints, which was not measured", "Clear bit 6"
        )
    return None


def _by_its_own_lidar(mission: Mission) -> bool:
    """Whether the sensor of near things is one of the autopilot."""
    near = mission.near
    told = None if near is None else (near.component_id, near.kind)
    return told == (AUTOPILOT_COMPONENT, "distance_sensor")


_AT_TAKE_OFF: Final = (
    "it climbs with {value:g} m/s at take-off, and the mission counts on {planned:g}"
)
_ITS_OWN_LIDAR: Final = check.when(  # position with velocity is never touched (proximity.md 2)
    lambda value, case: _by_its_own_lidar(case.mission) and int(value) & 2,  # bit 1: proximity
    "with the lidar it refuses to arm near things, and changes setpoints of velocity alone",
    "Set it to 1 or 0",
)
_ITS_OWN_WAY: Final = check.when(
    lambda value, _: value,
    "with the lidar and GUID_OPTIONS 64 it flies ways of its own",
    "Set it to 0, then reboot",
)
_SF45B: Final = 8
_TURNING_LIDARS: Final = (5, _SF45B, 15)
"""RPLidar, SF45B, LD06: of the silence of others nothing is known."""
_LOOKS_ROUND: Final = check.when(
    lambda value, case: _by_its_own_lidar(case.mission) and value not in _TURNING_LIDARS,
    "what it does not tell of is taken for clear, and not each of its sectors is looked at",
    'Use a lidar that turns; of a driver on MAVLink read scanner.kind = "obstacle_distance"',
    severity=check.Severity.REFUSE,
)
_NOT_BEHIND: Final = check.when(
    lambda value, case: _by_its_own_lidar(case.mission) and value == _SF45B,
    "it swings by 170 degrees to either side, and does not look straight behind",
    "Leave vehicle.yaw_deg out, so that the nose points along the path",
)
_IGNORES: Final = check.when(
    lambda value, case: _by_its_own_lidar(case.mission) and value > 0.0,
    "what it does not tell of is taken for clear, and so many degrees are ignored",
    "Set it to 0, and raise scanner.blind_m over parts of the vehicle",
    severity=check.Severity.REFUSE,
)
_HANDLING: Final = Handling(
    name="ArduCopter", eased=0.7, settling_s=0.6, steady_m=0.1, turning_s2=0.3, leading_s2=0.5
)
"""turning_s2: docs/results/tracking.md, 0.8 m at 1 m/s2, 0.5 of which the setpoints lead by, as of
its shaping, 2 (WPNAV_ACCEL / PSC_JERK_XY)^2; the others: `scripts/bench kills`."""
_RULES: Final = (
    Rule("GUID_TIMEOUT", "how long it flies on without setpoints", (_guid_timeout,), ESSENTIAL),
    Rule("GUID_OPTIONS", "how GUIDED works", (_guided_options,)),
    Rule(
        "ANGLE_MAX",
        "its tilt limits its speed",
        (check.tilt, _drag),
        ESSENTIAL,
        CENTI,
        also=Alias("ATC_ANGLE_MAX"),
    ),
    Rule(
        "WPNAV_ACCEL",
        "how hard it brakes",
        (check.BRAKES, _turns),
        WANTED,
        CENTI,
        also=Alias("WP_ACC"),
    ),
    Rule("PSC_JERK_XY", "how fast braking builds up", also=Alias("PSC_JERK_NE")),
    Rule(
        "WPNAV_SPEED",  # it does not limit velocities that are asked for (ardupilot.md 3)
        "speed of corrections and of the return",
        (
            check.at_least(
                lambda limits: limits.speed_m_s,
                "corrections and the autopilot's own return are no faster than {value:g} m/s",
                severity=check.Severity.NOTE,
            ),
        ),
        scale=CENTI,
        also=Alias("WP_SPD"),
    ),
    Rule(
        "WPNAV_SPEED_UP",  # the machine waits twice as long for a take-off as it plans with
        "how fast it climbs",
        (
            check.at_least(
                lambda limits: limits.climb_rate_m_s,
                _AT_TAKE_OFF,
                "Raise it, or set vehicle.climb_rate_m_s to {value:g}",
                share=0.5,
            ),
            check.at_least(
                lambda limits: limits.climb_rate_m_s, _AT_TAKE_OFF, severity=check.Severity.NOTE
            ),
        ),
        WANTED,
        CENTI,
        also=Alias("WP_SPD_UP"),
    ),
    Rule("WPNAV_SPEED_DN", "how fast it sinks", scale=CENTI, also=Alias("WP_SPD_DN")),
    Rule("LAND_SPEED", "how fast it lands", scale=CENTI, also=Alias("LAND_SPD_MS")),
    Rule(
        "FS_GCS_ENABLE", "what it does when its ground station is lost", (ardupilot.GCS_FAILSAFE,)
    ),
    Rule(
        "FS_EKF_ACTION",
        "what it does when its position fails",
        (check.is_zero("it does nothing by itself when its position fails", "Set it to 1 (land)"),),
    ),
    Rule("AVOID_ENABLE", "its own avoidance of obstacles", (_ITS_OWN_LIDAR,)),
    Rule("OA_TYPE", "its own ways round things", (_ITS_OWN_WAY,), matters=_by_its_own_lidar),
    Rule("PRX1_TYPE", "what its lidar is", (_LOOKS_ROUND, _NOT_BEHIND), matters=_by_its_own_lidar),
    *(
        Rule(f"PRX1_IGN_WID{k}", "what its lidar ignores", (_IGNORES,), matters=_by_its_own_lidar)
        for k in range(1, 5)
    ),
    *ardupilot.RULES,
)
"""ArduCopter.  Of velocity and position the velocity is not limited by WPNAV_SPEED."""

ARDUCOPTER = Autopilot(
    firmware=ardupilot.FIRMWARE,
    traits=VehicleTraits(
        name="ArduCopter",
        kind="copter",
        take_off=TakeoffSequence.GUIDED_THEN_CLIMB,
        handling=_HANDLING,
    ),
    rules=_RULES,
    parameters_for=lambda limits: {
        "GUID_TIMEOUT": 3.0,
        "WPNAV_SPEED": 100.0 * limits.speed_m_s,
        "WPNAV_ACCEL": 100.0 * limits.acceleration_m_s2,
        "PSC_JERK_XY": 4.0 * limits.acceleration_m_s2,
    },
    modes=ardupilot.modes_of(
        "COPTER_MODE",
        {
            Mode.GUIDED: (wire.COPTER_MODE_GUIDED,),
            Mode.HOLD: (wire.COPTER_MODE_BRAKE,),
            Mode.LAND: (wire.COPTER_MODE_LAND,),
            Mode.RETURN: (
                wire.COPTER_MODE_RTL,
                wire.COPTER_MODE_SMART_RTL,
                wire.COPTER_MODE_AUTO_RTL,
            ),
        },
    ),
    streams_hz=ardupilot.streams_hz(_ECHO, 5.0),
    intermittent=ardupilot.INTERMITTENT | {_ECHO},  # it comes only in GUIDED
    decoders={
        wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ardupilot.estimator,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: ardupilot.local_echo,
    },
    take_off=_take_off,
    setpoint=messages.position_target,
)
