"""The interface of all strategies, one per autopilot and kind of vehicle."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, final

from companion.geodesy import LocalFrame
from companion.mavlink.dialect import Message, wire
from companion.mavlink.judgement import ParameterRule
from companion.mission.driving import Driving
from companion.mission.events import Event, Mode, SetMode, Setpoint, TakeOff, Vector

ROTORCRAFT = frozenset(
    {
        wire.MAV_TYPE_QUADROTOR,
        wire.MAV_TYPE_COAXIAL,
        wire.MAV_TYPE_HELICOPTER,
        wire.MAV_TYPE_HEXAROTOR,
        wire.MAV_TYPE_OCTOROTOR,
        wire.MAV_TYPE_TRICOPTER,
        wire.MAV_TYPE_DODECAROTOR,
        wire.MAV_TYPE_DECAROTOR,
        wire.MAV_TYPE_GENERIC_MULTIROTOR,
    }
)
"""MAV_TYPE of what hovers.  A VTOL is neither this nor a plane, and is not flown."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Here:
    """Where a vehicle stands before it takes off."""

    position_nea_m: Vector
    heading_rad: float
    """Where its nose points, clockwise from true north (`heading_rad` of GLOBAL_POSITION_INT)."""


class Autopilot(Protocol):
    """How one kind of autopilot and vehicle is told what to do, and what its messages mean.

    Without state: one value serves any number of vehicles.  Messages are addressed to component 1
    of the system given.
    """

    @property
    def name(self) -> str:
        """For people: ArduCopter, ArduPlane, PX4 multicopter, PX4 fixed wing."""
        ...

    @property
    def driving(self) -> Driving:
        """What the mission has to know of it."""
        ...

    @property
    def streams_hz(self) -> Mapping[int, float]:
        """Message id -> rate to ask for by SET_MESSAGE_INTERVAL, besides GLOBAL_POSITION_INT."""
        ...

    @property
    def silent_at_times(self) -> frozenset[int]:
        """Those of the streams that say nothing while there is nothing to say: no fault."""
        ...

    @property
    def rules(self) -> tuple[ParameterRule, ...]:
        """What its parameters have to be for a safe flight."""
        ...

    @property
    def asked_once(self) -> tuple[int, ...]:
        """Message ids to ask for by REQUEST_MESSAGE until they have come: never streamed."""
        ...

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        ...

    def mode_name(self, custom_mode: int) -> str:
        """The same in the autopilot's own words."""
        ...

    def set_mode(self, command: SetMode, frame: LocalFrame, system_id: int) -> list[Message]:
        """Ask for a mode; empty if it has no such mode.  Only a heartbeat tells that it obeys."""
        ...

    def arm(self, system_id: int) -> list[Message]:
        """Ask it to arm."""
        ...

    def take_off(
        self, command: TakeOff, here: Here, frame: LocalFrame, system_id: int
    ) -> list[Message]:
        """Send it up in its own way; the order of mode, arming and this is `driving.take_off`.

        Empty if a value is not finite or out of range.
        """
        ...

    def set_speed(self, speed_m_s: float, system_id: int) -> list[Message]:
        """Tell one that chooses its speed by itself how fast to fly; empty for all others."""
        ...

    def setpoint(
        self,
        setpoint: Setpoint,
        frame: LocalFrame,
        system_id: int,
        *,
        loiter_radius_m: float = 0.0,
    ) -> list[Message] | None:
        """The one way to a setpoint; None if any value is not finite or out of range.

        A NaN would abort ArduPilot's process, and 0, 0 would be flown to.  `loiter_radius_m` is
        the circle that a plane that stays may fly at most (`Limits.loiter_radius_m`).
        """
        ...

    def event_of(
        self,
        message: Message,
        now_s: float,
        frame: LocalFrame,
        origin_nea_m: Vector | None = None,
    ) -> Event | None:
        """What a message of the autopilot means for the mission; None: nothing.

        `origin_nea_m` is the newest `Origin`, which an echo in the autopilot's own local frame
        is measured from; without it such an echo means nothing.
        """
        ...

    def refuses_setpoint(self, message: Message) -> bool:
        """Whether a message says that a setpoint was not taken (an ACK of DO_REPOSITION)."""
        ...
