"""The parameter protocol: list, read and set, in ArduPilot's and in PX4's way.

Sources: ardupilot.md 1, px4.md 2, the recorded flights, GCS_Param.cpp and mavlink_parameters.cpp.
"""

import math
import struct
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
class ParameterProtocol:
    """Serves one autopilot's parameters to all links; one listing at a time on each link.

    What is said of an unknown parameter is not answered.
    """

    def __init__(self, autopilot: Autopilot) -> None:
        self._parameters = autopilot.parameters
        self._is_px4 = autopilot.firmware.family == "px4"
        self._names = list(self._parameters)
        self._listings: dict[int, tuple[Sender, int, int]] = {}
        """By link: to whom, since when, and how many have been sent."""

    @property
    def busy(self) -> bool:
        """Whether step() has anything to do."""
        return bool(self._listings)

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET for the autopilot."""
        name = message.get_type()
        if name == "PARAM_REQUEST_LIST":
            self._listings[sender.link] = sender, now_us, 0
        elif name == "PARAM_REQUEST_READ" and message.param_index >= 0:
            if message.param_index < len(self._names):
                return [SendMessage(message=self._value(message.param_index), to=sender)]
        elif message.param_id in self._parameters:
            if name == "PARAM_SET":
                return self._on_set(message.param_id, message.param_value, message.param_type)
            return [SendMessage(message=self._named(message.param_id), to=sender)]
        return []

    def step(self, now_us: int) -> list[Reply]:
        """The next values of each listing that is due."""
        answers = list[Reply]()
        for link, (to, begun_us, sent) in list(self._listings.items()):
            due = min(int((now_us - begun_us) * 1e-6 * VALUES_PER_S), len(self._names))
            answers += [SendMessage(message=self._value(k), to=to) for k in range(sent, due)]
            self._listings[link] = to, begun_us, due
            if due == len(self._names):
                del self._listings[link]
        return answers

    def _named(self, name: str) -> Prepared:
        """The PARAM_VALUE that answers a PARAM_SET or a read by name."""
        return self._value(self._names.index(name), None if self._is_px4 else _UNASKED)

    def _value(self, place: int, index: int | None = None) -> Prepared:
        """PARAM_VALUE: of whole numbers PX4 sends the bits, ArduPilot converts them."""
        name = self._names[place]
        kind, value = self._parameters.rows[name].kind, self._parameters[name]
        if self._is_px4 and kind is not Kind.REAL32:
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        shown = place if index is None else index
        return make("PARAM_VALUE", name.encode("ascii"), value, kind, len(self._names), shown)

    def _on_set(self, name: str, value: float, told_kind: int) -> list[Reply]:
        """To PX4 a value comes bit by bit in the type of the parameter, or it is not taken.

        What is not a number neither takes; PX4 tells the old value.
        """
        kind = self._parameters.rows[name].kind
        if told_kind != kind if self._is_px4 else not math.isfinite(value):
            return []
        if kind is not Kind.REAL32 and self._is_px4:
            (value,) = struct.unpack("<i", struct.pack("<f", value))
        elif kind is not Kind.REAL32:  # AP_Param::set_float
            value = math.trunc(value + math.copysign(0.01, value))
        self._parameters[name] = value  # the nearest of its type; NaN changes nothing
        return [SendMessage(message=self._named(name))]
