"""ArduPlane's hold of height, and its airspeeds: what TECS looks like from outside.

Constants are fitted to the recorded flight arduplane-guided-reposition.tlog: two steps of 10 m are
followed to 0.2 m rms, the climb while points are streamed to 1.3 m.
"""

import bisect
from typing import final

DEMAND_S = 3.5
"""Time constant of the demanded height."""
ERROR_S = 5.0
DEMANDED_M_S = (10.0, 20.0, 22.0, 25.0, 30.0)
HELD_M_S = (10.17, 20.34, 22.70, 26.83, 33.0)
"""What is flown at these demands, at sea level: 18 m/s demanded is flown at 18.9, 20 at 21, 22 at
23.5 and 25 at 27.7 m/s, all at 600 m above the sea (ardupilot.md 7), and thin air adds 3 %."""


def _interpolated(x: float, xs: tuple[float, ...], ys: tuple[float, ...]) -> float:
    """Linear between the points, and beyond them in the ratio of the last one."""
    if x <= xs[0]:
        return x * ys[0] / xs[0]
    if x >= xs[-1]:
        return x * ys[-1] / xs[-1]
    k = bisect.bisect_right(xs, x)
    share = (x - xs[k - 1]) / (xs[k] - xs[k - 1])
    return ys[k - 1] + share * (ys[k] - ys[k - 1])


def eas_to_tas(altitude_amsl_m: float) -> float:
    """True over equivalent airspeed in the standard atmosphere, troposphere."""
    if not -1000.0 <= altitude_amsl_m <= 11000.0:
        altitude_amsl_m = min(max(altitude_amsl_m, -1000.0), 11000.0)
    share = 1.0 - 2.25577e-5 * altitude_amsl_m
    ratio: float = share**-2.12794
    return ratio


def true_airspeed_m_s(demanded_m_s: float, altitude_amsl_m: float) -> float:
    """What is flown when this airspeed is asked for."""
    return _interpolated(demanded_m_s, DEMANDED_M_S, HELD_M_S) * eas_to_tas(altitude_amsl_m)


def indicated_airspeed_m_s(true_m_s: float, altitude_amsl_m: float) -> float:
    """What the pitot tube says: the inverse."""
    return _interpolated(true_m_s / eas_to_tas(altitude_amsl_m), HELD_M_S, DEMANDED_M_S)


@final
class HeightControl:
    """From a wanted height to a climb rate: limited in rate, then smoothed, then followed."""

    def __init__(self, *, climb_max_m_s: float, sink_max_m_s: float) -> None:
        self.climb_max_m_s = climb_max_m_s
        self.sink_max_m_s = sink_max_m_s
        self._limited_m = self._smooth_m = 0.0

    def begin(self, height_m: float) -> None:
        """Start from this height."""
        self._limited_m = self._smooth_m = height_m

    def climb_m_s(self, wanted_m: float, height_m: float, dt_s: float) -> float:
        """Climb rate for this step."""
        change = wanted_m - self._limited_m
        most, least = self.climb_max_m_s * dt_s, -self.sink_max_m_s * dt_s
        self._limited_m += most if change > most else least if change < least else change
        rate = (self._limited_m - self._smooth_m) / DEMAND_S
        self._smooth_m += rate * dt_s
        return rate + (self._smooth_m - height_m) / ERROR_S
