"""The parameter protocol: list, read and set, in ArduPilot's and in PX4's way.

Sources: ardupilot.md 1, px4.md 2, the recorded flights, GCS_Param.cpp and mavlink_parameters.cpp.
"""

import math
import struct
from dataclasses import dataclass
from typing import Any, final

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import Reply, Sender, SendMessage
from vehicle_sim.parameters import Kind
from vehicle_sim.wire.frames import Prepared, make

VALUES_PER_S = 1348 / 1.5
"""ArduPilot's 1,348 values take 1.5 s on loopback (ardupilot.md 1); PX4's are sent as fast."""
_UNASKED = 65535
"""param_index of a value that ArduPilot sends after a PARAM_SET or a read by name."""


@final
@dataclass(slots=True)
class _Listing:
    """A list on its way to one client."""

    to: Sender
    begun_us: int
    sent: int = 0


@final
class ParameterProtocol:
    """Serves one autopilot's parameters to all links; one listing at a time on each link.

    What is said of an unknown parameter is not answered.
    """

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot, self._parameters = autopilot, autopilot.parameters
        self._is_px4 = autopilot.profile.firmware == "px4"
        self._listings: dict[int, _Listing] = {}
        self._names = [row.name for row in self._parameters.rows]

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._listings)

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET for the autopilot."""
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                self._listings[sender.link] = _Listing(sender, now_us)
                return []
            case "PARAM_REQUEST_READ" if message.param_index >= 0:
                index = message.param_index
                found = [] if index >= len(self._names) else [self._value(index, index)]
            case "PARAM_REQUEST_READ":
                found = [self._named(message.param_id)] if self._knows(message) else []
            case _:
                return self._on_set(message) if self._knows(message) else []
        return [SendMessage(message=value, to=sender) for value in found]

    def step(self, now_us: int) -> list[Reply]:
        """The next values of each listing that is due; cheap if there is none."""
        answers = list[Reply]()
        for link, listing in list(self._listings.items()):
            due = int((now_us - listing.begun_us) * 1e-6 * VALUES_PER_S)
            last = min(due, len(self._names))
            values = (self._value(index, index) for index in range(listing.sent, last))
            answers += [SendMessage(message=value, to=listing.to) for value in values]
            listing.sent = max(listing.sent, last)
            if listing.sent >= len(self._names):
                del self._listings[link]
        return answers

    def _knows(self, message: Any) -> bool:
        return message.param_id in self._parameters

    def _named(self, name: str) -> Prepared:
        """The PARAM_VALUE that answers a PARAM_SET or a read by name."""
        place = self._names.index(name)
        return self._value(place, place if self._is_px4 else _UNASKED)

    def _value(self, place: int, index: int) -> Prepared:
        """PARAM_VALUE: of whole numbers PX4 sends the bits, ArduPilot converts them."""
        name = self._names[place]
        kind, value = self._parameters.row(name).kind, self._parameters[name]
        if self._is_px4 and kind is not Kind.REAL32:
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        return make("PARAM_VALUE", name.encode("ascii"), value, kind, len(self._names), index)

    def _on_set(self, message: Any) -> list[Reply]:
        """To PX4 a value comes bit by bit in the type of the parameter, or it is not taken.

        What is not a number neither takes; PX4 tells the old value.
        """
        name, value = message.param_id, message.param_value
        kind = self._parameters.row(name).kind
        if self._is_px4:
            if message.param_type != kind:
                return []
            if kind is not Kind.REAL32:
                (value,) = struct.unpack("<i", struct.pack("<f", value))
        elif not math.isfinite(value):
            return []
        elif kind is not Kind.REAL32:  # AP_Param::set_float
            value = math.trunc(value + math.copysign(0.01, value))
        self._parameters[name] = value  # the nearest of its type; NaN changes nothing
        told = SendMessage(message=self._named(name))
        return [told, *self._autopilot.on_parameter(name)] if math.isfinite(value) else [told]
