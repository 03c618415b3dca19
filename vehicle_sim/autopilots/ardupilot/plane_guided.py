"""What ArduPlane was told besides a point: speed and, in GUIDED, height by rate and heading.

All of it is forgotten when the mode changes.  Source: ardupilot.md 7.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, final

from vehicle_sim.dynamics.copter import GRAVITY_M_S2
from vehicle_sim.parameters import Parameters

HEADING_GAIN = math.radians(50.0)
"""Bank for each radian of heading error: GUIDED_P 5000 hundredths of a degree."""
ERROR_FILTER_S = 1.0 / (math.tau * 5.0)
_AT_ONCE = 1000.0
_LATERAL_LEAST_M_S2 = 0.05


FORCED_US = 3_000_000
"""An attitude or throttle from outside is forgotten after this."""


@final
class Forced(NamedTuple):
    """What SET_ATTITUDE_TARGET asks for; None: nothing."""

    roll_rad: float | None = None
    pitch_rad: float | None = None
    throttle: float | None = None


NOT_FORCED = Forced()


@final
class Guided:
    """DO_CHANGE_SPEED, GUIDED_CHANGE_SPEED, _ALTITUDE and _HEADING."""

    def __init__(self, parameters: Parameters, say: Callable[[int, str], None]) -> None:
        self._parameters = parameters
        self._say = say
        self.cruise_m_s: float | None = None
        """Airspeed of DO_CHANGE_SPEED, in AUTO too."""
        self.holds_heading = False
        """For ever: there is no time-out."""
        self.of_course = True
        """The heading is that of the way over the ground."""
        self._heading_rad = 0.0
        self._bank_most_rad = 0.0
        self._error_rad = 0.0
        self._airspeed_m_s: float | None = None
        self._acceleration_m_s2 = _AT_ONCE
        self._altitude_amsl_m: float | None = None
        self._rate_m_s = _AT_ONCE
        self._forced = NOT_FORCED
        self._forced_until_us = [0, 0, 0]

    def forget(self) -> None:
        """The mode has changed."""
        self.holds_heading = False
        self._airspeed_m_s = self._altitude_amsl_m = self.cruise_m_s = None
        self._forced = NOT_FORCED

    # --- what it is told ----------------------------------------------------------------------

    def change_speed(self, kind: float, speed_m_s: float) -> bool:
        """DO_CHANGE_SPEED: airspeed (0) within the limits; -2 restores the cruising speed."""
        parameters = self._parameters
        if kind != 0.0:
            return kind == 1.0
        if speed_m_s == -2.0:
            self.cruise_m_s = None
            return True
        if not parameters["AIRSPEED_MIN"] <= speed_m_s <= parameters["AIRSPEED_MAX"]:
            return False
        self.cruise_m_s = speed_m_s
        self._say(6, f"Set airspeed {int(speed_m_s)} m/s")
        return True

    def set_speed(self, airspeed_m_s: float, acceleration_m_s2: float) -> None:
        """GUIDED_CHANGE_SPEED; 0: as fast as it can."""
        self._airspeed_m_s = airspeed_m_s
        self._acceleration_m_s2 = abs(acceleration_m_s2) or _AT_ONCE

    def set_altitude(self, altitude_amsl_m: float, rate_m_s: float) -> None:
        """GUIDED_CHANGE_ALTITUDE; 0: as fast as it can."""
        self._altitude_amsl_m = altitude_amsl_m
        self._rate_m_s = abs(rate_m_s) or _AT_ONCE

    def set_heading(self, heading_rad: float, lateral_m_s2: float, *, course: bool) -> None:
        """GUIDED_CHANGE_HEADING."""
        if not self.holds_heading:
            self._error_rad = 0.0
        self.holds_heading, self.of_course = True, course
        self._heading_rad = heading_rad
        self._bank_most_rad = math.atan(max(lateral_m_s2, _LATERAL_LEAST_M_S2) / GRAVITY_M_S2)

    def force(self, forced: Forced, now_us: int) -> None:
        """SET_ATTITUDE_TARGET; what it does not give is as before."""
        for at, value in enumerate(forced):
            if value is not None:
                self._forced_until_us[at] = now_us + FORCED_US
        given = {name: value for name, value in forced._asdict().items() if value is not None}
        self._forced = self._forced._replace(**given)

    # --- what comes of it -----------------------------------------------------------------------

    def airspeed_m_s(self, before_m_s: float, dt_s: float) -> float | None:
        """The airspeed to hold now; None: the usual one."""
        if self._airspeed_m_s is None:
            return None
        most = self._acceleration_m_s2 * dt_s
        return before_m_s + min(max(self._airspeed_m_s - before_m_s, -most), most)

    def altitude_amsl_m(self, present_m: float, dt_s: float) -> float | None:
        """The height to be at now; based anew on the present one each time, so that it crawls."""
        if self._altitude_amsl_m is None:
            return None
        most_m = self._rate_m_s * dt_s
        return min(max(self._altitude_amsl_m, present_m - most_m), present_m + most_m)

    def forced(self, now_us: int) -> Forced:
        """What of it holds still."""
        if self._forced is NOT_FORCED:
            return NOT_FORCED
        lasting = zip(self._forced, self._forced_until_us, strict=True)
        return Forced(*(None if now_us > until_us else value for value, until_us in lasting))

    def bank_rad(self, actual_rad: float, dt_s: float) -> float:
        """Proportional to the error, up to the bank of the lateral acceleration given."""
        error_rad = math.remainder(self._heading_rad - actual_rad, math.tau)
        change = math.remainder(error_rad - self._error_rad, math.tau)
        self._error_rad += change * dt_s / (ERROR_FILTER_S + dt_s)
        bank, most = HEADING_GAIN * self._error_rad, self._bank_most_rad
        return -most if bank < -most else most if bank > most else bank
