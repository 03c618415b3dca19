"""Messages that PX4 sends and the dialect `all` of pymavlink lacks: they pack themselves.

Layouts and CRC_EXTRA are those of PX4's `development` dialect, checked against recorded frames.
"""

import struct
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Event

_FORMS: Final = {
    8: ("LINK_NODE_STATUS", 117, struct.Struct("<QIIIIIHHHBB")),
    300: ("PROTOCOL_VERSION", 217, struct.Struct("<HHH16x")),
    380: ("TIME_ESTIMATE_TO_TARGET", 232, struct.Struct("<iiiii")),
    410: ("EVENT", 160, struct.Struct("<IIHBBB40s")),
    411: ("CURRENT_EVENT_SEQUENCE", 106, struct.Struct("<HB")),
}
"""By number: name, CRC_EXTRA and payload."""


@final
class Lacking(mavlink.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    """A message with its payload ready; trailing zeros are cut when it is packed."""

    def __init__(self, number: int, *values: Any) -> None:
        name, self._extra, layout = _FORMS[number]
        super().__init__(number, name)
        self._fieldnames = ["payload"]
        self.payload = layout.pack(*values)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame."""
        frame: bytes = self._pack(mav, self._extra, self.payload, force_mavlink1=force_mavlink1)
        return frame


def link_node_status(time_us: int) -> Lacking:
    """LINK_NODE_STATUS: how the link is used."""
    return Lacking(8, time_us, *(0,) * 10)


def protocol_version() -> Lacking:
    """PROTOCOL_VERSION: MAVLink 2."""
    return Lacking(300, 200, 100, 200)


def time_estimate_to_target(safe_return_s: int) -> Lacking:
    """TIME_ESTIMATE_TO_TARGET: seconds to come home safely; the others are not known (-1)."""
    return Lacking(380, safe_return_s, -1, -1, -1, -1)


def event_message(event: Event, sequence: int, boot_ms: int) -> Lacking:
    """EVENT."""
    return Lacking(410, event.number, boot_ms, sequence, 0, 0, event.log_levels, event.arguments)


def current_event_sequence(sequence: int, flags: int) -> Lacking:
    """CURRENT_EVENT_SEQUENCE: so that who has missed an event can ask for it."""
    return Lacking(411, sequence, flags)


@final
class Events:
    """Numbers the events of one boot.  Mutable."""

    def __init__(self) -> None:
        self.sequence = 65525
        """Of the newest one: recorded flights begin here."""

    def message(self, event: Event, boot_ms: int) -> Lacking:
        """The next event as a message."""
        self.sequence = (self.sequence + 1) % 65536
        return event_message(event, self.sequence, boot_ms)
