"""Commands common to all autopilots, and the interface that each strategy fills in."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots.messages import DECODERS, Decoder, To, set_mode
from companion.mavlink.dialect import Message, wire
from companion.mavlink.fence import FenceSettings
from companion.mavlink.plan_client import PlanItem
from companion.mavlink.rules import Rule
from companion.mission import events
from companion.mission.vehicle_traits import VehicleTraits
from companion.path.limits import Limits, VehicleKind

_COPTERS = (
    *("QUADROTOR", "HEXAROTOR", "OCTOROTOR", "TRICOPTER", "DODECAROTOR", "DECAROTOR"),
    *("COAXIAL", "HELICOPTER", "GENERIC_MULTIROTOR"),
)
KINDS: dict[int, VehicleKind] = {
    wire.MAV_TYPE_FIXED_WING: "plane",
    **{getattr(wire, f"MAV_TYPE_{name}"): "copter" for name in _COPTERS},
}
"""Kinds of vehicle by MAV_TYPE.  A VTOL is neither, and is not supported."""

_FAILSAFE = (wire.MAV_STATE_CRITICAL, wire.MAV_STATE_EMERGENCY)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Modes:
    """Modes of a firmware, or of a vehicle type where they differ within it."""

    meanings: Mapping[tuple[int, ...], events.Mode]
    """Of what it reports: mode, or main and sub mode.  The first that means a mode is what is asked
    for by DO_SET_MODE; a mode that none means is not supported."""
    names: Mapping[tuple[int, ...], str]
    """The autopilot's own."""
    numbers: Callable[[int], tuple[int, ...]] = lambda custom_mode: (custom_mode,)
    """Of what a heartbeat reports as custom_mode."""

    def mode_of(self, custom_mode: int) -> events.Mode:
        """The mode that a heartbeat reports."""
        return self.meanings.get(self.numbers(custom_mode), events.Mode.OTHER)

    def asked(self, mode: events.Mode) -> tuple[int, ...]:
        """The parameters of DO_SET_MODE; empty if it is not supported."""
        return next((numbers for numbers, means in self.meanings.items() if means is mode), ())

    def name_of(self, custom_mode: int) -> str:
        """The autopilot's own name of it."""
        numbers = self.numbers(custom_mode)
        return self.names.get(numbers) or f"mode {'.'.join(map(str, numbers))}"


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Firmware:
    """Facts of one autopilot that hold for all its vehicle types."""

    name: str
    """As missions name it (`Mission.autopilot`)."""
    number: int
    """Its MAV_AUTOPILOT."""
    fence: Callable[[Mapping[str, float]], FenceSettings]
    """Settings of its fence, from parameters by name in the autopilot's units."""
    breached: re.Pattern[str]
    """Searched for in its texts: it has crossed its fence."""
    breach_events: frozenset[int] = frozenset()
    """The ids of EVENT that say so, without the component's byte."""
    misread: Callable[[Sequence[PlanItem], str], str] = lambda _items, _who: ""
    """What of a fence an autopilot of that name misreads, with the remedy; empty: nothing."""
    all_is_well: Callable[[], Message]
    """What its estimator reports when the position may be believed."""
    lasting_battery: Mapping[str, float]
    """Parameters of its simulation."""
    is_bytewise: bool = False
    """Whether integers are sent bytewise in the float field of parameters, or cast to float."""
    home_first: bool = False
    """Whether item 0 of its mission is home and no target."""
    asks_time_often: bool = False
    """Whether it sends TIMESYNC at 10 Hz by itself."""


def _no_messages(*_: object) -> list[Message]:
    return []


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Autopilot:
    """Encodes commands for one autopilot and vehicle type, and decodes its messages.

    Stateless: one value serves any number of vehicles.  Messages are addressed to component 1 of
    the given system.  Defaults fit most autopilots.
    """

    firmware: Firmware
    traits: VehicleTraits
    """What the mission has to know of it."""
    rules: tuple[Rule, ...]
    """Parameter checks for a safe flight."""
    parameters_for: Callable[[Limits], Mapping[str, float]]
    """Parameters that an operator sets so that it can fly with these limits."""
    modes: Modes
    """Its mode numbers and names."""
    streams_hz: Mapping[int, float]
    """Message id -> rate to ask for by SET_MESSAGE_INTERVAL, besides GLOBAL_POSITION_INT."""
    intermittent: frozenset[int]
    """Streams that may be silent without a fault."""
    requested_once: tuple[int, ...] = ()
    """Message ids to ask for by REQUEST_MESSAGE until they have come: never streamed."""
    decoders: Mapping[int, Decoder]
    """Message id -> decoder, for messages that differ between autopilots."""
    take_off: Callable[[events.TakeOff, events.Vector, float, To], list[Message]]
    """Take-off command; the sequence of mode, arming and this is `traits.take_off`.

    (command, where it stands, where its nose points in the frame, to whom); empty if a value is not
    finite or out of range.
    """
    setpoint: Callable[[events.Setpoint, To, float], list[Message] | None]
    """(setpoint, to whom, the largest circle that a plane may hold on, metres) -> messages.

    The only function that encodes setpoints.  None if any value is not finite or out of range: a
    NaN would abort ArduPilot's process, and 0, 0 would be flown to.
    """
    set_speed: Callable[[float, int], list[Message]] = _no_messages
    """Speed command for an autopilot that controls its own speed: (speed_m_s, system_id)."""
    hold_about: Callable[[events.Vector, To], list[Message]] = _no_messages
    """Hold at a point, if the autopilot supports it: (at_nea_m, to whom)."""
    acknowledges_setpoints: bool = False
    """Else the position target echo alone shows whether one was taken."""

    @property
    def name(self) -> str:
        """Display name: ArduCopter, ArduPlane, PX4 multicopter, PX4 fixed wing."""
        return self.traits.name

    def set_mode(self, command: events.SetMode, to: To) -> list[Message]:
        """Request a mode; empty if unsupported.  Only the heartbeat confirms it."""
        if command.mode is events.Mode.HOLD and command.at_nea_m is not None:
            about = self.hold_about(command.at_nea_m, to)
            if about:
                return about
        numbers = self.modes.asked(command.mode)
        return [set_mode(to.system_id, *numbers)] if numbers else []

    def event_of(
        self,
        message: Message,
        now_s: float,
        frame: LocalFrame,
        origin_nea_m: events.Vector | None = None,
    ) -> events.Event | None:
        """The mission event of an autopilot message; None if there is none.

        `origin_nea_m` is the newest `Origin`, which an echo in the autopilot's own local frame
        is measured from; without it that echo is ignored.
        """
        number = message.get_msgId()
        read = self.decoders.get(number) or DECODERS.get(number)
        if read is not None:
            return read(message, now_s, frame, origin_nea_m)
        if number != wire.MAVLINK_MSG_ID_HEARTBEAT:
            return None
        return events.VehicleStatus(
            time_s=now_s,
            mode=self.modes.mode_of(message.custom_mode),
            armed=bool(message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED),
            failsafe=message.system_status in _FAILSAFE,
        )
