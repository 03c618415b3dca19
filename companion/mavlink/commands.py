"""What each command means that the companion understands: an order, a question, or why not.

Who asks, and how it is answered, is `command_server`'s part.  Values that an order does not need
are not read; those that it needs are finite and in range, or it is denied with words.
"""

import enum
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import final

from companion.geodesy import LocalFrame, deg
from companion.mavlink.dialect import Message, wire
from companion.mavlink.presence import AUTOPILOT_VERSION, Presence
from companion.mission.events import OrderKind
from companion.path.limits import Limits

_SLOWEST_M_S = 0.1
_SLOWEST_SHARE = 0.75  # of a plane's speed: nobody knows here when it stalls
_LARGEST_FLOAT = 3.4e38
_FRAMES = frozenset(
    {
        wire.MAV_FRAME_GLOBAL,
        wire.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        wire.MAV_FRAME_GLOBAL_INT,
        wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    }
)


class Result(enum.IntEnum):
    """MAV_RESULT, as far as the companion uses it."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    IN_PROGRESS = 5
    UNSUPPORTED_MAV_FRAME = 9
    """Newer than the dialect."""


@final
@dataclass(frozen=True, slots=True)
class Meaning:
    """What becomes of one command."""

    result: Result
    text: str = ""
    order: OrderKind | None = None
    target_ne_m: tuple[float, float] | None = None
    speed_m_s: float | None = None
    replies: tuple[Message, ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A command in either form."""

    message: Message
    parameters: tuple[float, float, float, float]
    confirmation: int | None
    """None for a COMMAND_INT, which has none."""
    values: str = field(init=False, repr=False)
    """All of them but the confirmation, as text: NaN does not equal itself."""

    def __post_init__(self) -> None:
        names = [name for name in self.message.get_fieldnames() if name != "confirmation"]
        values = [getattr(self.message, name) for name in names]
        object.__setattr__(self, "values", repr((self.message.get_type(), *values)))

    @property
    def number(self) -> int:
        """MAV_CMD."""
        return int(self.message.command)


def speed_bounds_m_s(limits: Limits) -> tuple[float, float]:
    """The speeds that a mission may be told to fly: never faster than it says itself."""
    fastest = limits.speed_m_s
    return (_SLOWEST_M_S if limits.hovers else _SLOWEST_SHARE * fastest), fastest


@final
class Commands:
    """The commands that the companion understands.

    frame: the mission's; limits: its own, before anybody changed them; presence: what can be asked
    for.
    """

    def __init__(self, *, frame: LocalFrame, limits: Limits, presence: Presence) -> None:
        self._frame = frame
        self._limits = limits
        self._presence = presence

    def answer_to(self, command: Command) -> Meaning | None:
        """To a question; None for what is none."""
        question = _QUESTIONS.get(command.number)
        return None if question is None else question(self, command)

    def is_order(self, command: Command) -> bool:
        """Whether it is one that only commanders may give."""
        return command.number in _ORDERS

    def meaning_of(self, command: Command) -> Meaning:
        """Of anything else."""
        order = _ORDERS.get(command.number)
        return Meaning(Result.UNSUPPORTED) if order is None else order(self, command)

    def _request_message(self, command: Command) -> Meaning:
        number = _whole(command.parameters[0])
        if number is None or not self._presence.ask(number):
            return Meaning(Result.DENIED)
        return Meaning(Result.ACCEPTED)

    def _capabilities(self, command: Command) -> Meaning:
        if command.parameters[0] != 1.0 or not self._presence.ask(AUTOPILOT_VERSION):
            return Meaning(Result.DENIED)
        return Meaning(Result.ACCEPTED)

    def _get_interval(self, command: Command) -> Meaning:
        number = _whole(command.parameters[0])
        interval_us = 0 if number is None else self._presence.interval_us(number)
        if number is None or interval_us == 0:
            return Meaning(Result.DENIED)
        reply = wire.MAVLink_message_interval_message(number, interval_us)
        return Meaning(Result.ACCEPTED, replies=(reply,))

    def _set_interval(self, command: Command) -> Meaning:
        number, interval_us = _whole(command.parameters[0]), command.parameters[1]
        if number is None or not math.isfinite(interval_us):
            return Meaning(Result.DENIED)
        accepted = self._presence.set_interval(number, interval_us)
        return Meaning(Result.ACCEPTED if accepted else Result.DENIED)

    def _start(self, command: Command) -> Meaning:
        first = command.parameters[0]
        if not (math.isnan(first) or first == 0.0):
            return Meaning(Result.DENIED, "start: only from the first item, param1 = 0")
        return Meaning(Result.ACCEPTED, order=OrderKind.START)

    def _pause_or_continue(self, command: Command) -> Meaning:
        kinds = {0.0: OrderKind.PAUSE, 1.0: OrderKind.CONTINUE}
        kind = kinds.get(command.parameters[0])
        if kind is None:
            return Meaning(Result.DENIED, "pause: param1 must be 0 (pause) or 1 (continue)")
        return Meaning(Result.ACCEPTED, order=kind)

    def _return(self, _command: Command) -> Meaning:
        return Meaning(Result.ACCEPTED, order=OrderKind.RETURN)

    def _change_speed(self, command: Command) -> Meaning:
        of_what, speed = command.parameters[0], meant(command.parameters[1])
        if of_what not in (wire.SPEED_TYPE_AIRSPEED, wire.SPEED_TYPE_GROUNDSPEED):
            return Meaning(Result.DENIED, "speed: its type, param1, must be 0 or 1")
        if speed == -1.0:  # no change
            return Meaning(Result.ACCEPTED)
        speed = self._limits.speed_m_s if speed == -2.0 else speed  # the default
        if refusal := self._too_fast_or_slow(speed):
            return Meaning(Result.DENIED, refusal)
        return Meaning(Result.ACCEPTED, order=OrderKind.SPEED, speed_m_s=speed)

    def _reposition(self, command: Command) -> Meaning:
        """A new target; its altitude is free within the band, so the one given is not read."""
        message = command.message
        if message.get_type() == "COMMAND_INT" and message.frame not in _FRAMES:
            text = f"reposition: frame {message.frame} is not one of 0, 3, 5, 6"
            return Meaning(Result.UNSUPPORTED_MAV_FRAME, text)
        target = self._target_ne_m(message)
        if target is None:
            return Meaning(Result.DENIED, "reposition: give a place on the mission's map")
        speed = meant(command.parameters[0])
        if math.isnan(speed) or speed <= 0.0:  # not given: as it is
            return Meaning(Result.ACCEPTED, order=OrderKind.REPOSITION, target_ne_m=target)
        if refusal := self._too_fast_or_slow(speed):
            return Meaning(Result.DENIED, refusal)
        return Meaning(
            Result.ACCEPTED, order=OrderKind.REPOSITION, target_ne_m=target, speed_m_s=speed
        )

    def _too_fast_or_slow(self, speed_m_s: float) -> str:
        low, high = speed_bounds_m_s(self._limits)
        if low <= speed_m_s <= high:
            return ""
        return f"speed {speed_m_s:g} m/s: must be {low:.3g} to {high:.3g}"

    def _target_ne_m(self, message: Message) -> tuple[float, float] | None:
        """Where a DO_REPOSITION points to; None if that is nowhere, or off the map."""
        if message.get_type() == "COMMAND_INT":
            latitude, longitude = deg(message.x), deg(message.y)
        else:
            latitude, longitude = message.param5, message.param6
        on_earth = (
            abs(latitude) <= 90.0 and abs(longitude) <= 180.0
        )  # not NaN, nor 2**31 - 1: not given
        if not on_earth or latitude == longitude == 0.0:
            return None
        north, east = self._frame.to_local_m(latitude, longitude)
        south_m, north_m = self._limits.north_m
        west_m, east_m = self._limits.east_m
        on_map = south_m <= north <= north_m and west_m <= east <= east_m
        return (north, east) if on_map else None


_Handler = Callable[[Commands, Command], Meaning]

_QUESTIONS: dict[int, _Handler] = {
    wire.MAV_CMD_REQUEST_MESSAGE: Commands._request_message,
    wire.MAV_CMD_GET_MESSAGE_INTERVAL: Commands._get_interval,
    wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: Commands._capabilities,
}
"""What everybody may ask, even everybody at once."""

_ORDERS: dict[int, _Handler] = {
    wire.MAV_CMD_SET_MESSAGE_INTERVAL: Commands._set_interval,
    wire.MAV_CMD_MISSION_START: Commands._start,
    wire.MAV_CMD_DO_PAUSE_CONTINUE: Commands._pause_or_continue,
    wire.MAV_CMD_DO_REPOSITION: Commands._reposition,
    wire.MAV_CMD_DO_CHANGE_SPEED: Commands._change_speed,
    wire.MAV_CMD_NAV_RETURN_TO_LAUNCH: Commands._return,
}
"""What only commanders may."""


def command_of(message: Message) -> Command | None:
    """A COMMAND_LONG or COMMAND_INT; None for any other message."""
    match message.get_type():
        case "COMMAND_LONG":
            confirmation = message.confirmation
        case "COMMAND_INT":
            confirmation = None
        case _:
            return None
    parameters = (message.param1, message.param2, message.param3, message.param4)
    return Command(message=message, parameters=parameters, confirmation=confirmation)


def meant(value: float) -> float:
    """The number that a float of the wire was made of: 12.3 and not 12.300000190734863."""
    if not 0.0 < abs(value) < _LARGEST_FLOAT:  # NaN too
        return value
    rounded = (float(f"{value:.{digits}g}") for digits in range(6, 9))
    exact = struct.pack("<f", value)
    return next((short for short in rounded if struct.pack("<f", short) == exact), value)


def _whole(value: float) -> int | None:
    """The number of a message; None if it is none."""
    return int(value) if math.isfinite(value) and value == int(value) else None
