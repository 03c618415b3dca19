"""What a turn on the spot shows of how a sensor of near things is mounted.

What stands around stays where it is while the vehicle turns.  A sensor that counts its sectors the
wrong way, or whose messages name the wrong frame, shows it turning.  A wrong constant yaw shows in
nothing but the direction to a thing that a person can see.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from companion.geodesy import FloatArray, wrap_rad
from companion.world.near_map import NearSensor, Sweep

TURN_RAD: Final = math.radians(90.0)
"""So far it has to turn."""
_BEARINGS: Final = 72
_STEP_RAD: Final = math.radians(5.0)  # of yaw between two sweeps that are kept
_CLIP_M: Final = 2.0  # one cell that sees past an edge counts no more than this
_LEAST_M: Final = 0.2  # that readings differ where turning is told from standing still
_TIMES: Final = 2.0  # worse than the best explanation is the next
_PART_M: Final = 0.15  # by which the distance of a part of the vehicle changes
_PARTS_WITHIN_M: Final = 1.5
_SHARE: Final = 0.9  # of all sweeps show it


class Turning(enum.Enum):
    """How what stands around seems to turn with the vehicle; the value is what is told."""

    STAYS = "what stands around stays where it is while the vehicle turns"
    MIRRORED = "the sensor counts its sectors the wrong way round"
    NORTH_UP = "the sensor's messages say that they count from the nose, but they count from north"
    NOSE_UP = "the sensor's messages say that they count from north, but they count from the nose"
    UNDECIDED = "nothing stands around by which it can be told"
    NOT_TURNED = "the vehicle has not been turned"


_EXPLAINED: Final[dict[Turning, tuple[float, float]]] = {
    Turning.STAYS: (1.0, 0.0),
    Turning.MIRRORED: (-1.0, 2.0),
    Turning.NORTH_UP: (1.0, -1.0),
    Turning.NOSE_UP: (1.0, 1.0),
}
"""True bearing = first x told bearing + second x yaw, but for a constant."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Something that the sensor sees."""

    distance_m: float
    off_nose_rad: float
    """Clockwise from the nose."""


@final
class MountingCheck:
    """Collects the sweeps of a vehicle that is turned on the spot."""

    def __init__(self, sensor: NearSensor) -> None:
        self._sensor = sensor
        self._yaws_rad: list[float] = []
        self._told_m: list[FloatArray] = []
        self._recent: deque[tuple[float, float]] = deque(maxlen=20)
        """Vehicle time of the last sweeps, and their age then."""
        self._low_rad = self._high_rad = self._turned_rad = 0.0
        self._newest: tuple[Sweep, float] | None = None

    def add(self, sweep: Sweep, yaw_rad: float, now_s: float) -> None:
        """A sweep, how the vehicle was turned, from grid north, and the time that it is now."""
        if self._newest is not None:
            self._turned_rad += wrap_rad(yaw_rad - self._newest[1])
            self._low_rad = min(self._low_rad, self._turned_rad)
            self._high_rad = max(self._high_rad, self._turned_rad)
        self._newest = sweep, yaw_rad
        self._recent.append((sweep.time_s, now_s - sweep.time_s))
        if not self._yaws_rad or abs(wrap_rad(yaw_rad - self._yaws_rad[-1])) >= _STEP_RAD:
            self._yaws_rad.append(yaw_rad)
            self._told_m.append(_profile_m(sweep))

    @property
    def turned_rad(self) -> float:
        """From the leftmost heading to the rightmost."""
        return self._high_rad - self._low_rad

    @property
    def rate_hz(self) -> float | None:
        """Of the sweeps."""
        span_s = self._recent[-1][0] - self._recent[0][0] if self._recent else 0.0
        return (len(self._recent) - 1) / span_s if span_s > 0.0 else None

    @property
    def age_s(self) -> float | None:
        """From a measurement to when its pose is known, in the median."""
        return float(np.median([age_s for _, age_s in self._recent])) if self._recent else None

    @property
    def nearest(self) -> Seen | None:
        """The nearest thing beyond what is taken for the vehicle, in the last sweep."""
        if self._newest is None:
            return None
        sweep, yaw_rad = self._newest
        echo_m = np.where(sweep.echo_m > self._sensor.blind_m, sweep.echo_m, np.inf)
        at = int(np.argmin(echo_m))
        if not math.isfinite(echo_m[at]):
            return None
        bearing_rad = sweep.first_rad + (at + 0.5) * sweep.width_rad
        return Seen(distance_m=float(echo_m[at]), off_nose_rad=wrap_rad(bearing_rad - yaw_rad))

    def turning(self) -> Turning:
        """The explanation under which what stands around stays where it is, if it is the only."""
        if self.turned_rad < TURN_RAD:
            return Turning.NOT_TURNED
        spread_m = {
            turning: _spread_m(
                [
                    _turned(told_m, sense, share * yaw_rad)
                    for told_m, yaw_rad in zip(self._told_m, self._yaws_rad, strict=True)
                ]
            )
            for turning, (sense, share) in _EXPLAINED.items()
        }
        best, second = sorted(spread_m, key=spread_m.__getitem__)[:2]
        clear = spread_m[second] > max(_TIMES * spread_m[best], _LEAST_M)
        return best if clear else Turning.UNDECIDED

    @property
    def part(self) -> Seen | None:
        """The nearest thing beyond what is taken for the vehicle that turns with it."""
        if self.turned_rad < TURN_RAD:
            return None
        pairs = zip(self._told_m, self._yaws_rad, strict=True)
        told_m = np.array([_turned(each_m, 1.0, -yaw_rad) for each_m, yaw_rad in pairs])
        outside = (told_m > self._sensor.blind_m) & (told_m <= _PARTS_WITHIN_M)
        near_m = np.where(outside, told_m, np.inf)
        # a sector's edge may fall to either side as the heading is rounded
        near_m = np.minimum(near_m, np.minimum(np.roll(near_m, 1, 1), np.roll(near_m, -1, 1)))
        found = []
        for bearing, column_m in enumerate(near_m.T):
            told = column_m[np.isfinite(column_m)]
            if len(told) >= _SHARE * len(column_m) and np.ptp(told) <= _PART_M:
                off_nose_rad = wrap_rad((bearing + 0.5) * math.tau / _BEARINGS)
                found.append(Seen(distance_m=float(told.max()), off_nose_rad=off_nose_rad))
        return min(found, key=lambda seen: seen.distance_m, default=None)


def _profile_m(sweep: Sweep) -> FloatArray:
    """Distance by bearing from grid north: of an echo, or how far it is clear; NaN: not told.

    -> (_BEARINGS,)
    """
    bearing_rad = (np.arange(_BEARINGS) + 0.5) * math.tau / _BEARINGS
    sector = np.mod(bearing_rad - sweep.first_rad, math.tau) // sweep.width_rad
    sector = sector.astype(np.intp)
    said_m = np.where(np.isfinite(sweep.echo_m), sweep.echo_m, sweep.clear_m)
    said_m = np.append(np.where(said_m > 0.0, said_m, np.nan), np.nan)
    return said_m[np.minimum(sector, len(sweep.echo_m))]


def _turned(told_m: FloatArray, sense: float, by_rad: float) -> FloatArray:
    """A profile whose bearings are turned by an angle; sense -1: mirrored first."""
    profile_m = told_m if sense > 0.0 else told_m[::-1]
    return np.roll(profile_m, round(by_rad * _BEARINGS / math.tau))


def _spread_m(profiles_m: list[FloatArray]) -> float:
    """How far profiles are from their median, in the mean; an edge may be one bearing aside."""
    stacked_m = np.array(profiles_m)
    often = np.isfinite(stacked_m).sum(axis=0) > 1
    if not often.any():
        return 0.0
    median_m = np.full(_BEARINGS, np.nan)
    median_m[often] = np.nanmedian(stacked_m[:, often], axis=0)
    beside_m = [np.abs(stacked_m - np.roll(median_m, by)) for by in (-1, 0, 1)]
    return float(np.nanmean(np.minimum(np.fmin.reduce(beside_m), _CLIP_M)))
