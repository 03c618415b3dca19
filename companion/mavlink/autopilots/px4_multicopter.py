"""PX4 multicopter: position + velocity + yaw in OFFBOARD.  Measured: px4.md 4 and 5.

It flies at the velocity of its setpoints.  10 s on the ground disarm it again.
"""

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import messages, px4
from companion.mavlink.autopilots.common import Autopilot, LaunchPose
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import PX4_MULTICOPTER_RULES
from companion.mission.events import TakeOff
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits


def _take_off(
    command: TakeOff, here: LaunchPose, frame: LocalFrame, system_id: int
) -> list[Message]:
    """NAV_TAKEOFF to an altitude AMSL, straight up, nose as it stands; ends in AUTO.LOITER."""
    north_m, east_m, _ = here.position_nea_m
    return px4.take_off((north_m, east_m, command.altitude_amsl_m), frame, system_id)


PX4_MULTICOPTER = Autopilot(
    traits=VehicleTraits(
        name="PX4 multicopter",
        hovers=True,
        take_off=TakeoffSequence.CLIMB_THEN_ARM,
        needs_setpoints_before_offboard=True,
    ),
    rules=PX4_MULTICOPTER_RULES,
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
