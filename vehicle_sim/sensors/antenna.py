"""Position and velocity samples at the GPS antenna, and a jammer."""

from typing import NamedTuple, final

import numpy as np

from vehicle_sim.geodesy import ARDUPILOT_M_PER_DEG, degrees_east

_FORGOTTEN_US = 1_000_000
_MIN_SATELLITES = 4
_WILD_M_S = 400.0
_WILD_M = 200.0


@final
class Sample(NamedTuple):
    """Where the antenna was."""

    time_us: int
    locked: bool
    """There was a fix."""
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    north_m_s: float
    east_m_s: float
    up_m_s: float


def between(old: Sample, new: Sample, share: float) -> Sample:
    """From old (0) to new (1)."""
    turn_deg = degrees_east(old.longitude_deg, new.longitude_deg)
    return Sample(
        old.time_us,
        old.locked,
        old.latitude_deg + share * (new.latitude_deg - old.latitude_deg),
        old.longitude_deg + share * turn_deg,
        old.altitude_amsl_m + share * (new.altitude_amsl_m - old.altitude_amsl_m),
        old.north_m_s + share * (new.north_m_s - old.north_m_s),
        old.east_m_s + share * (new.east_m_s - old.east_m_s),
        old.up_m_s + share * (new.up_m_s - old.up_m_s),
    )


@final
class Jamming:
    """A jammer near by, as ArduPilot's simulation has it: nothing for a while, then wild values."""

    _RATES_HZ = (3.0, 0.5, 0.8, 1.1)
    """How often satellites, climb, level velocity and position change."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._last_us = -_FORGOTTEN_US - 1
        self._start_us = 0
        self._changed_us = [0, 0, 0, 0]
        self._place_deg = (0.0, 0.0)

    def spoil(self, now_us: int, sample: Sample, satellites: int) -> tuple[Sample, bool, int]:
        """The sample as the jammed receiver has it, whether it has a fix, and the satellites."""
        rng = self._rng
        if now_us - self._last_us > _FORGOTTEN_US:
            self._start_us = now_us
            self._place_deg = (sample.latitude_deg, sample.longitude_deg)
        self._last_us = now_us
        locked, north, east, up = sample.locked, sample.north_m_s, sample.east_m_s, sample.up_m_s
        if now_us - self._start_us < 1_000_000 + int(rng.integers(5_000_000)):
            locked, satellites = False, 0
        else:
            if self._changes(0, now_us):
                satellites = 2 + int(rng.integers(15))
                locked = satellites >= _MIN_SATELLITES and bool(rng.integers(2))
            if self._changes(1, now_us):
                up = float(rng.uniform(-_WILD_M_S, _WILD_M_S))
            if self._changes(2, now_us):
                north, east = rng.uniform(-_WILD_M_S, _WILD_M_S, 2).tolist()
            if self._changes(3, now_us):
                step_deg = (rng.uniform(-_WILD_M, _WILD_M, 2) / ARDUPILOT_M_PER_DEG).tolist()
                self._place_deg = (
                    min(max(self._place_deg[0] + step_deg[0], -90.0), 90.0),
                    min(max(self._place_deg[1] + step_deg[1], -180.0), 180.0),
                )
        latitude_deg, longitude_deg = self._place_deg
        place = (latitude_deg, longitude_deg, sample.altitude_amsl_m)
        return Sample(sample.time_us, locked, *place, north, east, up), locked, satellites

    def _changes(self, which: int, now_us: int) -> bool:
        since_s = (now_us - self._changed_us[which]) * 1e-6
        changes = since_s > 2.0 * float(self._rng.uniform()) / self._RATES_HZ[which]
        if changes:
            self._changed_us[which] = now_us
        return changes
