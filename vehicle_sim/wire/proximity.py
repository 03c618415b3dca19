"""ArduPilot's proximity sensor: eight sectors, with all that is wrong with them.

After AP_Proximity_RPLidarA2.cpp, AP_Proximity_MAV.cpp, AP_Proximity_Boundary_3D.cpp and
GCS_Common.cpp as docs/reference/proximity.md 1 and 2 read and measured them: on leaving a sector
without an echo the next one is made empty instead; a sector that became empty repeats its last
distance until it times out; a sector is told from its first echo on, as "max" when empty, while any
sector has one; and the stamp is that of sending.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, Final, final

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.parameters import Parameters
from vehicle_sim.wire.frames import make

DISTANCE_SENSOR, RANGEFINDER = 132, 173
RPLIDAR, BY_MAVLINK = 5, 2
"""PRX1_TYPE, as far as there are such sensors here."""
_SECTORS: Final = 8
_FIRST_ID: Final = 10
_TIMEOUT_US, _CHECK_US = 1_000_000, 750_000
_LOST_AFTER_US: Final = {RPLIDAR: 200_000, BY_MAVLINK: 500_000}
_UNKNOWN: Final = 65535
_DOWN, _LASER = 25, mavlink.MAV_DISTANCE_SENSOR_LASER
_PROXIMITY_BIT: Final = mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY
_DOWN_BIT: Final = mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION


@final
class Proximity:
    """One sensor since the autopilot's boot: PRX1_TYPE is read then.  Times are since boot."""

    def __init__(self, kind: int, min_m: float = 0.0, max_m: float = 0.0) -> None:
        self.kind = kind
        self._min_m, self._max_m = np.float32(min_m), np.float32(max_m)
        self._distance_m = np.full(_SECTORS, np.nan, dtype=np.float32)
        self._updated_us = np.zeros(_SECTORS, dtype=np.int64)
        self._told = set[int]()
        """Sectors that had an echo at some time."""
        self._checked_us, self._input_us = 0, -_TIMEOUT_US
        self._sector = 0
        self._nearest_m: float | None = None

    def healthy(self, now_us: int) -> bool:
        """Whether anything came from the sensor lately."""
        return now_us - self._input_us < _LOST_AFTER_US.get(self.kind, 0)

    def on_beams(
        self, angles_rad: Iterable[float], distances_m: Iterable[float], now_us: int
    ) -> None:
        """Beams of an RPLidar in the order in which they were measured."""
        if self.kind != RPLIDAR:
            return
        for angle_rad, distance_m in zip(angles_rad, distances_m, strict=True):
            self._input_us = now_us
            sector = _sector_of(math.degrees(angle_rad))
            if sector != self._sector:
                if self._nearest_m is not None:
                    self._set(self._sector, self._nearest_m, now_us)
                else:
                    self._distance_m[sector] = np.nan  # the one before is meant
                self._sector, self._nearest_m = sector, None
            if math.isfinite(distance_m) and (
                self._nearest_m is None or distance_m < self._nearest_m
            ):
                self._nearest_m = distance_m

    def on_obstacle_distance(self, message: Any, now_us: int) -> None:
        """OBSTACLE_DISTANCE of anybody: its frame is not read, nor what it says of nothing."""
        step_deg = message.increment_f or float(message.increment)
        if self.kind != BY_MAVLINK or not math.isfinite(step_deg + message.angle_offset):
            return
        self._input_us = now_us
        least_cm, most_cm = message.min_distance, message.max_distance
        self._min_m, self._max_m = (np.float32(cm) * np.float32(0.01) for cm in (least_cm, most_cm))
        count = min(round(360.0 / abs(step_deg)) if step_deg else 0, len(message.distances))
        before: tuple[int, float] | None = None
        for k, cm in enumerate(message.distances[:count]):
            if cm in (0, _UNKNOWN) or not least_cm <= cm <= most_cm:
                continue
            sector = _sector_of(k * step_deg + message.angle_offset)
            if before is not None and before[0] != sector:
                self._set(*before, now_us)  # the front comes twice, and its second part counts
                before = None
            before = sector, min(cm * 0.01, before[1] if before else math.inf)
        if before is not None:
            self._set(*before, now_us)

    def _set(self, sector: int, distance_m: float, now_us: int) -> None:
        self._distance_m[sector], self._updated_us[sector] = distance_m, now_us

    def step(self, now_us: int) -> None:
        """Forget what is old, now and then."""
        if now_us - self._checked_us >= _CHECK_US:
            self._checked_us = now_us
            self._distance_m[now_us - self._updated_us > _TIMEOUT_US] = np.nan

    def messages(self, now_us: int) -> list[Any]:
        """DISTANCE_SENSOR of all sectors, while any of them has an echo."""
        valid = ~np.isnan(self._distance_m)
        if not (valid.any() and self.healthy(now_us)):
            return []
        self._told.update(np.flatnonzero(valid).tolist())
        shown_m = np.where(valid, self._distance_m, self._max_m)
        head = (now_us // 1000, _cm(self._min_m), _cm(self._max_m))
        return [
            make("DISTANCE_SENSOR", *head, _cm(shown_m[sector]), _LASER, _FIRST_ID + sector, sector)
            for sector in sorted(self._told)
        ]


@final
class RangeSensors:
    """What an ArduPilot has of them since its boot: proximity, and a rangefinder (proximity.md 3).

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
        known = "PRX1_TYPE" in parameters
        self.proximity = Proximity(int(parameters["PRX1_TYPE"]) if known else 0, *limits_m)
        self.numbers = (DISTANCE_SENSOR, RANGEFINDER) if known else ()
        """The messages that come from here."""
        if known:
            self._limits_m = parameters["RNGFND1_MIN"], parameters["RNGFND1_MAX"]
        looks_down = known and parameters["RNGFND1_ORIENT"] == _DOWN
        self._has_rangefinder = looks_down and bool(parameters["RNGFND1_TYPE"])

    def bits(self, now_us: int) -> tuple[int, int]:
        """Of SYS_STATUS: what is there, and what of it is not well."""
        there = _PROXIMITY_BIT if self.proximity.kind else 0
        there |= _DOWN_BIT if self._has_rangefinder else 0
        lost = 0 if self.proximity.healthy(now_us) else _PROXIMITY_BIT
        return there, there & (lost | (_DOWN_BIT if self.rangefinder_off else 0))

    def messages(self, number: int, now_us: int) -> list[Any]:
        """All DISTANCE_SENSOR of now, or the RANGEFINDER."""
        has_one, is_off = self._has_rangefinder, self.rangefinder_off
        if number == RANGEFINDER:
            return [make("RANGEFINDER", 0.0 if is_off else self._look_down())] if has_one else []
        found = self.proximity.messages(now_us)
        if has_one and not is_off:
            limits_cm = (round(limit_m * 100.0) for limit_m in self._limits_m)
            range_cm = min(_cm(np.float32(self._look_down())), _UNKNOWN)
            rest = (*limits_cm, range_cm, mavlink.MAV_DISTANCE_SENSOR_UNKNOWN, 0, _DOWN)
            found.insert(0, make("DISTANCE_SENSOR", now_us // 1000, *rest))
        return found


def _sector_of(angle_deg: float) -> int:
    return int((angle_deg + 22.5) % 360.0 / 45.0) % _SECTORS


def _cm(distance_m: np.float32) -> int:
    """Cut off, in single precision: 30 cm come back as 29."""
    return int(distance_m * np.float32(100.0))
