"""ArduCopter: position + velocity + yaw in GUIDED; it holds in BRAKE.

Not in LOITER, which sinks without a throttle stick.  It refuses to arm while there is no position
estimate: ask again, once a second.  There is no take-off mode, and it flies at the velocity of its
setpoints, which it does not acknowledge: the echo tells.  Measured: ardupilot.md 2 and 3.
"""

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import ardupilot, messages
from companion.mavlink.autopilots.common import Autopilot, LaunchPose
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import ARDUCOPTER_RULES
from companion.mission.events import Mode, TakeOff
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits

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


ARDUCOPTER = Autopilot(
    traits=VehicleTraits(
        name="ArduCopter",
        hovers=True,
        take_off=TakeoffSequence.GUIDED_THEN_CLIMB,
        turn_lag_s2=0.5,  # of its shaping, 2 (WPNAV_ACCEL / PSC_JERK_XY)^2; 0.6 to 0.8 was measured
    ),
    rules=ARDUCOPTER_RULES,
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
