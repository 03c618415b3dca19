"""Log time and vehicle time: one piecewise line between them, from the vehicle's own stamps."""

from collections.abc import Iterable
from typing import final

import numpy as np
from numpy.typing import NDArray

_BIN_S = 1.0


@final
class Clock:
    """Seconds since the first record of a log <-> seconds since the autopilot's boot.

    A stamp is never older than its record, but it may have waited on the way.  So in each second
    of the log the stamp that waited least counts.  Before the first and after the last stamp the
    vehicle's clock is taken to run at the log's rate.
    """

    def __init__(self, stamps: Iterable[tuple[float, float]]) -> None:
        """Pairs of log time and the vehicle time that the record carries, in seconds."""
        best = dict[int, tuple[float, float]]()
        for log_s, vehicle_s in stamps:
            number = int(log_s // _BIN_S)
            known = best.get(number)
            if known is None or vehicle_s - log_s > known[1] - known[0]:
                best[number] = (log_s, vehicle_s)
        knots = sorted(best.values()) or [(0.0, 0.0)]
        self._log_s = np.array([k[0] for k in knots])
        self._vehicle_s = np.maximum.accumulate(np.array([k[1] for k in knots]))

    def vehicle_s(self, log_s: float) -> float:
        """Vehicle time at this log time."""
        return _along(log_s, self._log_s, self._vehicle_s)

    def log_s(self, vehicle_s: float) -> float:
        """Log time at this vehicle time."""
        return _along(vehicle_s, self._vehicle_s, self._log_s)


def _along(x: float, knots: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    if x <= knots[0]:
        return float(values[0] + (x - knots[0]))
    if x >= knots[-1]:
        return float(values[-1] + (x - knots[-1]))
    return float(np.interp(x, knots, values))
