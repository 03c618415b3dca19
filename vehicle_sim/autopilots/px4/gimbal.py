"""The gimbal commands that PX4 broadcasts by itself when it lands: not for anybody who is here."""

import math
from typing import Any, Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import Say

_FIRST_US: Final = 250_000
_AGAIN_US: Final = (1_000_000, 510_000, 510_000)
"""After the one before: nobody has answered (px4-gps-loss.tlog, 174.84 s and on)."""
_NAN: Final = math.nan


def _command(number: int, confirmation: int, *parameters: float) -> Any:
    p1, p2, p3, p4, p5, p6, p7 = (*parameters, *(0.0,) * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(
        target_system=1,
        target_component=0,
        command=number,
        confirmation=confirmation,
        param1=p1,
        param2=p2,
        param3=p3,
        param4=p4,
        param5=p5,
        param6=p6,
        param7=p7,
    )


@final
class Gimbal:
    """Acquires control, turns the gimbal straight, releases it; repeats while nobody answers."""

    def __init__(self) -> None:
        self._due_us: int | None = None
        self._sent = 0

    def straighten(self, now_us: int) -> None:
        """A landing begins."""
        self._due_us = now_us + _FIRST_US
        self._sent = 0

    def due(self, now_us: int) -> bool:
        """Whether there is something to take."""
        return self._due_us is not None and now_us >= self._due_us

    def take(self, now_us: int) -> list[Say]:
        """What is due now."""
        acquire = _command(1001, self._sent, 1.0, 1.0, -1.0, -1.0)
        said = [Say(message=acquire)]
        if self._sent == 0:
            said.append(Say(message=_command(1000, 0, _NAN, _NAN, _NAN, _NAN, 2.0)))
            said.append(Say(message=_command(1001, 0, -3.0, -3.0, -1.0, -1.0)))
        self._due_us = now_us + _AGAIN_US[self._sent] if self._sent < len(_AGAIN_US) else None
        self._sent += 1
        return said
