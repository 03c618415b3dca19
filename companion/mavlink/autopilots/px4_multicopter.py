"""PX4 multicopter: position + velocity + yaw in OFFBOARD.  Measured: px4.md 4 and 5.

It flies at the velocity of its setpoints.  10 s on the ground disarm it again.
"""

from dataclasses import replace
from typing import Final

from companion.mavlink import rules
from companion.mavlink.autopilots import messages, px4
from companion.mavlink.autopilots.common import Autopilot
from companion.mavlink.autopilots.messages import To
from companion.mavlink.dialect import Message, wire
from companion.mavlink.rules import Case, Finding, Rule, only_read
from companion.mission.events import TakeOff, Vector
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.envelope import COPTER


def _take_off(command: TakeOff, here_nea_m: Vector, _heading_rad: float, to: To) -> list[Message]:
    """NAV_TAKEOFF to an altitude AMSL, straight up, nose as it stands; ends in AUTO.LOITER."""
    north_m, east_m, _ = here_nea_m
    return px4.take_off(to, (north_m, east_m, command.altitude_amsl_m))


def _offboard_timeout(value: float, case: Case) -> Finding | None:
    """PX4's COM_OF_LOSS_T; the mode changes 0.12 s after it (px4.md 6)."""
    slack_s = 0.12 + rules.begins_to_brake_s(case, "MPC_ACC_HOR", "MPC_JERK_AUTO", (3.0, 4.0))
    return rules.timeout(value, slack_s, case)


_SPEED: Final = rules.at_least(  # at this speed it falls behind without recovery (px4.md 5)
    lambda limits: limits.speed_m_s / 0.85,
    "more than 85 % of it is flown: nothing is left to catch up with",
    "Raise it to {up:g} or more, or fly slower",
)
_RULES: Final = (
    Rule("COM_OF_LOSS_T", _offboard_timeout, "how long it flies on without setpoints"),
    Rule("MPC_XY_VEL_MAX", _SPEED, "its highest speed"),
    Rule("MPC_Z_VEL_MAX_UP", rules.copter_climbs, "how fast it climbs"),
    Rule("MPC_Z_VEL_MAX_DN", rules.copter_sinks, "how fast it sinks"),
    Rule("MPC_TILTMAX_AIR", rules.tilt),
    Rule("MPC_ACC_HOR", rules.brakes),
    *only_read("MPC_JERK_AUTO MPC_LAND_SPEED"),
    *px4.RULES,
)

PX4_MULTICOPTER = Autopilot(
    firmware=px4.FIRMWARE,
    traits=VehicleTraits(
        name="PX4 multicopter",
        kind="copter",
        take_off=TakeoffSequence.CLIMB_THEN_ARM,
        needs_setpoints_before_offboard=True,
        handling=replace(COPTER, name="PX4 multicopter", steady_m=0.5),  # it wanders in gusts
    ),
    rules=_RULES,
    parameters_for=lambda limits: {
        "MPC_XY_VEL_MAX": 1.3 * limits.speed_m_s,
        "MPC_Z_VEL_MAX_UP": max(3.0, limits.climb_rate_m_s),
        "MPC_Z_VEL_MAX_DN": max(1.5, limits.climb_rate_m_s),
        "MPC_TKO_SPEED": max(1.5, 0.5 * limits.climb_rate_m_s),  # slower is given up (`ground`)
    },
    modes=px4.MODES,
    streams_hz={**px4.STREAMS_HZ, wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0},
    intermittent=px4.INTERMITTENT,
    requested_once=px4.REQUESTED_ONCE,
    decoders={
        wire.MAVLINK_MSG_ID_ESTIMATOR_STATUS: px4.estimator,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: px4.local_echo,
    },
    take_off=_take_off,
    setpoint=messages.position_target,
)
