"""PX4 multicopter: position + velocity + yaw in OFFBOARD.  Measured: px4.md 4 and 5."""

from collections.abc import Mapping
from typing import final

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import from_wire, px4, to_wire
from companion.mavlink.autopilots.common import Here
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import PX4_MULTICOPTER_RULES
from companion.mission.driving import Driving, TakeOffWay
from companion.mission.events import Event, Mode, SetMode, Setpoint, TakeOff, Vector


@final
class Px4Multicopter:
    """PX4's strategy for what hovers; see `common.Autopilot`."""

    name = "PX4 multicopter"
    driving = Driving(
        name=name,
        hovers=True,
        take_off=TakeOffWay.CLIMB_THEN_ARM,
        streams_first=True,
        flies_on_s=1.5,
    )
    streams_hz: Mapping[int, float] = {
        **px4.STREAMS_HZ,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
    }
    silent_at_times = px4.SILENT
    asked_once = px4.ASKED_ONCE
    rules = PX4_MULTICOPTER_RULES

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports; the failsafe DESCEND is told as LAND."""
        return px4.mode_of(custom_mode)

    def mode_name(self, custom_mode: int) -> str:
        """As PX4's ground stations call it."""
        return px4.mode_name(custom_mode)

    def set_mode(self, command: SetMode, frame: LocalFrame, system_id: int) -> list[Message]:
        """DO_SET_MODE, acknowledged twice."""
        del frame
        return px4.set_mode(command.mode, system_id)

    def arm(self, system_id: int) -> list[Message]:
        """After the command to take off; 10 s on the ground disarm it again."""
        return to_wire.arm(system_id)

    def take_off(
        self, command: TakeOff, here: Here, frame: LocalFrame, system_id: int
    ) -> list[Message]:
        """NAV_TAKEOFF to an altitude AMSL, straight up, nose as it stands; ends in AUTO.LOITER."""
        north_m, east_m, _ = here.position_nea_m
        above = (north_m, east_m, command.altitude_amsl_m)
        return px4.take_off(above, frame, system_id)

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
            case "ESTIMATOR_STATUS":
                return px4.estimator(message, now_s)
            case "POSITION_TARGET_LOCAL_NED":
                return px4.local_echo(message, now_s, frame, origin_nea_m)
            case _:
                return from_wire.event_of(message, now_s, frame, self)

    def refuses_setpoint(self, message: Message) -> bool:
        """Setpoints are not acknowledged: the echo tells."""
        del message
        return False
