"""Messages that PX4 sends and the dialect `all` of pymavlink lacks: they pack themselves.

Layouts and CRC_EXTRA are those of PX4's `development` dialect, checked against recorded frames.
"""

import struct
from typing import Any, ClassVar, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Event


class _Lacking(mavlink.MAVLink_message):  # type: ignore[misc]  # pymavlink has no types
    """A message with its payload ready; trailing zeros are cut when it is packed."""

    number: ClassVar[int]
    label: ClassVar[str]
    extra: ClassVar[int]

    def __init__(self, payload: bytes) -> None:
        super().__init__(self.number, self.label)
        self._fieldnames = ["payload"]
        self.payload = payload

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame."""
        frame: bytes = self._pack(mav, self.extra, self.payload, force_mavlink1=force_mavlink1)
        return frame


@final
class LinkNodeStatus(_Lacking):
    """LINK_NODE_STATUS: how the link is used."""

    number, label, extra = 8, "LINK_NODE_STATUS", 117
    _layout = struct.Struct("<QIIIIIHHHBB")

    def __init__(self, time_us: int) -> None:
        super().__init__(self._layout.pack(time_us, *(0,) * 10))


@final
class ProtocolVersion(_Lacking):
    """PROTOCOL_VERSION: MAVLink 2."""

    number, label, extra = 300, "PROTOCOL_VERSION", 217
    _layout = struct.Struct("<HHH16x")

    def __init__(self) -> None:
        super().__init__(self._layout.pack(200, 100, 200))


@final
class TimeEstimateToTarget(_Lacking):
    """TIME_ESTIMATE_TO_TARGET: seconds to come home safely; the others are not known (-1)."""

    number, label, extra = 380, "TIME_ESTIMATE_TO_TARGET", 232
    _layout = struct.Struct("<iiiii")

    def __init__(self, safe_return_s: int) -> None:
        super().__init__(self._layout.pack(safe_return_s, -1, -1, -1, -1))


@final
class EventMessage(_Lacking):
    """EVENT."""

    number, label, extra = 410, "EVENT", 160
    _layout = struct.Struct("<IIHBBB40s")

    def __init__(self, event: Event, sequence: int, boot_ms: int) -> None:
        super().__init__(
            self._layout.pack(
                event.number, boot_ms, sequence, 0, 0, event.log_levels, event.arguments
            )
        )


@final
class CurrentEventSequence(_Lacking):
    """CURRENT_EVENT_SEQUENCE: so that who has missed an event can ask for it."""

    number, label, extra = 411, "CURRENT_EVENT_SEQUENCE", 106
    _layout = struct.Struct("<HB")

    def __init__(self, sequence: int, flags: int) -> None:
        super().__init__(self._layout.pack(sequence, flags))


@final
class Events:
    """Numbers the events of one boot.  Mutable."""

    def __init__(self) -> None:
        self.sequence = 65525
        """Of the newest one: recorded flights begin here."""

    def message(self, event: Event, boot_ms: int) -> EventMessage:
        """The next event as a message."""
        self.sequence = (self.sequence + 1) % 65536
        return EventMessage(event, self.sequence, boot_ms)
