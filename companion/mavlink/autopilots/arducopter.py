"""ArduCopter: position + velocity + yaw in GUIDED; it holds in BRAKE.

Not in LOITER, which sinks without a throttle stick.  Measured: ardupilot.md 2 and 3.
"""

from collections.abc import Mapping
from typing import final

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import ardupilot, from_wire, to_wire
from companion.mavlink.autopilots.common import Here
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import ARDUCOPTER_RULES
from companion.mission.driving import Driving, TakeOffWay
from companion.mission.events import Event, Mode, SetMode, Setpoint, TakeOff, Vector

_MODES: Mapping[Mode, tuple[int, ...]] = {
    Mode.GUIDED: (wire.COPTER_MODE_GUIDED,),
    Mode.HOLD: (wire.COPTER_MODE_BRAKE,),
    Mode.LAND: (wire.COPTER_MODE_LAND,),
    Mode.RETURN: (
        wire.COPTER_MODE_RTL,
        wire.COPTER_MODE_SMART_RTL,
        wire.COPTER_MODE_AUTO_RTL,
    ),
}
_NAMES = ardupilot.mode_names("COPTER_MODE")


@final
class ArduCopter:
    """ArduCopter's strategy; see `common.Autopilot`."""

    name = "ArduCopter"
    driving = Driving(name=name, hovers=True, take_off=TakeOffWay.GUIDED_THEN_CLIMB, flies_on_s=3.5)
    streams_hz: Mapping[int, float] = {
        wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        wire.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
        wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        wire.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
        wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
        wire.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        wire.MAVLINK_MSG_ID_ATTITUDE: 1.0,
    }
    silent_at_times = frozenset(
        {
            wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,  # only in GUIDED
            wire.MAVLINK_MSG_ID_HOME_POSITION,  # until there is one, as the next
            wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        }
    )
    asked_once: tuple[int, ...] = ()
    rules = ARDUCOPTER_RULES

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        return ardupilot.mode_in(_MODES, custom_mode)

    def mode_name(self, custom_mode: int) -> str:
        """As ArduPilot calls it."""
        return _NAMES.get(custom_mode, f"mode {custom_mode}")

    def set_mode(self, command: SetMode, frame: LocalFrame, system_id: int) -> list[Message]:
        """DO_SET_MODE; there is no take-off mode."""
        del frame
        numbers = _MODES.get(command.mode, ())
        return [ardupilot.mode_message(number, system_id) for number in numbers[:1]]

    def arm(self, system_id: int) -> list[Message]:
        """Refused while there is no position estimate: ask again, once a second."""
        return to_wire.arm(system_id)

    def take_off(
        self, command: TakeOff, here: Here, frame: LocalFrame, system_id: int
    ) -> list[Message]:
        """NAV_TAKEOFF to a height above home, in GUIDED and armed.

        Any setpoint before EXTENDED_SYS_STATE says `in air` abandons it.
        """
        del here, frame
        height_m = command.above_home_m
        if not 0.0 < height_m < to_wire.HIGHEST_AMSL_M:
            return []
        return [to_wire.command_long(system_id, wire.MAV_CMD_NAV_TAKEOFF, *([0.0] * 6), height_m)]

    def set_speed(self, speed_m_s: float, system_id: int) -> list[Message]:
        """None: it flies at the velocity of its setpoints."""
        del speed_m_s, system_id
        return []

    def setpoint(
        self,
        setpoint: Setpoint,
        frame: LocalFrame,
        system_id: int,
        *,
        loiter_radius_m: float = 0.0,
    ) -> list[Message] | None:
        """Position, velocity and yaw; a vehicle that stays gets a velocity of zero."""
        del loiter_radius_m
        return to_wire.hovering_setpoint(setpoint, frame, system_id)

    def event_of(
        self,
        message: Message,
        now_s: float,
        frame: LocalFrame,
        origin_nea_m: Vector | None = None,
    ) -> Event | None:
        """What a message means for the mission; None: nothing."""
        match message.get_type():
            case "EKF_STATUS_REPORT":
                return ardupilot.estimator(message, now_s)
            case "POSITION_TARGET_LOCAL_NED":
                return ardupilot.local_echo(message, now_s, frame, origin_nea_m)
            case _:
                return from_wire.event_of(message, now_s, frame, self)

    def refuses_setpoint(self, message: Message) -> bool:
        """Setpoints are not acknowledged: the echo tells."""
        del message
        return False
