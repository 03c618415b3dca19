"""An ArduPilot's range sensors: eight sectors of obstacles about it, and a rangefinder downwards.

After AP_Proximity_RPLidarA2.cpp, AP_Proximity_Boundary_3D.cpp and GCS_Common.cpp as
docs/reference/proximity.md 1 and 3 read and measured them: a sector says its nearest echo; left
without one it repeats the last until that times out, and the *next* one is made empty instead; it
is told from its first echo on, as "max" when empty, while any sector has one; and the stamp is that
of sending.
"""

import math
from collections.abc import Callable, Iterable
from typing import Final, final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Parameters
from vehicle_sim.wire.frames import Prepared, make

DISTANCE_SENSOR, RANGEFINDER = 132, 173
RPLIDAR: Final = 5
"""PRX1_TYPE of the one sensor that there is here."""
_FIRST_ID: Final = 10
_TIMEOUT_US, _CHECK_US = 1_000_000, 750_000
"""An echo is forgotten at the first check after its time-out."""
_LOST_AFTER_US: Final = 200_000
_UNKNOWN: Final = 65535
_DOWN, _LASER = 25, mavlink.MAV_DISTANCE_SENSOR_LASER
_PROXIMITY_BIT: Final = mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY
_DOWN_BIT: Final = mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION
_NAMES: Final = ("PRX1_TYPE", "RNGFND1_MIN", "RNGFND1_MAX", "RNGFND1_TYPE", "RNGFND1_ORIENT")


@final
class Sectors:
    """What an RPLidar on ArduPilot has told since the autopilot's boot.  Times are since boot."""

    def __init__(self, min_m: float, max_m: float) -> None:
        self._limits_cm = round(min_m * 100.0), round(max_m * 100.0)
        self._echoes: dict[int, tuple[float, int]] = {}
        """By sector: how far, in centimetres, and when."""
        self._told = set[int]()
        """Sectors that had an echo at some time."""
        self._input_us, self._checked_us = -_TIMEOUT_US, 0
        self._sector, self._nearest_m = 0, math.inf
        """Where the lidar looks, and what it has seen there in this turn."""

    def healthy(self, now_us: int) -> bool:
        """Whether anything came from the sensor lately."""
        return now_us - self._input_us < _LOST_AFTER_US

    def on_beams(
        self, angles_rad: Iterable[float], distances_m: Iterable[float], now_us: int
    ) -> None:
        """Beams in the order in which they were measured."""
        for angle_rad, distance_m in zip(angles_rad, distances_m, strict=True):
            self._input_us = now_us
            sector = int((math.degrees(angle_rad) + 22.5) % 360.0 / 45.0) % 8
            if sector != self._sector:
                if self._nearest_m < math.inf:
                    self._echoes[self._sector] = self._nearest_m * 100.0, now_us
                else:
                    self._echoes.pop(sector, None)  # the one before is meant
                self._sector, self._nearest_m = sector, math.inf
            if distance_m < self._nearest_m:
                self._nearest_m = distance_m

    def messages(self, now_us: int) -> list[Prepared]:
        """DISTANCE_SENSOR of all sectors, while any of them has an echo."""
        if now_us - self._checked_us >= _CHECK_US:
            self._checked_us = now_us
            late = [k for k, (_, us) in self._echoes.items() if now_us - us > _TIMEOUT_US]
            for sector in late:
                del self._echoes[sector]
        if not self._echoes or not self.healthy(now_us):
            return []
        self._told |= self._echoes.keys()
        head, empty = (now_us // 1000, *self._limits_cm), (self._limits_cm[1], 0)
        told = [(k, int(self._echoes.get(k, empty)[0])) for k in sorted(self._told)]
        return [make("DISTANCE_SENSOR", *head, cm, _LASER, _FIRST_ID + k, k) for k, cm in told]


@final
class RangeSensors:
    """What an ArduPilot has of them since its boot: eight sectors, and a rangefinder.

    PX4, which has none of these parameters, has only the one that looks down, of telemetry.py.
    limits_m: of a lidar of its own.  look_down: how far it is to the ground along the body's
    downward axis.
    """

    def __init__(
        self,
        parameters: Parameters,
        limits_m: tuple[float, float],
        look_down: Callable[[], float],
    ) -> None:
        self._look_down, self.rangefinder_off = look_down, False
        known = [parameters[name] for name in _NAMES if name in parameters]
        self.numbers = (DISTANCE_SENSOR, RANGEFINDER) if known else ()
        """The messages that come from here."""
        kind, *limits, there, orientation = known or (0.0,) * 5
        self.sectors = Sectors(*limits_m) if kind == RPLIDAR else None
        self._limits_cm = [round(limit_m * 100.0) for limit_m in limits]
        self._has_rangefinder = bool(there) and orientation == _DOWN

    def bits(self, now_us: int) -> tuple[int, int]:
        """Of SYS_STATUS: what is there, and what of it is not well."""
        there = lost = 0
        if self.sectors is not None:
            there = _PROXIMITY_BIT
            lost = 0 if self.sectors.healthy(now_us) else _PROXIMITY_BIT
        if self._has_rangefinder:
            there |= _DOWN_BIT
            lost |= _DOWN_BIT if self.rangefinder_off else 0
        return there, lost

    def messages(self, number: int, now_us: int) -> list[Prepared]:
        """All DISTANCE_SENSOR of now, or the RANGEFINDER; one that is off goes on with 0."""
        has_one, is_off = self._has_rangefinder, self.rangefinder_off
        if number == RANGEFINDER:
            return [make("RANGEFINDER", 0.0 if is_off else self._look_down())] if has_one else []
        found = list[Prepared]() if self.sectors is None else self.sectors.messages(now_us)
        if has_one and not is_off:
            range_cm = min(int(self._look_down() * 100.0), _UNKNOWN)
            rest = (range_cm, mavlink.MAV_DISTANCE_SENSOR_UNKNOWN, 0, _DOWN)
            found.insert(0, make("DISTANCE_SENSOR", now_us // 1000, *self._limits_cm, *rest))
        return found
