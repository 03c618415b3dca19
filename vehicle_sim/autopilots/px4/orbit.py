"""DO_ORBIT: the circle that is asked for, and the velocity that leads onto it and round it.

Limits are those of FlightTaskOrbit; how it goes round was not measured.
"""

import math
from typing import Final, NamedTuple, final

_RADIUS_M: Final = (1.0, 1000.0)
_MOST_M_S: Final = 10.0
_MOST_M_S2: Final = 2.0
_GAIN_1_S: Final = 0.5


@final
class Orbit(NamedTuple):
    """A circle; what is not given of its centre is NaN."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    radius_m: float = _RADIUS_M[0]
    """Negative: counter-clockwise."""
    speed_m_s: float = 1.0

    @property
    def flyable(self) -> bool:
        """Whether a multicopter takes it."""
        size_m, speed_m_s = abs(self.radius_m), abs(self.speed_m_s)
        return (
            _RADIUS_M[0] <= size_m <= _RADIUS_M[1]
            and speed_m_s <= _MOST_M_S
            and speed_m_s**2 <= _MOST_M_S2 * size_m
        )

    def velocity_m_s(self, north_m: float, east_m: float, cruise_m_s: float) -> tuple[float, float]:
        """North and east, at this place from the centre: along the circle, and towards it."""
        away_m = math.hypot(north_m, east_m)
        out_n, out_e = (north_m / away_m, east_m / away_m) if away_m > 0.1 else (1.0, 0.0)
        outward = _GAIN_1_S * (abs(self.radius_m) - away_m)
        outward = min(max(outward, -cruise_m_s), cruise_m_s)
        near = max(1.0 - abs(outward) / cruise_m_s, 0.0)
        along = math.copysign(near * abs(self.speed_m_s), self.radius_m * self.speed_m_s)
        return out_n * outward - out_e * along, out_e * outward + out_n * along


HERE: Final = Orbit(math.nan, math.nan, math.nan)
