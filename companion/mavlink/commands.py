"""What a COMMAND_LONG or COMMAND_INT to the companion means: a question, an order or a refusal.

No order takes long, so COMMAND_CANCEL is not supported.  Parameters that an order does not use are
ignored; those that it uses must be finite and in range, else it is denied with a text.  Protocol:
mavlink.md 2.5.
"""

import enum
import math
from dataclasses import dataclass
from typing import Final, final

from companion.geodesy import LocalFrame, deg
from companion.mavlink.dialect import Message, wire
from companion.mission.events import OrderKind
from companion.path.limits import Limits

MESSAGES: Final = (wire.MAVLINK_MSG_ID_COMMAND_LONG, wire.MAVLINK_MSG_ID_COMMAND_INT)
HEARTBEAT: Final = wire.MAVLINK_MSG_ID_HEARTBEAT
VERSION: Final = wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_NOT_GIVEN_E7 = 2**31 - 1
_AMSL_OR_HOME = (
    wire.MAV_FRAME_GLOBAL,
    wire.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    wire.MAV_FRAME_GLOBAL_INT,
    wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
"""Frames of a place whose height the companion may ignore."""
ORDERS: Final = frozenset(
    {
        wire.MAV_CMD_MISSION_START,
        wire.MAV_CMD_DO_PAUSE_CONTINUE,
        wire.MAV_CMD_DO_REPOSITION,
        wire.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        wire.MAV_CMD_NAV_LAND,
    }
)
"""Accepted from commanders only; questions are answered to anybody."""


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
    """What a command asks for, or why it is refused."""

    result: Result = Result.ACCEPTED
    text: str = ""
    """Why not, for the operator."""
    asks_for: int | None = None
    """The number of the message of ours that is wanted."""
    order: OrderKind | None = None
    target_ne_m: tuple[float, float] | None = None


def meaning_of(message: Message, frame: LocalFrame, limits: Limits) -> Meaning:
    """The meaning of a command; frame, limits: those of the mission, for a place."""
    first = message.param1
    match message.command:
        case wire.MAV_CMD_REQUEST_MESSAGE if first in (HEARTBEAT, VERSION):
            return Meaning(asks_for=int(first))
        case wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES if first == 1.0:
            return Meaning(asks_for=VERSION)
        case wire.MAV_CMD_REQUEST_MESSAGE | wire.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return _denied("")
        case wire.MAV_CMD_MISSION_START:
            if math.isnan(first) or first == 0.0:
                return Meaning(order=OrderKind.START)
            return _denied("start: only from the first item, param1 = 0")
        case wire.MAV_CMD_DO_PAUSE_CONTINUE:
            if first in (0.0, 1.0):
                return Meaning(order=OrderKind.CONTINUE if first else OrderKind.PAUSE)
            return _denied("pause: param1 must be 0 (pause) or 1 (continue)")
        case wire.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return Meaning(order=OrderKind.RETURN)
        case wire.MAV_CMD_NAV_LAND:
            if any(value not in (0.0, _NOT_GIVEN_E7) and value == value for value in _xy(message)):
                return _denied("land: it lands where it is; first DO_REPOSITION there")
            return Meaning(order=OrderKind.LAND)
        case wire.MAV_CMD_DO_REPOSITION:
            return _reposition(message, frame, limits)
        case _:
            return Meaning(Result.UNSUPPORTED)


def _denied(text: str) -> Meaning:
    return Meaning(Result.DENIED, text)


def _reposition(message: Message, frame: LocalFrame, limits: Limits) -> Meaning:
    """A new target; altitude and speed are the mission's, so those given are ignored."""
    latitude, longitude = _xy(message)
    if _is_int(message):
        if message.frame not in _AMSL_OR_HOME:
            text = f"reposition: frame {message.frame} is not one of 0, 3, 5, 6"
            return Meaning(Result.UNSUPPORTED_MAV_FRAME, text)
        latitude, longitude = deg(message.x), deg(message.y)
    on_earth = abs(latitude) <= 90.0 and abs(longitude) <= 180.0  # not NaN, nor what is not given
    if on_earth and not latitude == longitude == 0.0:
        north_m, east_m = frame.to_local_m(latitude, longitude)
        (south, north), (west, east) = limits.north_m, limits.east_m
        if south <= north_m <= north and west <= east_m <= east:
            return Meaning(order=OrderKind.REPOSITION, target_ne_m=(north_m, east_m))
    return _denied("reposition: give a place on the mission's map")


def _is_int(message: Message) -> bool:
    return bool(message.get_msgId() == wire.MAVLINK_MSG_ID_COMMAND_INT)


def _xy(message: Message) -> tuple[float, float]:
    """Latitude and longitude of a command, in its own units: degrees, or 1e-7 of them."""
    return (message.x, message.y) if _is_int(message) else (message.param5, message.param6)
