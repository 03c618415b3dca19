"""ArduCopter: position + velocity + yaw in GUIDED; it holds in BRAKE.

Not in LOITER, which sinks without a throttle stick.  It refuses to arm while there is no position
estimate: ask again, once a second.  There is no take-off mode, and it flies at the velocity of its
setpoints, which it does not acknowledge: the echo tells.  Measured: ardupilot.md 2 and 3.
"""

from typing import Final

from companion.mavlink import rules
from companion.mavlink.autopilots import ardupilot, messages
from companion.mavlink.autopilots.common import Autopilot, Modes
from companion.mavlink.autopilots.messages import To
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.rules import CENTI, Case, Finding, Rule, only_read
from companion.mission.events import Mode, TakeOff, Vector
from companion.mission.mission import Mission
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.envelope import Handling

_ECHO = wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED


def _take_off(command: TakeOff, _here: Vector, _heading_rad: float, to: To) -> list[Message]:
    """NAV_TAKEOFF to a height above home, in GUIDED and armed.

    Any setpoint before EXTENDED_SYS_STATE says `in air` abandons it.
    """
    height_m = command.above_home_m
    if not 0.0 < height_m < messages.HIGHEST_AMSL_M:
        return []
    parameters = (*[0.0] * 6, height_m)
    return [messages.command_long(to.system_id, wire.MAV_CMD_NAV_TAKEOFF, *parameters)]


def _guid_timeout(value: float, case: Case) -> Finding | None:
    """ArduCopter's GUID_TIMEOUT, at least 0.1 s (ardupilot.md 3)."""
    slack_s = rules.begins_to_brake_s(case, "WPNAV_ACCEL", "PSC_JERK_XY", (2.5, 5.0))
    return rules.timeout(max(value, 0.1), slack_s, case)


_GUIDED_OPTIONS: Final = rules.when(
    lambda value, _: int(value) & (16 | 32),
    "bits 4 and 5 let the vehicle drift off its setpoints' position or velocity",
    "Clear them: subtract 16, 32 or 48",
)


def _by_its_own_lidar(mission: Mission) -> bool:
    """Whether the sensor of near things is one of the autopilot."""
    near, its_own = mission.near, (AUTOPILOT_COMPONENT, "distance_sensor")
    return near is not None and (near.component_id, near.kind) == its_own


_TURNING_LIDARS: Final = (5, 8, 15)
"""RPLidar, SF45B, LD06: of the silence of others nothing is known."""
_LOOKS_ROUND: Final = rules.when(
    lambda value, _: value not in _TURNING_LIDARS,
    "what it does not tell of is taken for clear, and not each of its sectors is looked at",
    'Use a lidar that turns; of a driver on MAVLink read scanner.kind = "obstacle_distance"',
)
_IGNORES: Final = rules.when(
    lambda value, _: value > 0.0,
    "what it does not tell of is taken for clear, and so many degrees are ignored",
    "Set it to 0, and raise scanner.blind_m over parts of the vehicle",
)


_CLIMBS: Final = rules.at_least(  # the machine waits twice as long as it plans with
    lambda limits: 0.5 * limits.climb_rate_m_s,
    "it climbs with {value:g} m/s at take-off, and the mission counts on {needed:g} or more",
    "Raise it, or set vehicle.climb_rate_m_s to {value:g}",
)
_HANDLING: Final = Handling(
    name="ArduCopter", eased=0.7, settling_s=0.6, steady_m=0.1, turning_s2=0.3, leading_s2=0.5
)
"""turning_s2: docs/lab/tracking.md, 0.8 m at 1 m/s2, 0.5 of which the setpoints lead by, as of
its shaping, 2 (WPNAV_ACCEL / PSC_JERK_XY)^2; the others: `scripts/bench kills`."""
_RULES: Final = (
    Rule("GUID_TIMEOUT", _guid_timeout, "how long it flies on without setpoints"),
    Rule("GUID_OPTIONS", _GUIDED_OPTIONS),
    Rule("ANGLE_MAX", rules.tilt, "its tilt limits its speed", CENTI, "ATC_ANGLE_MAX"),
    Rule("WPNAV_ACCEL", rules.brakes, scale=CENTI, also="WP_ACC"),
    Rule("WPNAV_ACCEL_Z", rules.rises, scale=CENTI, also="WP_ACC_Z"),
    *only_read("PSC_JERK_XY/PSC_JERK_NE"),
    Rule("WPNAV_SPEED_UP", _CLIMBS, scale=CENTI, also="WP_SPD_UP"),
    Rule("OA_TYPE", matters=_by_its_own_lidar),
    Rule("PRX1_TYPE", _LOOKS_ROUND, matters=_by_its_own_lidar),
    *(Rule(f"PRX1_IGN_WID{k}", _IGNORES, matters=_by_its_own_lidar) for k in range(1, 5)),
    *ardupilot.RULES,
)
"""Velocities that are asked for are not limited by WPNAV_SPEED (ardupilot.md 3)."""

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
    modes=Modes(
        meanings={
            (wire.COPTER_MODE_GUIDED,): Mode.GUIDED,
            (wire.COPTER_MODE_BRAKE,): Mode.HOLD,
            (wire.COPTER_MODE_LAND,): Mode.LAND,
            (wire.COPTER_MODE_RTL,): Mode.RETURN,
            (wire.COPTER_MODE_SMART_RTL,): Mode.RETURN,
            (wire.COPTER_MODE_AUTO_RTL,): Mode.RETURN,
        },
        names=ardupilot.names_of("COPTER_MODE"),
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
