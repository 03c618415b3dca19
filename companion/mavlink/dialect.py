"""pymavlink's generated dialect and the component ids: the only import of pymavlink."""

import struct
from typing import Any, Final

from pymavlink.dialects.v20 import all as wire

COMPANION_COMPONENT = wire.MAV_COMP_ID_PATHPLANNER  # 195
AUTOPILOT_COMPONENT = wire.MAV_COMP_ID_AUTOPILOT1

Message = wire.MAVLink_message


def codec(system_id: int) -> wire.MAVLink:
    """A pymavlink codec with the companion's ids that tolerates invalid bytes."""
    link = wire.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
    link.robust_parsing = True
    return link


class EventMessage(wire.MAVLink_message):  # type: ignore[misc]
    """EVENT of common.xml, which pymavlink's dialects leave out: what PX4 says to everybody."""

    id = 410
    msgname = name = "EVENT"
    fieldnames = (
        "destination_component",
        "destination_system",
        "id_of_event",
        "event_time_boot_ms",
        "sequence",
        "log_levels",
        "arguments",
    )
    ordered_fieldnames = (*fieldnames[2:5], *fieldnames[:2], *fieldnames[5:])
    fieldtypes = ("uint8_t", "uint8_t", "uint32_t", "uint32_t", "uint16_t", "uint8_t", "uint8_t")
    fielddisplays_by_name: dict[str, str] = {}  # noqa: RUF012 - as pymavlink's own
    fieldenums_by_name: dict[str, str] = {}  # noqa: RUF012
    fieldunits_by_name: dict[str, str] = {}  # noqa: RUF012
    native_format = bytearray(b"<IIHBBBB")
    orders = (3, 4, 0, 1, 2, 5, 6)
    lengths = (1, 1, 1, 1, 1, 1, 40)
    array_lengths = (0, 0, 0, 0, 0, 0, 40)
    crc_extra = 160
    unpacker = struct.Struct("<IIHBBB40B")
    instance_field = None
    instance_offset = -1

    def __init__(
        self,
        destination_component: int,
        destination_system: int,
        id_of_event: int,
        event_time_boot_ms: int,
        sequence: int,
        log_levels: int,
        arguments: list[int],
    ) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field, self._instance_offset = self.instance_field, self.instance_offset
        self.destination_component, self.destination_system = (
            destination_component,
            destination_system,
        )
        self.id_of_event, self.event_time_boot_ms = id_of_event, event_time_boot_ms
        self.sequence, self.log_levels, self.arguments = sequence, log_levels, arguments

    def pack(self, mav: wire.MAVLink, force_mavlink1: bool = False) -> bytes:
        """A frame of a sender."""
        payload = self.unpacker.pack(
            self.id_of_event,
            self.event_time_boot_ms,
            self.sequence,
            self.destination_component,
            self.destination_system,
            self.log_levels,
            *self.arguments,
        )
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


KINDS: Final[dict[int, Any]] = {**wire.mavlink_map, EventMessage.id: EventMessage}
"""The class of each kind of message that is understood, by its number."""

__all__ = [
    "AUTOPILOT_COMPONENT",
    "COMPANION_COMPONENT",
    "KINDS",
    "EventMessage",
    "Message",
    "codec",
    "wire",
]
