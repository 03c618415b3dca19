"""An ArduPilot's range sensors: eight sectors of obstacles about it, and a rangefinder downwards.

After AP_Proximity_RPLidarA2.cpp, AP_Proximity_Boundary_3D.cpp and GCS_Common.cpp as
docs/lab/proximity.md 1 and 3 read and measured them: a sector says its nearest echo; left
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


@final
class RangeSensors:
    """What an ArduPilot has of them since its boot, and in whose time: PX4 has none of these.

    limits_m: of an RPLidar of its own.  look_down: how far it is to the ground along the body's
    downward axis.
    """

    def __init__(
        self, parameters: Parameters, limits_m: tuple[float, float], look_down: Callable[[], float]
    ) -> None:
        self.numbers = (DISTANCE_SENSOR, RANGEFINDER) if "PRX1_TYPE" in parameters else ()
        """The messages that come from here."""
        self.has_lidar = parameters.get("PRX1_TYPE") == RPLIDAR
        names = ("TYPE", "ORIENT", "MIN", "MAX")
        kind, looks, *limits = (parameters.get(f"RNGFND1_{name}", 0.0) for name in names)
        self._has_rangefinder = kind != 0.0 and looks == _DOWN
        self._look_down, self.rangefinder_off = look_down, False
        self._limits_cm = [round(limit_m * 100.0) for limit_m in limits]
        self._lidar_limits_cm = [round(limit_m * 100.0) for limit_m in limits_m]
        self._echoes: dict[int, tuple[float, int]] = {}
        """By sector: how far, in centimetres, and when."""
        self._seen = set[int]()
        """Sectors that had an echo at some time."""
        self._input_us, self._checked_us = -_TIMEOUT_US, 0
        self._sector, self._nearest_m = 0, math.inf
        """Where the lidar looks, and what it has seen there in this turn."""

    def on_beams(
        self, angles_rad: Iterable[float], distances_m: Iterable[float], now_us: int
    ) -> None:
        """Beams of the lidar in the order in which they were measured."""
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

    def bits(self, now_us: int) -> tuple[int, int]:
        """Of SYS_STATUS: what is there, and what of it is not well."""
        there = _PROXIMITY_BIT * self.has_lidar | _DOWN_BIT * self._has_rangefinder
        lost = _PROXIMITY_BIT * self._is_dead(now_us) | _DOWN_BIT * self.rangefinder_off
        return there, there & lost

    def _is_dead(self, now_us: int) -> bool:
        """Whether nothing has come from the lidar lately."""
        return now_us - self._input_us >= _LOST_AFTER_US

    def messages(self, number: int, now_us: int) -> list[Prepared]:
        """All DISTANCE_SENSOR of now, or the RANGEFINDER; one that is off goes on with 0."""
        if number == RANGEFINDER:
            range_m = 0.0 if self.rangefinder_off else self._look_down()
            return [make("RANGEFINDER", range_m)] if self._has_rangefinder else []
        messages = list[Prepared]()
        if self._has_rangefinder and not self.rangefinder_off:
            range_cm = min(int(self._look_down() * 100.0), _UNKNOWN)
            rest = (range_cm, mavlink.MAV_DISTANCE_SENSOR_UNKNOWN, 0, _DOWN)
            messages.append(make("DISTANCE_SENSOR", now_us // 1000, *self._limits_cm, *rest))
        return messages + self._sectors(now_us)

    def _sectors(self, now_us: int) -> list[Prepared]:
        """DISTANCE_SENSOR of all sectors, while any of them has an echo."""
        if now_us - self._checked_us >= _CHECK_US:
            self._checked_us, kept = now_us, self._echoes.items()
            self._echoes = {k: echo for k, echo in kept if now_us - echo[1] <= _TIMEOUT_US}
        if not self._echoes or self._is_dead(now_us):
            return []
        self._seen |= self._echoes.keys()
        head, empty = (now_us // 1000, *self._lidar_limits_cm), (self._lidar_limits_cm[1], 0)
        distances_cm = [(k, int(self._echoes.get(k, empty)[0])) for k in sorted(self._seen)]
        return [
            make("DISTANCE_SENSOR", *head, cm, _LASER, _FIRST_ID + k, k) for k, cm in distances_cm
        ]
