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
            self._checked_us, kept = now_us, self._echoes.items()
            self._echoes = {k: echo for k, echo in kept if now_us - echo[1] <= _TIMEOUT_US}
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
        known = "RNGFND1_TYPE" in parameters
        self.numbers = (DISTANCE_SENSOR, RANGEFINDER) if known else ()
        """The messages that come from here."""
        is_there = known and parameters["PRX1_TYPE"] == RPLIDAR
        self.sectors = Sectors(*limits_m) if is_there else None
        self._finds = known and bool(parameters["RNGFND1_TYPE"])
        self._finds = self._finds and parameters["RNGFND1_ORIENT"] == _DOWN
        names = ("RNGFND1_MIN", "RNGFND1_MAX")
        self._limits_cm = [round(parameters.get(name, 0.0) * 100.0) for name in names]

    def bits(self, now_us: int) -> tuple[int, int]:
        """Of SYS_STATUS: what is there, and what of it is not well."""
        sectors = self.sectors
        ill = sectors is not None and not sectors.healthy(now_us)
        there = _PROXIMITY_BIT * (sectors is not None) | _DOWN_BIT * self._finds
        return there, there & (_PROXIMITY_BIT * ill | _DOWN_BIT * self.rangefinder_off)

    def messages(self, number: int, now_us: int) -> list[Prepared]:
        """All DISTANCE_SENSOR of now, or the RANGEFINDER; one that is off goes on with 0."""
        finds, is_off = self._finds, self.rangefinder_off
        if number == RANGEFINDER:
            return [make("RANGEFINDER", 0.0 if is_off else self._look_down())] if finds else []
        found = list[Prepared]()
        if finds and not is_off:
            range_cm = min(int(self._look_down() * 100.0), _UNKNOWN)
            rest = (range_cm, mavlink.MAV_DISTANCE_SENSOR_UNKNOWN, 0, _DOWN)
            found.append(make("DISTANCE_SENSOR", now_us // 1000, *self._limits_cm, *rest))
        return found if self.sectors is None else [*found, *self.sectors.messages(now_us)]
