"""What all autopilots are told alike, and what each file about one of them has to say of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, final

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots.messages import READS, Reader, command_long, set_mode
from companion.mavlink.dialect import Message, wire
from companion.mavlink.judgement import ParameterRule
from companion.mission.driving import Driving
from companion.mission.events import (
    Event,
    Mode,
    SetMode,
    Setpoint,
    TakeOff,
    Vector,
    VehicleStatus,
)

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

_FAILSAFE = (wire.MAV_STATE_CRITICAL, wire.MAV_STATE_EMERGENCY)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Here:
    """Where a vehicle stands before it takes off."""

    position_nea_m: Vector
    heading_rad: float
    """Where its nose points, clockwise from true north (`heading_rad` of GLOBAL_POSITION_INT)."""


class Modes(Protocol):
    """One value per family of autopilots, or per kind of vehicle where their numbers differ."""

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        ...

    def name_of(self, custom_mode: int) -> str:
        """The same in the autopilot's own words."""
        ...

    def numbers_of(self, mode: Mode) -> tuple[int, ...] | None:
        """What DO_SET_MODE asks for, main and sub mode where it has both; None: no such mode."""
        ...


class SetpointSayer(Protocol):
    """How a setpoint is said."""

    def __call__(
        self,
        setpoint: Setpoint,
        frame: LocalFrame,
        system_id: int,
        *,
        loiter_radius_m: float = 0.0,
    ) -> list[Message] | None:
        """None if any value is not finite or out of range.

        A NaN would abort ArduPilot's process, and 0, 0 would be flown to.  `loiter_radius_m` is
        the circle that a plane that stays may fly at most (`Limits.loiter_radius_m`).
        """
        ...


def _nothing_to_say(*_: object) -> list[Message]:
    return []


def _says_no_such_thing(_: Message) -> bool:
    return False


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Autopilot:
    """How one kind of autopilot and vehicle is told what to do, and what its messages mean.

    Without state: one value serves any number of vehicles.  Messages are addressed to component 1
    of the system given.  What has a default here, most of them have no say in.
    """

    driving: Driving
    """What the mission has to know of it."""
    rules: tuple[ParameterRule, ...]
    """What its parameters have to be for a safe flight."""
    modes: Modes
    """How it numbers and names its modes."""
    streams_hz: Mapping[int, float]
    """Message id -> rate to ask for by SET_MESSAGE_INTERVAL, besides GLOBAL_POSITION_INT."""
    silent_at_times: frozenset[int]
    """Those of the streams that say nothing while there is nothing to say: no fault."""
    asked_once: tuple[int, ...] = ()
    """Message ids to ask for by REQUEST_MESSAGE until they have come: never streamed."""
    reads: Mapping[int, Reader]
    """Message id -> how it is read, for what not all autopilots say alike."""
    take_off: Callable[[TakeOff, Here, LocalFrame, int], list[Message]]
    """Send it up in its own way; the order of mode, arming and this is `driving.take_off`.

    (command, here, frame, system_id); empty if a value is not finite or out of range.
    """
    setpoint: SetpointSayer
    """The one way to a setpoint."""
    set_speed: Callable[[float, int], list[Message]] = _nothing_to_say
    """Tell one that chooses its speed by itself how fast to fly: (speed_m_s, system_id)."""
    hold_about: Callable[[Vector, LocalFrame, int], list[Message]] = _nothing_to_say
    """Hold about a point, for one that can be told where: (at_nea_m, frame, system_id)."""
    refuses_setpoint: Callable[[Message], bool] = _says_no_such_thing
    """Whether a message says that a setpoint was not taken.

    By default none does: setpoints are not acknowledged, and the echo tells.
    """

    @property
    def name(self) -> str:
        """For people: ArduCopter, ArduPlane, PX4 multicopter, PX4 fixed wing."""
        return self.driving.name

    def mode_of(self, custom_mode: int) -> Mode:
        """The mode that a heartbeat reports."""
        return self.modes.mode_of(custom_mode)

    def mode_name(self, custom_mode: int) -> str:
        """The same in the autopilot's own words."""
        return self.modes.name_of(custom_mode)

    def set_mode(self, command: SetMode, frame: LocalFrame, system_id: int) -> list[Message]:
        """Ask for a mode; empty if it has no such mode.  Only a heartbeat tells that it obeys."""
        if command.mode is Mode.HOLD and command.at_nea_m is not None:
            about = self.hold_about(command.at_nea_m, frame, system_id)
            if about:
                return about
        numbers = self.modes.numbers_of(command.mode)
        return [] if numbers is None else [set_mode(system_id, *numbers)]

    def arm(self, system_id: int) -> list[Message]:
        """Ask it to arm, without force: its own checks stay on."""
        return [command_long(system_id, wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)]

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
        number = message.get_msgId()
        read = self.reads.get(number) or READS.get(number)
        if read is not None:
            return read(message, now_s, frame, origin_nea_m)
        if number != wire.MAVLINK_MSG_ID_HEARTBEAT:
            return None
        return VehicleStatus(
            time_s=now_s,
            mode=self.modes.mode_of(message.custom_mode),
            armed=bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED),
            failsafe=message.system_status in _FAILSAFE,
        )
