"""The parameter protocol: list, read and set, in ArduPilot's and in PX4's way.

Sources: ardupilot.md 1, px4.md 2, the recorded flights, GCS_Param.cpp and mavlink_parameters.cpp.
"""

import struct
from typing import Any, Final, final

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import Reply, Sender, SendMessage
from vehicle_sim.parameters import Kind
from vehicle_sim.wire.frames import Prepared, make

VALUES_PER_S = 1348 / 1.5
"""ArduPilot's 1,348 values take 1.5 s on loopback (ardupilot.md 1); PX4's are sent as fast."""


@final
class ParameterProtocol:
    """Serves one autopilot's parameters to all links; one listing at a time on each link.

    What is said of an unknown parameter is not answered.
    """

    MESSAGES: Final = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")

    def __init__(self, autopilot: Autopilot) -> None:
        self._parameters, self._is_px4 = autopilot.parameters, autopilot.is_px4
        self._names = list(self._parameters)
        self.listings: dict[int, tuple[Sender, int, int]] = {}
        """By link: to whom, since when, and how many have been sent.  Each needs steps."""

    def on_message(self, message: Any, sender: Sender, now_us: int) -> list[Reply]:
        """Answer one of MESSAGES."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            self.listings[sender.link] = sender, now_us, 0
        elif kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            if message.param_index < len(self._names):
                return [SendMessage(self._value(message.param_index), sender)]
        elif message.param_id in self._parameters:
            place = self._names.index(message.param_id)
            if kind == "PARAM_REQUEST_READ":
                return [SendMessage(self._value(place), sender)]
            if self._set(message.param_id, message.param_value, message.param_type):
                return [SendMessage(self._value(place))]
        return []

    def step(self, now_us: int) -> list[Reply]:
        """The next values of each listing that is due."""
        answers = list[Reply]()
        for link, (to, begun_us, sent) in list(self.listings.items()):
            due = min(int((now_us - begun_us) * 1e-6 * VALUES_PER_S), len(self._names))
            answers += [SendMessage(self._value(place), to) for place in range(sent, due)]
            self.listings[link] = to, begun_us, due
            if due == len(self._names):
                del self.listings[link]
        return answers

    def _value(self, place: int) -> Prepared:
        """PARAM_VALUE: of whole numbers PX4 sends the bits, ArduPilot converts them."""
        name = self._names[place]
        kind, value = self._parameters.rows[name].kind, self._parameters[name]
        if self._is_px4 and kind is not Kind.REAL32:
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        return make("PARAM_VALUE", name.encode("ascii"), value, kind, len(self._names), place)

    def _set(self, name: str, value: float, told_kind: int) -> bool:
        """To PX4 a value comes bit by bit in the type of the parameter, or it is not taken."""
        kind = self._parameters.rows[name].kind
        if self._is_px4 and told_kind != kind:
            return False
        if self._is_px4 and kind is not Kind.REAL32:
            (value,) = struct.unpack("<i", struct.pack("<f", value))
        self._parameters[name] = value  # the nearest of its type; NaN changes nothing
        return True
