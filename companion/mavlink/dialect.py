"""pymavlink's generated dialect and the component ids: the only import of pymavlink."""

import struct
from typing import Any, Final

from pymavlink.dialects.v20 import all as wire

COMPANION_COMPONENT = wire.MAV_COMP_ID_PATHPLANNER  # 195
AUTOPILOT_COMPONENT = wire.MAV_COMP_ID_AUTOPILOT1

Message = wire.MAVLink_message
AMSL_FRAMES: Final = (wire.MAV_FRAME_GLOBAL, wire.MAV_FRAME_GLOBAL_INT)
HOME_FRAMES: Final = (
    wire.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
TERRAIN_FRAMES: Final = (
    wire.MAV_FRAME_GLOBAL_TERRAIN_ALT,
    wire.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
)
"""Frames of a latitude and a longitude, by what their altitude is above."""


def codec(system_id: int) -> wire.MAVLink:
    """A pymavlink codec with the companion's ids that tolerates invalid bytes."""
    link = wire.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
    link.robust_parsing = True
    return link


class EventMessage(wire.MAVLink_message):  # type: ignore[misc]
    """EVENT of common.xml, which pymavlink's dialects leave out: what PX4 says to everybody."""

    id = 410
    msgname = "EVENT"
    ordered_fieldnames = (
        *("id_of_event", "event_time_boot_ms", "sequence"),
        *("destination_component", "destination_system", "log_levels", "arguments"),
    )
    fieldnames = (*ordered_fieldnames[3:5], *ordered_fieldnames[:3], *ordered_fieldnames[5:])
    native_format = bytearray(b"<IIHBBBB")
    orders = (3, 4, 0, 1, 2, 5, 6)
    lengths = (1, 1, 1, 1, 1, 1, 40)
    crc_extra = 160
    unpacker = struct.Struct("<IIHBBB40B")

    def __init__(self, *values: Any) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        for name, value in zip(self.fieldnames, values, strict=True):
            setattr(self, name, value)


KINDS: Final[dict[int, Any]] = {**wire.mavlink_map, EventMessage.id: EventMessage}
"""The class of each kind of message that is understood, by its number."""


def enum_word(enum: str, number: int | None) -> str:
    """What the message definitions call an entry of an enum, without the enum's name; or empty."""
    entry = wire.enums[enum].get(number)
    return "" if entry is None else str(entry.name).removeprefix(f"{enum}_")


__all__ = ["wire"]  # of what is imported here, what others import from here
