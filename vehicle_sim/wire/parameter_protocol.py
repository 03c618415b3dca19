"""The parameter protocol: list, read and set, in ArduPilot's and in PX4's way.

Sources: ardupilot.md 1, px4.md 2, the recorded flights, GCS_Param.cpp and mavlink_parameters.cpp.
"""

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any, final

from vehicle_sim.autopilots import Autopilot, Reply, Sender, SendMessage
from vehicle_sim.parameters import Kind, Parameter
from vehicle_sim.wire.frames import Prepared, make

VALUES_PER_S = 1348 / 1.5
"""ArduPilot's 1,348 values take 1.5 s on loopback (ardupilot.md 1); PX4's are sent as fast."""
_MAX_AT_ONCE = 20
"""Values in one step, however late it is: no burst that a socket cannot take."""
_UNASKED = 65535
"""param_index of a value that ArduPilot sends after a PARAM_SET or a read by name."""
_HASH = "_HASH_CHECK"
_UINT32 = 5
"""MAV_PARAM_TYPE of the hash."""


@final
@dataclass(slots=True)
class _Listing:
    """A list on its way to one client."""

    to: Sender
    begun_us: int
    sent: int = 0
    hash_first: bool = False


@final
class ParameterProtocol:
    """Serves one autopilot's parameters to all links; one listing at a time on each link."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot, self._parameters = autopilot, autopilot.parameters
        self._is_px4 = autopilot.profile.firmware == "px4"
        self._listings: dict[int, _Listing] = {}
        self._rows = self._parameters.rows
        self._indices = {row.name: index for index, row in enumerate(self._rows)}

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._listings)

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET for the autopilot."""
        if message.get_type() != "PARAM_REQUEST_LIST":
            handle = self._on_set if message.get_type() == "PARAM_SET" else self._on_read
            return handle(message, sender)
        # PX4 leaves the hash out when a listing is begun again
        hash_first = self._is_px4 and sender.link not in self._listings
        self._listings[sender.link] = _Listing(sender, now_us, hash_first=hash_first)
        return []

    def step(self, now_us: int) -> list[Reply]:
        """The next values of each listing that is due; cheap if there is none."""
        answers = list[Reply]()
        for link, listing in list(self._listings.items()):
            due = int((now_us - listing.begun_us) * 1e-6 * VALUES_PER_S)
            last = min(due, listing.sent + _MAX_AT_ONCE, len(self._rows))
            if listing.hash_first and last > listing.sent:
                listing.hash_first = False
                answers.append(SendMessage(message=self._hash_value(), to=listing.to))
            for index in range(listing.sent, last):
                value = self.value(self._rows[index].name, index)
                answers.append(SendMessage(message=value, to=listing.to))
            listing.sent = max(listing.sent, last)
            if listing.sent >= len(self._rows):
                del self._listings[link]
        return answers

    # --- out ----------------------------------------------------------------------------------

    def value(self, name: str, index: int | None = None) -> Prepared:
        """The PARAM_VALUE of this parameter.

        Without an index it answers a PARAM_SET or a read by name.  KeyError for a name that is not
        in the table.
        """
        if index is None:
            index = self._indices[name] if self._is_px4 else _UNASKED
        row, value = self._parameters.row(name), self._parameters[name]
        if self._is_px4 and row.kind is not Kind.REAL32:  # bit by bit; ArduPilot converts
            (value,) = struct.unpack("<f", self._raw(row))
        return self._message(name, value, row.kind, index)

    def _message(self, name: str, value: float, kind: int, index: int) -> Prepared:
        return make(
            "PARAM_VALUE",
            param_id=name.encode("ascii"),
            param_value=value,
            param_type=kind,
            param_count=len(self._rows),
            param_index=index,
        )

    def _raw(self, row: Parameter) -> bytes:
        """The four bytes of a value."""
        value = self._parameters[row.name]
        is_real = row.kind is Kind.REAL32
        return struct.pack("<f", value) if is_real else struct.pack("<i", int(value))

    def _hash_value(self) -> Prepared:
        """PX4's hash of names and values, by which ground stations know their cached copy.

        A plain CRC-32 begun at zero.
        """
        named = b"".join(row.name.encode("ascii") + self._raw(row) for row in self._rows)
        raw = struct.pack("<I", zlib.crc32(named, 0xFFFFFFFF) ^ 0xFFFFFFFF)
        (as_float,) = struct.unpack("<f", raw)
        return self._message(_HASH, as_float, _UINT32, _UNASKED)

    # --- reading and setting ------------------------------------------------------------------

    def _on_read(self, message: Any, sender: Sender) -> list[Reply]:
        """A request for an unknown parameter is not answered."""
        index, name = message.param_index, message.param_id
        if index >= 0:
            found = self._rows[index : index + 1]
            return [SendMessage(message=self.value(row.name, index), to=sender) for row in found]
        if self._is_px4 and name == _HASH:
            return [SendMessage(message=self._hash_value(), to=sender)]
        known = name in self._parameters
        return [SendMessage(message=self.value(name), to=sender)] if known else []

    def _on_set(self, message: Any, sender: Sender) -> list[Reply]:
        """To PX4 a value comes bit by bit in the type of the parameter, or it is not taken."""
        name, value = message.param_id, message.param_value
        if self._is_px4 and name == _HASH:
            self._listings.pop(sender.link, None)  # the client has a copy: stop
            return []
        if name not in self._parameters:
            return []
        kind = self._parameters.row(name).kind
        if self._is_px4:
            if message.param_type != kind:
                return []
            if kind is not Kind.REAL32:
                (value,) = struct.unpack("<i", _float_bytes(message))
            elif not math.isfinite(value):  # compared with the old one it is never different
                return [SendMessage(message=self.value(name), to=sender)]
        elif not math.isfinite(value):
            return []
        elif kind is not Kind.REAL32:
            # cut off after adding 0.01 (AP_Param::set_float), and within the type's range
            least, most = kind.range
            value = math.trunc(min(max(value + math.copysign(0.01, value), least), most))
        self._parameters[name] = value
        return [SendMessage(message=self.value(name)), *self._autopilot.on_parameter(name)]


def _float_bytes(message: Any) -> bytes:
    """The four bytes of param_value as they came: as a float some of them would be changed."""
    frame = bytes(message.get_msgbuf())
    head = 10 if frame[0] == 0xFD else 6
    return frame[head : head + min(4, frame[1])].ljust(4, b"\0")
