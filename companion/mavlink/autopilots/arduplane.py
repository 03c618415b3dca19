"""ArduPlane: DO_REPOSITION, streamed, to a point well ahead on the path.

SET_POSITION_TARGET moves it up and down only.  In GUIDED it flies at the point, then circles it,
for ever: nothing ends when the stream does.  Measured: ardupilot.md 7.
"""

import math
from collections.abc import Mapping
from typing import final

from companion.geodesy import LocalFrame, deg
from companion.mavlink.autopilots import ardupilot, from_wire, to_wire
from companion.mavlink.autopilots.common import Here
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import ARDUPLANE_RULES
from companion.mission.driving import Driving, TakeOffWay
from companion.mission.events import Event, Mode, SetMode, Setpoint, TakeOff, Vector

_MODES: Mapping[Mode, tuple[int, ...]] = {
    Mode.GUIDED: (wire.PLANE_MODE_GUIDED,),
    Mode.HOLD: (wire.PLANE_MODE_LOITER,),
    Mode.RETURN: (wire.PLANE_MODE_RTL,),
    Mode.TAKE_OFF: (wire.PLANE_MODE_TAKEOFF,),
}
_NAMES = ardupilot.mode_names("PLANE_MODE")
_FOLLOWING_RADIUS_M = 10.0
"""A larger one makes it circle beside the path (ardupilot.md 7)."""
_WIDER_M = 20.0
"""By so much its circles are wider than asked, at 23 m/s (17 to 20 m measured)."""
_CIRCLE_M = 60.0
"""To ask for when nobody says how wide the circle may be."""
_FASTEST_M_S = 300.0


@final
class ArduPlane:
    """ArduPlane's strategy; see `common.Autopilot`."""

    name = "ArduPlane"
    driving = Driving(
        name=name,
        hovers=False,
        take_off=TakeOffWay.MODE_THEN_ARM,
        lead_s=5.5,
        setpoint_period_s=0.25,
        holds_in_guided=True,
        lands=False,
        flies_on_s=5.5,
    )
    streams_hz: Mapping[int, float] = {
        wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        wire.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
        wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 4.0,
        wire.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
        wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
        wire.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        wire.MAVLINK_MSG_ID_ATTITUDE: 1.0,
    }
    silent_at_times = frozenset(
        {
            wire.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,  # not in MANUAL
            wire.MAVLINK_MSG_ID_HOME_POSITION,  # until there is one, as the next
            wire.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        }
    )
    asked_once: tuple[int, ...] = ()
    rules = ARDUPLANE_RULES

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        return ardupilot.mode_in(_MODES, custom_mode)

    def mode_name(self, custom_mode: int) -> str:
        """As ArduPilot calls it."""
        return _NAMES.get(custom_mode, f"mode {custom_mode}")

    def set_mode(self, command: SetMode, frame: LocalFrame, system_id: int) -> list[Message]:
        """DO_SET_MODE; there is no mode to land where it is.  LOITER circles where it begins."""
        del frame
        numbers = _MODES.get(command.mode, ())
        return [ardupilot.mode_message(number, system_id) for number in numbers[:1]]

    def arm(self, system_id: int) -> list[Message]:
        """In mode TAKEOFF it runs off as soon as it is armed."""
        return to_wire.arm(system_id)

    def take_off(
        self, command: TakeOff, here: Here, frame: LocalFrame, system_id: int
    ) -> list[Message]:
        """Mode TAKEOFF, which climbs to its parameter TKOFF_ALT straight ahead, then circles.

        It takes no height.  What is missing to the mission's it climbs in GUIDED, on a circle.
        """
        del command, here
        return self.set_mode(SetMode(mode=Mode.TAKE_OFF), frame, system_id)

    def set_speed(self, speed_m_s: float, system_id: int) -> list[Message]:
        """GUIDED_CHANGE_SPEED, an airspeed; forgotten whenever the mode changes."""
        if not 0.0 < speed_m_s < _FASTEST_M_S:
            return []
        airspeed = float(wire.SPEED_TYPE_AIRSPEED)
        parameters = (airspeed, speed_m_s, 0.0, 0.0)
        return [to_wire.command_int(system_id, wire.MAV_CMD_GUIDED_CHANGE_SPEED, parameters)]

    def setpoint(
        self,
        setpoint: Setpoint,
        frame: LocalFrame,
        system_id: int,
        *,
        loiter_radius_m: float = 0.0,
    ) -> list[Message] | None:
        """DO_REPOSITION without the switch to GUIDED: a pilot who took the mode keeps it."""
        point = to_wire.wire_point(setpoint, frame)
        if point is None or not math.isfinite(loiter_radius_m):
            return None
        radius_m = _FOLLOWING_RADIUS_M
        if setpoint.stay:
            narrower_m = max(loiter_radius_m - _WIDER_M, 0.5 * loiter_radius_m)
            radius_m = narrower_m if loiter_radius_m > 0.0 else _CIRCLE_M
        as_it_is, no_switch, clockwise = -1.0, 0.0, 0.0
        return [
            to_wire.command_int(
                system_id,
                wire.MAV_CMD_DO_REPOSITION,
                (as_it_is, no_switch, radius_m, clockwise),
                (point.latitude_e7, point.longitude_e7),
                point.altitude_amsl_m,
            )
        ]

    def event_of(
        self,
        message: Message,
        now_s: float,
        frame: LocalFrame,
        origin_nea_m: Vector | None = None,
    ) -> Event | None:
        """What a message means for the mission; None: nothing."""
        del origin_nea_m
        match message.get_type():
            case "EKF_STATUS_REPORT":
                return ardupilot.estimator(message, now_s)
            case "POSITION_TARGET_GLOBAL_INT":
                place = (deg(message.lat_int), deg(message.lon_int))
                return from_wire.echo_at(place, message.alt, None, now_s, frame)
            case _:
                return from_wire.event_of(message, now_s, frame, self)

    def refuses_setpoint(self, message: Message) -> bool:
        """An ACK of DO_REPOSITION other than ACCEPTED: not in GUIDED, or outside of its fence."""
        is_ack = message.get_type() == "COMMAND_ACK"
        ours = is_ack and message.command == wire.MAV_CMD_DO_REPOSITION
        return bool(ours and message.result != wire.MAV_RESULT_ACCEPTED)
