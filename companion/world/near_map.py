"""What horizontal lidars and other sensors show of near things: cells free, occupied, unknown.

Such a sensor sees a slab: what stands at the height of its beams.  A cell is free where beams have
passed over all of it, occupied where something has sent an echo back, at whatever height of the
slab, and unknown else.  What follows from a sweep is what a sensor promises (decision 0022):

- a sector that tells of an echo has nothing nearer than that in it, all across its width, and one
  that is clear has nothing nearer than it says;
- of the sweeps in a row that could have met a thing, fewer than SIGHTINGS miss it;
- the end of a beam is no farther from where it is said to be than `Sweep.error_m`.

Sensors and autopilots send wrong empty sweeps for up to 0.9 s: they do not wipe a thing out.  What
has gone, or was dust, is forgotten by rule.

The vehicle's estimate of where it is drifts, and what stands there drifts through the map with it:
a cell is free for as long as the drift is less than what paths keep for it, since beams have last
passed it.
"""

import collections
import enum
import math
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.ranges import NotNegative, Positive
from companion.world.known_map import NO_ANSWER, IntArray, Lattice, Scan, Window

_NO_GAP = 1e-6  # sectors that are left of a turn that they go all round
_MOST = 255  # counts of sweeps go no farther: they are bytes
_NO_DRIFT_S = 1.0  # from one second to the next `position_error_m` says how wrong the position is
SIGHTINGS = 3  # a cell is free that so many sweeps in a row have passed
_WIPED_AFTER_S = 1.0
"""An occupied cell is free again only if all sweeps over so long have passed it."""
LOOKS = 10  # a cell that so many sweeps from near by have not shown to be free will not be
_NEAR_BY = 0.4  # from within this share of the sensor's range
_SHARP_M = 1.5  # the place of a thing is known that was met by a sector no wider than this there
_STANDING_AFTER_S = 3.0
"""What was met again and again over so long stands there: it is not forgotten."""
FORGOTTEN_AFTER_S = 60.0
"""Anything else that was not met for so long may have gone: the cell is unknown again.

Long enough to fly out of a dead end: what is unknown is an open way.
"""
CELLS_PER_RANGE, _MOST_CELLS = 64, 4e6  # see `cell_for_m`; 28 MB, which a plan is sent
_ALL: Window = slice(None), slice(None)
Kind = Literal["obstacle_distance", "distance_sensor"]  # what the messages of a sensor are called


class Sight(enum.Enum):
    """What the silence of a sensor means, or that it is not silent."""

    SEES = "it saw something"
    NOTHING_THERE = "nothing was in its reach"
    DEAD = "it was dead"
    NEVER_HEARD = "it had not been heard"

    @property
    def is_blind(self) -> bool:
        """Whether nothing is known of what is there now."""
        return self in (Sight.DEAD, Sight.NEVER_HEARD)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """One look around from one place: what each of K sectors side by side says."""

    time_s: float
    """Vehicle time of the measurement, not of the message."""
    sensor_ne_m: tuple[float, float]
    first_rad: float
    """Where the first sector begins, clockwise from grid north; the others follow clockwise."""
    width_rad: float
    """Of each sector; all of them are no more than a full turn."""
    clear_m: FloatArray  # (K,)
    """Nothing stands nearer than this in the sector; 0: it says nothing."""
    echo_m: FloatArray  # (K,)
    """Something stands at this distance somewhere in the sector; inf: nothing was met."""
    range_m: float
    """The sensor sees nothing beyond."""
    blind_m: float
    """Nearer than this nothing is seen, and nothing stands: there the vehicle itself is."""
    error_m: float
    """How far the end of a beam may be from where it is said to be: range and position."""
    bearing_error_rad: float

    def clear_between_m(self, bearing_rad: FloatArray, aside_rad: FloatArray) -> FloatArray:
        """How far all sectors between bearings less and plus so much aside are clear.

        (...) x2 -> (...), metres; 0 where there is no sector.
        """
        ring, turn = self.clear_m, math.tau / self.width_rad  # of as many sectors a turn has room
        if turn - len(ring) > _NO_GAP:
            ring = np.append(ring, 0.0)
        low, high = (
            np.minimum(np.mod((bearing - self.first_rad) / self.width_rad, turn), len(ring) - 1)
            for bearing in (bearing_rad - aside_rad, bearing_rad + aside_rad)
        )
        low, high = low.astype(np.intp), high.astype(np.intp)
        more = (high - low) % len(ring)  # sectors beside the first one
        all_round = (low == high) & (2.0 * aside_rad > self.width_rad)
        more[all_round | (aside_rad >= math.pi)] = len(ring) - 1
        following = np.add.outer(np.arange(len(ring)), np.arange(len(ring))) % len(ring)
        return np.minimum.accumulate(ring[following], axis=1)[low, more]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NearSensor:
    """A sensor that looks about horizontally: how it is mounted, and what it promises."""

    kind: Kind
    component_id: int
    """MAVLink component that sends them."""
    yaw_rad: float = 0.0
    """Where its zero points, clockwise from the nose."""
    forward_m: float = 0.0
    """How far it is mounted before the point whose position the autopilot tells,"""
    right_m: float = 0.0
    """and to the right of it."""
    range_m: Positive
    """It shows everything up to there."""
    blind_m: NotNegative = 0.3
    """Nearer than this it shows nothing: the vehicle itself is there."""
    latency_s: NotNegative = 0.05
    """How long before the time stamp of a message the measurement was, in the middle of a turn."""
    latency_error_s: NotNegative = 0.05
    """How much longer or shorter ago it may have been, for a beam at the ends of the turn, too."""
    range_error_m: NotNegative = 0.1
    """How wrong a distance may be."""
    bearing_error_rad: NotNegative = 0.02
    """How wrong a direction may be, beside the width of a beam."""
    position_error_m: NotNegative = 0.1
    """How wrong the vehicle's position may be from one second to the next."""
    drift_m_s: Positive = 0.02
    """How fast the error of the position changes in the long run.

    A GPS wanders by a metre in a minute: errors of single-frequency receivers have standard
    deviations of 1 to 3 m and are correlated over a minute or some.
    """
    speaks_for_m: Positive = 2.0
    """A beam speaks for what stands so far above and below it, too."""

    def error_m(self, speed_m_s: float) -> float:
        """How far the end of a beam may be from where it is said to be."""
        return self.range_error_m + self.position_error_m + self.latency_error_s * speed_m_s

    def free_for_s(self, navigation_error_m: float) -> float:
        """How long a cell is free: until drift has used up what paths keep for that error."""
        return max(navigation_error_m / self.drift_m_s, _NO_DRIFT_S)


@final
class NearMap:
    """The cells about a flight.  Sweeps are added in place, in the order of their times."""

    def __init__(self, lattice: Lattice, free_for_s: float = 7.5) -> None:
        """A map of which nothing is known.

        free_for_s: what no sweep has passed for so long may hold something: it is unknown again.
        """
        self.lattice, self.free_for_s = lattice, free_for_s
        shape = lattice.shape
        # of each cell: how many sweeps in a row have passed it, until it is free; when the first
        # of them was, and when one has passed it last
        self.passes = np.zeros(shape, dtype=np.uint8)
        self.passed_since_s, self.passed_s = np.full(shape, np.inf), np.full(shape, -np.inf)
        # when something was first met there (inf: nothing was, or it has gone), and last; whether
        # by a sector that tells where it is
        self.met_since_s, self.met_s = np.full(shape, np.inf), np.full(shape, -np.inf)
        self.sharp = np.zeros(shape, dtype=bool)
        # how many sweeps from near by had the cell, or what is before it, in sight; how many in a
        # row had an echo from here, and here no cell that is not free
        self.looks, self.inside = np.zeros((2, *shape), dtype=np.uint8)
        self.changed: Window | None = None  # where something may have since the last scan
        # when and where sweeps were that may have passed a cell last
        self._swept: collections.deque[tuple[float, Window]] = collections.deque()

    def occupied(self, window: Window = _ALL) -> BoolArray:
        """(rows, columns), where something stands, or stood just now."""
        return self.met_since_s[window] < np.inf

    def free(self, window: Window = _ALL) -> BoolArray:
        """(rows, columns), where nothing stands."""
        return (self.passes[window] >= SIGHTINGS) & ~self.occupied(window)

    def gaps_m(self, points_ne_m: FloatArray, within_m: float) -> FloatArray:
        """Distance of points, seen from above, to what stands nearest, metres.  (N, 2) -> (N,).

        Beyond within_m it may be more than that: inf, if nothing stands near any of the points.
        """
        lattice, window = self.lattice, self.lattice.about(points_ne_m, within_m)
        first = window[0].start, window[1].start
        south_west = (np.argwhere(self.occupied(window)) + first) * lattice.cell_m
        south_west += lattice.north_min_m, lattice.east_min_m
        over_m = points_ne_m[:, None] - south_west
        gaps_m = np.maximum(np.maximum(-over_m, over_m - lattice.cell_m), 0.0)  # (N, cells, 2)
        return np.sqrt((gaps_m * gaps_m).sum(axis=2).min(axis=1, initial=math.inf))

    def closed(self, window: Window = _ALL) -> BoolArray:
        """(rows, columns), where something stands, or so near to it that no beam clears the cell.

        No way leads there: unknown cells elsewhere may turn out to be free, and so may those of a
        wide sector in which something stands somewhere.
        """
        looked = self.looks[window] >= LOOKS
        stands = self.occupied(window) & self.sharp[window]
        return stands | (looked & ~self.free(window))

    def scan(self, ground_m: FloatArray, top_m: float) -> Scan:
        """All that is known where something may have changed, as a scan of a known map.

        ground_m: of all cells (rows, columns), what is free is as high; what is closed is as high
        as top_m.
        """
        window, supersedes = self.changed or (slice(0, 0), slice(0, 0)), self.changed is not None
        self.changed = None
        heights = np.where(self.free(window), ground_m[window], NO_ANSWER)
        heights[self.closed(window)] = top_m
        return Scan(
            row=window[0].start,
            column=window[1].start,
            heights_m=heights,
            radar_nea_m=np.zeros((1, 1, 3)),
            range_m=0.0,
            complete=False,
            supersedes=supersedes,
        )

    def tell_again(self, window: Window) -> None:
        """Make these cells part of the next scan."""
        pairs = zip(window, self.changed or window, strict=True)
        rows, columns = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in pairs)
        self.changed = rows, columns

    def expire(self, now_s: float) -> None:
        """Cells that no sweep has passed for too long are unknown.

        So are those that one has passed so much later than now: the clock has begun anew.
        """
        while self._swept and abs(now_s - self._swept[0][0]) > self.free_for_s:
            _, window = self._swept.popleft()
            passes, looks = self.passes[window], self.looks[window]  # views
            old = (passes > 0) & (np.abs(now_s - self.passed_s[window]) > self.free_for_s)
            looks[old & ~self.occupied(window)] = 0  # nor is it closed for that
            passes[old] = 0
            self.tell_again(window)

    def add(self, sweep: Sweep) -> None:
        """One more sweep.

        A cell    that was passed over          that was met       of which it says nothing
        unknown   free after SIGHTINGS          occupied           begins to count passes anew
        free      free                          occupied           free (`expire`)
        occupied  free after SIGHTINGS, over    occupied           unknown after FORGOTTEN_AFTER_S,
                  _WIPED_AFTER_S or longer                         unless it stands there
        """
        now_s, place = sweep.time_s, np.array([sweep.sensor_ne_m])
        self.expire(now_s)
        window = self.lattice.about(place, sweep.range_m + sweep.error_m)
        self._swept.append((now_s, window))
        self.tell_again(window)
        (passed, looked), (met, sharp) = self._passed(sweep, window), self._met(sweep, window)
        occupied, free = self.occupied(window), self.free(window)
        looks, passes = self.looks[window], self.passes[window]  # views, as all of these
        passed_since_s, passed_s = self.passed_since_s[window], self.passed_s[window]
        met_since_s, met_s = self.met_since_s[window], self.met_s[window]

        looks += looked & (looks < _MOST)
        passed &= ~met
        passed_since_s[passed & (passes == 0)] = now_s
        passed_s[passed] = now_s
        passes += passed & (passes < _MOST)
        met_since_s[met] = np.minimum(met_since_s[met], now_s)
        met_s[met] = now_s
        passes[met | ~(passed | free)] = 0

        wiped = occupied & (passes >= SIGHTINGS) & (now_s - passed_since_s >= _WIPED_AFTER_S)
        gone = occupied & ~wiped & (now_s - met_s >= FORGOTTEN_AFTER_S)
        gone &= ~(met_s - met_since_s >= _STANDING_AFTER_S)
        passes[gone] = 0
        met_since_s[wiped | gone] = np.inf
        self.sharp[window] = (self.sharp[window] | sharp) & ~(wiped | gone)

    def _passed(self, sweep: Sweep, window: Window) -> tuple[BoolArray, BoolArray]:
        """The cells of a window that beams have passed all over, and those that were near by.

        Every sector that comes within the errors of a passed cell is clear to beyond its farthest
        corner.  Near by: and nothing stands before them.
        """
        north, east = self.lattice.middles_m(window)
        north, east = north - sweep.sensor_ne_m[0], east - sweep.sensor_ne_m[1]
        away_m, half_m = np.hypot(north, east), math.sqrt(0.5) * self.lattice.cell_m
        around_m = half_m + sweep.error_m
        aside_rad = np.arcsin(around_m / np.maximum(away_m, around_m)) + sweep.bearing_error_rad
        aside_rad[away_m <= around_m] = math.pi
        clear_m = sweep.clear_between_m(np.arctan2(east, north), aside_rad)
        passed: BoolArray = away_m + around_m <= clear_m
        looked: BoolArray = away_m <= _NEAR_BY * sweep.range_m
        looked &= away_m - around_m <= clear_m
        return passed | (away_m + half_m <= sweep.blind_m), looked

    def _met(self, sweep: Sweep, window: Window) -> tuple[BoolArray, BoolArray]:
        """The cells of a window in which something may have sent an echo back, and the sharp ones.

        The nearest echo of a sector blocks its whole arc, but what is known to be free: that stays
        so, as long as there is another place on the arc for the thing to be.  If the only ones lie
        in the outer half of the error, sweep after sweep, it is believed to be in the middle.
        """
        met: BoolArray = np.zeros_like(self.passes[window], dtype=bool)
        sharp, middles = met.copy(), met.copy()
        if not met.size:
            return met, sharp
        row, column, is_inner = self._arcs(sweep, window)
        inside = (row >= 0) & (row < met.shape[0]) & (column >= 0) & (column < met.shape[1])
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        elsewhere = inside & ~self.free(window)[row, column]
        says = np.where(elsewhere.any(axis=(1, 2), keepdims=True), elsewhere, inside)
        met[row[says], column[says]] = True
        middle = inside & is_inner & ~(elsewhere & is_inner).any(axis=(1, 2), keepdims=True)
        middles[row[middle], column[middle]] = True
        count = self.inside[window]
        count += count < _MOST
        count[~middles] = 0
        met |= count >= SIGHTINGS
        echo_m = sweep.echo_m[np.isfinite(sweep.echo_m), None, None]
        says &= echo_m * sweep.width_rad <= _SHARP_M
        sharp[row[says], column[says]] = True
        return met, sharp

    def _arcs(self, sweep: Sweep, window: Window) -> tuple[IntArray, IntArray, BoolArray]:
        """Rows and columns in a window of points close together on the arcs of all echoes.

        And which are in the middle half of the error.  (echoes, away, across) x2, (away, 1).
        """
        lattice, sectors = self.lattice, np.flatnonzero(np.isfinite(sweep.echo_m))[:, None, None]
        echo_m, step_m = sweep.echo_m[sectors], 0.5 * lattice.cell_m
        across_m = sweep.width_rad * float(echo_m.max(initial=0.0))
        across = math.ceil(across_m / step_m) + 1
        along = math.ceil(2.0 * sweep.error_m / step_m) + 1
        off_m = np.linspace(-sweep.error_m, sweep.error_m, along)[:, None]
        share = (np.arange(across) + 0.5) / across
        bearing_rad = sweep.first_rad + (sectors + share) * sweep.width_rad
        north = sweep.sensor_ne_m[0] - lattice.north_min_m + (echo_m + off_m) * np.cos(bearing_rad)
        east = sweep.sensor_ne_m[1] - lattice.east_min_m + (echo_m + off_m) * np.sin(bearing_rad)
        row, column = (
            np.floor(at / lattice.cell_m).astype(np.intp) - part.start
            for at, part in zip((north, east), window, strict=True)
        )
        return row, column, np.abs(off_m) <= 0.5 * sweep.error_m + 1e-9


def cell_for_m(range_m: float, north_m: tuple[float, float], east_m: tuple[float, float]) -> float:
    """Size of the cells for a range and an area: R / 64, but no more than four million of them.

    That is 0.25 m where R is 16 m, half of the safety distance there.
    """
    area_m2 = (north_m[1] - north_m[0]) * (east_m[1] - east_m[0])
    return max(range_m / CELLS_PER_RANGE, math.sqrt(max(area_m2, 0.0) / _MOST_CELLS))


def top_amsl_m(ceiling_amsl_m: float, range_m: float) -> float:
    """How high closed cells are: R above the ceiling, so that no path leads over them."""
    return ceiling_amsl_m + range_m
