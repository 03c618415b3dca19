"""Where ArduCopter's nose points: along the way, to a commanded yaw, or turning at a rate."""

import math
from typing import final

SLEW_RAD_S = math.radians(60.0)
"""ATC_SLEW_YAW."""
GAIN_1_S = 4.5
"""ATC_ANG_YAW_P."""
_MOVING_SHARE = 0.05
"""Of WPNAV_SPEED: slower, the way has no direction."""


@final
class Yaw:
    """The commanded yaw, if there is one."""

    def __init__(self) -> None:
        self.angle_rad: float | None = None
        self.rate_rad_s: float | None = None

    def look_ahead(self) -> None:
        """Forget what was commanded."""
        self.angle_rad = self.rate_rad_s = None

    def command(self, angle_rad: float | None, rate_rad_s: float | None) -> None:
        """As a setpoint says; nothing means ahead."""
        self.angle_rad, self.rate_rad_s = angle_rad, rate_rad_s

    def fix(
        self, heading_rad: float, angle_rad: float, direction: float, *, relative: bool
    ) -> None:
        """CONDITION_YAW: to an angle, or by one."""
        if relative:
            angle_rad = heading_rad + (angle_rad if direction >= 0.0 else -angle_rad)
        self.command(angle_rad, None)

    def turned(
        self,
        heading_rad: float,
        way_m_s: tuple[float, float],
        speed_m_s: float,
        dt_s: float,
        *,
        ahead: bool,
    ) -> float:
        """The heading one step on, from 0 to 2 pi."""
        if self.angle_rad is None and self.rate_rad_s is not None:
            return (heading_rad + self.rate_rad_s * dt_s) % math.tau
        wanted_rad = self.angle_rad
        if wanted_rad is None:
            north, east = way_m_s
            least = _MOVING_SHARE * speed_m_s
            if not ahead or north * north + east * east < least * least:
                return heading_rad
            wanted_rad = math.atan2(east, north)
        rate = GAIN_1_S * math.remainder(wanted_rad - heading_rad, math.tau)
        rate = min(max(rate, -SLEW_RAD_S), SLEW_RAD_S)
        return (heading_rad + rate * dt_s) % math.tau
