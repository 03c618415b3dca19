"""PX4 fixed wing: a point of the path and the tangent there, in OFFBOARD.  Measured: px4.md 10."""

import math
from typing import final

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import from_wire, px4, to_wire
from companion.mavlink.autopilots.common import Here
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import PX4_FIXED_WING_RULES
from companion.mission.driving import Driving, TakeOffWay
from companion.mission.events import Event, Mode, SetMode, Setpoint, TakeOff, Vector

_RUNWAY_M = 300.0
"""A fixed wing is sent up to a point this far ahead: then it ends in AUTO.LOITER (px4.md 10)."""


@final
class Px4FixedWing:
    """PX4's strategy for planes; see `common.Autopilot`.

    Its speed is its parameter FW_AIRSPD_TRIM, whatever is asked for, and no echo comes in OFFBOARD.
    """

    name = "PX4 fixed wing"
    driving = Driving(
        name=name,
        hovers=False,
        take_off=TakeOffWay.CLIMB_THEN_ARM,
        lead_s=1.5,
        streams_first=True,
        echoes=False,
        flies_on_s=1.5,
    )
    streams_hz = px4.STREAMS_HZ
    silent_at_times = px4.SILENT
    asked_once = px4.ASKED_ONCE
    rules = PX4_FIXED_WING_RULES

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports; the failsafe DESCEND is told as LAND."""
        return px4.mode_of(custom_mode)

    def mode_name(self, custom_mode: int) -> str:
        """As PX4's ground stations call it."""
        return px4.mode_name(custom_mode)

    def set_mode(self, command: SetMode, frame: LocalFrame, system_id: int) -> list[Message]:
        """DO_SET_MODE, acknowledged twice; or, to hold about a point, DO_REPOSITION."""
        if command.mode is not Mode.HOLD or command.at_nea_m is None:
            return px4.set_mode(command.mode, system_id)
        place = to_wire.wire_place(command.at_nea_m, frame)
        if place is None:
            return px4.set_mode(command.mode, system_id)
        as_it_is, switch, no_radius = -1.0, 1.0, 0.0
        return [
            to_wire.command_int(
                system_id,
                wire.MAV_CMD_DO_REPOSITION,
                (as_it_is, switch, no_radius, px4.AS_IT_POINTS),
                place,
                command.at_nea_m[2],
            )
        ]

    def arm(self, system_id: int) -> list[Message]:
        """After the command to take off: it runs off at once."""
        return to_wire.arm(system_id)

    def take_off(
        self, command: TakeOff, here: Here, frame: LocalFrame, system_id: int
    ) -> list[Message]:
        """NAV_TAKEOFF to a point 300 m ahead at an altitude AMSL; ends in AUTO.LOITER about it.

        Without a point it stays in AUTO.TAKEOFF.
        """
        north_m, east_m, _ = here.position_nea_m
        if not all(map(math.isfinite, (north_m, east_m, here.heading_rad))):
            return []
        course_rad = here.heading_rad - frame.grid_north_rad(north_m, east_m)
        ahead = (
            north_m + _RUNWAY_M * math.cos(course_rad),
            east_m + _RUNWAY_M * math.sin(course_rad),
            command.altitude_amsl_m,
        )
        return px4.take_off(ahead, frame, system_id)

    def set_speed(self, speed_m_s: float, system_id: int) -> list[Message]:
        """None: it flies at FW_AIRSPD_TRIM."""
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
        """A point of the path and the tangent there; to stay, the point alone, to be circled.

        Never an acceleration: its sign is wrong there (px4.md 1, item 7).
        """
        del loiter_radius_m
        point = to_wire.wire_point(setpoint, frame)
        if point is None:
            return None
        mask = to_wire.POSITION if setpoint.stay else to_wire.POSITION_VELOCITY
        return [to_wire.position_target(point, mask, system_id)]

    def event_of(
        self,
        message: Message,
        now_s: float,
        frame: LocalFrame,
        origin_nea_m: Vector | None = None,
    ) -> Event | None:
        """What a message means for the mission; None: nothing."""
        del origin_nea_m
        if message.get_type() == "ESTIMATOR_STATUS":
            return px4.estimator(message, now_s)
        return from_wire.event_of(message, now_s, frame, self)

    def refuses_setpoint(self, message: Message) -> bool:
        """Setpoints are not acknowledged."""
        del message
        return False
