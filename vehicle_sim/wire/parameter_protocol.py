"""The parameter protocol: list, read and set, in ArduPilot's and in PX4's way.

Sources: ardupilot.md 1, px4.md 2, the recorded flights, GCS_Param.cpp and mavlink_parameters.cpp;
but a list comes at once, as it is short.
"""

import struct
from typing import Any, Final, final

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.values import Reply, Sender, SendMessage
from vehicle_sim.parameters import Kind
from vehicle_sim.wire.frames import Prepared, make


@final
class ParameterProtocol:
    """Serves one autopilot's parameters to all links.

    What is said of an unknown parameter is not answered.
    """

    MESSAGES: Final = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")

    def __init__(self, autopilot: Autopilot) -> None:
        self._parameters, self._is_px4 = autopilot.parameters, autopilot.is_px4
        self._names = list(self._parameters)

    def on_message(self, message: Any, sender: Sender, _: int) -> list[Reply]:
        """Answer one of MESSAGES."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [SendMessage(self._value(k), sender) for k in range(len(self._names))]
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            if message.param_index < len(self._names):
                return [SendMessage(self._value(message.param_index), sender)]
        elif message.param_id in self._parameters:
            place = self._names.index(message.param_id)
            if kind == "PARAM_REQUEST_READ":
                return [SendMessage(self._value(place), sender)]
            if self._set(message.param_id, message.param_value, message.param_type):
                return [SendMessage(self._value(place))]
        return []

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
