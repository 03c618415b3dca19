"""The known map: the terrain seen by the vehicle's scans so far.

The map is a lattice of square cells over the mission's area, in the local frame: rows go to the
north, columns to the east.  Each cell holds an upper bound of the terrain in it: the highest
terrain where a scan saw the cell, the sight line over what hides it where a scan could not see it,
infinity where nothing is known.  What may be concluded from a cell that was not seen follows from
what the radar promises (design section 4, decision 0020).
"""

import hashlib
import io
import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple, final

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from companion.geodesy import LEAST_RADIUS_M, BoolArray, FloatArray

IntArray = NDArray[np.intp]
Window = tuple[slice, slice]  # rows and columns of a lattice, start and stop on it

NOT_SEEN = -math.inf  # the radar answered: sheltered, or out of range
NO_ANSWER = math.nan  # the radar did not answer

_ON_EDGE_M = 1e-3
"""So near below an edge between cells a point is taken to be on it: far above rounding of positions
(1e-9 m), far below what a map resolves."""
_NO_LENGTH = -(2**52)  # millimetres that no length has: 4.5 million km below the sea
RAY_CELLS = 0.3  # between neighbouring rays at the farthest point, in cells
SLACK_CELLS = 1.5
"""Of a sight line, for the lattice alone (`_hidden_bound_m`, `_line_from_one_m`)."""
_REMEMBERED = 16  # scans: plans that are further apart look at the whole map


@dataclass(frozen=True, slots=True)
class Lattice:
    """Where the cells of an array are, in the local frame.  Maps are lattices with values."""

    cell_m: float
    north_min_m: float
    east_min_m: float
    shape: tuple[int, int]
    """Rows and columns."""

    def bare(self) -> "Lattice":
        """The lattice without what a map has in its cells."""
        return Lattice(self.cell_m, self.north_min_m, self.east_min_m, self.shape)

    def cell_of(self, north_m: float, east_m: float) -> tuple[int, int]:
        """Row and column of the cell that holds a point (may lie outside the lattice).

        A mission often begins on an edge between cells: of that, and a millimetre short of it, it
        is the cell to the north or east, whatever the last digits of the position are.
        """
        return (
            math.floor((north_m - self.north_min_m + _ON_EDGE_M) / self.cell_m),
            math.floor((east_m - self.east_min_m + _ON_EDGE_M) / self.cell_m),
        )

    def middles_m(self, window: Window | None = None) -> tuple[FloatArray, FloatArray]:
        """North (rows, 1) and east (1, columns) of the middles of cells, or of all, metres."""
        rows, columns = window or (slice(0, self.shape[0]), slice(0, self.shape[1]))
        north = self.north_min_m + np.arange(rows.start + 0.5, rows.stop) * self.cell_m
        east = self.east_min_m + np.arange(columns.start + 0.5, columns.stop) * self.cell_m
        return north[:, None], east[None, :]

    def about(self, points_ne_m: FloatArray, reach_m: float) -> Window:
        """The cells of the lattice within reach of a rectangle around points.  (N, 2)."""
        corner = np.array([self.north_min_m, self.east_min_m])
        ends = np.stack([points_ne_m.min(axis=0) - reach_m, points_ne_m.max(axis=0) + reach_m])
        first, last = np.floor((ends - corner) / self.cell_m).astype(np.intp)
        rows, columns = np.clip([first, last + 1], 0, self.shape).T.tolist()
        return slice(*rows), slice(*columns)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """The answers of the terrain radar to one scan, on a window of the lattice."""

    row: int
    column: int
    """Lattice index of the window's south-west cell."""
    heights_m: FloatArray  # (rows, columns)
    """Highest terrain of each cell AMSL, NOT_SEEN or NO_ANSWER."""
    radar_nea_m: FloatArray  # (rows, columns, 3)
    """Where the radar was when it answered for each cell (it moves during a scan)."""
    range_m: float
    drift_m: float = 0.0
    """How wrong `radar_nea_m` may be."""
    registration_m: float = 0.0
    """How far an answered cell may lie from its lattice cell (true north is not grid north)."""
    complete: bool = True
    """Whether the radar shows every cell in range of which any ground is in its line of sight.

    Then what it does not show is hidden; else nothing follows from that alone.
    """
    supersedes: bool = False
    """Whether it is all that is known of its window: cells without an answer are unknown again."""

    @property
    def window(self) -> Window:
        """The cells of the map that it is about."""
        rows, columns = self.heights_m.shape
        return slice(self.row, self.row + rows), slice(self.column, self.column + columns)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class KnownMap(Lattice):
    """Upper bound of the terrain, cell by cell."""

    shape: tuple[int, int] = field(init=False)
    upper_m: FloatArray  # (rows, columns)
    seen: BoolArray  # (rows, columns), cells that a scan has seen: nothing more to learn
    registration_m: float = 0.0
    """How far the terrain of a cell may lie from it."""
    given: BoolArray | None = None
    """(rows, columns), cells whose terrain was known in advance, though scans may know better."""
    guess_m: FloatArray | None = None
    """(rows, columns), the terrain as a file tells it for guidance alone; NaN: it does not."""
    changes: tuple[tuple[int, Window], ...] = field(init=False, default=(), compare=False)
    """Of the last scans a name of the map after each, which no other map has, and the cells in
    which it may differ from the one before.  Empty if the map was made in another way."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", self.upper_m.shape)

    @property
    def name(self) -> int | None:
        """What tells it from other maps, None if it has not been made by a scan."""
        return self.changes[-1][0] if self.changes else None

    def changed_since(self, name: int | None) -> Window:
        """The cells in which it may differ from the map of that name: all, if that is too old."""
        names = [version for version, _ in self.changes]
        if name not in names:
            return slice(0, self.shape[0]), slice(0, self.shape[1])
        windows = [window for _, window in self.changes[names.index(name) + 1 :]]
        rows, columns = (
            slice(min((w[k].start for w in windows), default=0),
                  max((w[k].stop for w in windows), default=0))
            for k in (0, 1)
        )  # fmt: skip
        return rows, columns

    @property
    def surveyed(self) -> BoolArray:
        """The cells in which `upper_m` is terrain: seen, or known in advance; not a sight line."""
        return self.seen if self.given is None else self.seen | self.given

    def is_known(self, north_m: float, east_m: float) -> bool:
        """Whether the terrain under a point is bounded."""
        row, column = self.cell_of(north_m, east_m)
        rows, columns = self.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return inside and bool(np.isfinite(self.upper_m[row, column]))

    def with_scan(self, scan: Scan) -> "KnownMap":
        """The map after one more scan: nothing that was known is lost, unless it supersedes it."""
        after = replace(
            self,
            upper_m=self.upper_m.copy(),
            seen=self.seen.copy(),
            registration_m=max(self.registration_m, scan.registration_m),
        )
        upper, seen = after.upper_m[scan.window], after.seen[scan.window]  # views
        now_seen = np.isfinite(scan.heights_m)
        if scan.supersedes:
            upper[:], seen[:] = np.inf, False
        np.copyto(upper, scan.heights_m, where=now_seen)
        seen |= now_seen
        if scan.complete:
            np.copyto(upper, np.minimum(upper, _hidden_bound_m(after, scan)), where=~seen)
        changes = self.changes
        if not changes or scan.heights_m.size > 0:
            window = scan.window if changes else self.changed_since(None)
            layers = after.upper_m, after.seen, after.given, after.guess_m
            held = [layer[window].tobytes() for layer in layers if layer is not None]
            name = hash((repr((changes[-1:], window)), *held))
            changes = *changes[1 - _REMEMBERED :], (name, window)
        object.__setattr__(after, "changes", changes)
        return after

    def with_what_was_given(self, blank: "KnownMap") -> "KnownMap":
        """The same map, and what the blank one was given in advance: files keep only the rest."""
        return replace(self, given=blank.given, guess_m=blank.guess_m)

    def grown(self, by_m: float) -> "KnownMap":
        """The same map for a vehicle that may be so far aside of where it is said to be.

        A plane is: it holds on circles.
        """
        if by_m == 0.0:
            return self
        grown = replace(self, registration_m=self.registration_m + by_m)
        object.__setattr__(grown, "changes", self.changes)
        return grown

    def part(self, rows: slice, columns: slice) -> "KnownMap":
        """The map of some of the rows and columns (start and stop on the map); no copy."""
        return replace(
            self,
            north_min_m=self.north_min_m + rows.start * self.cell_m,
            east_min_m=self.east_min_m + columns.start * self.cell_m,
            upper_m=self.upper_m[rows, columns],
            seen=self.seen[rows, columns],
            given=None if self.given is None else self.given[rows, columns],
            guess_m=None if self.guess_m is None else self.guess_m[rows, columns],
        )

    def squares_m(
        self, centres_ne_m: FloatArray, reach_m: float, *, seen_only: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Squares of cells with all within reach of points; off the map nothing is known.

        seen_only: what is not surveyed has a top of -inf, instead of what may be there.
        (K, 2) -> southern and western edges of the rows and columns, metres, (K, 2, N); a copy of
        the upper bounds, (K, N, N).
        """
        corner, half = [self.north_min_m, self.east_min_m], math.ceil(reach_m / self.cell_m) + 1
        middle = np.floor((centres_ne_m - corner + _ON_EDGE_M) / self.cell_m).astype(np.intp)
        index = middle[:, :, None] + np.arange(-half, half + 1)
        rows, columns = (np.clip(index[:, k], 0, self.shape[k] - 1) for k in (0, 1))
        on_map = index == np.stack([rows, columns], axis=1)
        cells = rows[:, :, None], columns[:, None, :]
        upper = self.upper_m[cells]
        counts = on_map[:, 0, :, None] & on_map[:, 1, None, :] & np.isfinite(upper)
        if seen_only:
            counts &= self.surveyed[cells]
        edges = np.reshape(corner, (2, 1)) + index * self.cell_m
        return edges, np.where(counts, upper, -np.inf if seen_only else np.inf)

    def square_m(
        self, centre_ne_m: tuple[float, float], reach_m: float
    ) -> tuple[float, float, FloatArray]:
        """`squares_m` of one point -> its southern and western edge, metres, and the bounds."""
        half = math.ceil(reach_m / self.cell_m) + 1
        south, west = (at - half for at in self.cell_of(*centre_ne_m))
        size = 2 * half + 1
        rows, columns = (slice(max(at, 0), max(at + size, 0)) for at in (south, west))
        on_map, upper = self.upper_m[rows, columns], np.full((size, size), np.inf)
        upper[max(-south, 0) :, max(-west, 0) :][: len(on_map), : on_map.shape[1]] = on_map
        upper[~np.isfinite(upper)] = np.inf
        return (
            self.north_min_m + south * self.cell_m,
            self.east_min_m + west * self.cell_m,
            upper,
        )


class MapNews(NamedTuple):
    """What a map is to somebody who has an earlier one, without what is the same."""

    part: KnownMap  # of the window
    window: Window  # outside of it nothing has changed
    changes: tuple[tuple[int, Window], ...]  # `KnownMap.changes`, of the whole map

    @staticmethod
    def of(known: KnownMap, since: int | None) -> "MapNews":
        """since: the name of the map that is had; None: none is."""
        window = known.changed_since(since)
        return MapNews(known.part(*window), window, known.changes)

    def after(self, had: KnownMap | None) -> KnownMap:
        """The map; had: that of the name, of the same terrain in advance, unless all is told."""
        known = self.part
        if had is not None and had.changes and self.window != had.changed_since(None):
            upper_m, seen = had.upper_m.copy(), had.seen.copy()
            upper_m[self.window], seen[self.window] = known.upper_m, known.seen
            registration_m = known.registration_m
            known = replace(had, upper_m=upper_m, seen=seen, registration_m=registration_m)
        object.__setattr__(known, "changes", self.changes)
        return known


def empty_map(cell_m: float, north_m: tuple[float, float], east_m: tuple[float, float]) -> KnownMap:
    """A map of an area (minimum, maximum north and east) of which nothing is known."""
    rows = math.ceil((north_m[1] - north_m[0]) / cell_m)
    columns = math.ceil((east_m[1] - east_m[0]) / cell_m)
    return KnownMap(
        cell_m=cell_m,
        north_min_m=north_m[0],
        east_min_m=east_m[0],
        upper_m=np.full((rows, columns), np.inf),
        seen=np.zeros((rows, columns), dtype=bool),
    )


def proven_range_m(known: KnownMap, scan: Scan) -> float:
    """How far the radar did see: what it did not see beyond that may be out of its range."""
    return float(_distances_m(known, scan)[np.isfinite(scan.heights_m)].max(initial=0.0))


def _distances_m(known: KnownMap, scan: Scan) -> FloatArray:
    north, east = known.middles_m(scan.window)
    return np.hypot(north - scan.radar_nea_m[..., 0], east - scan.radar_nea_m[..., 1])


def _hidden_bound_m(seen: KnownMap, scan: Scan) -> FloatArray:
    """Upper bound of what a complete radar could not see although it was within range.

    The steepest sight line from the radar over known terrain before the cell.  -> (rows, columns)
    of the scan's window; +inf where the cell was seen, not answered or perhaps out of range, and
    where ground that is neither known nor hidden may be what hides it.

    Proof.  Let p be any point of the ground in such a cell, and go out from the radar towards it.
    Of all ground met up to p let q be the point that looks highest, the nearest one if there are
    several.  Nothing before q looks as high, so q is in sight.  p is not, or its cell would have
    been shown: so q lies before p and looks higher.  q's cell is within range, for it is hardly
    farther than p's, so a complete radar shows it, no lower than q, or does not answer for it.
    Then p is below the line from the radar over the cell of q, which is known or +inf here; and
    cells that were not shown are not looked at, whatever bound an earlier scan has left there: it
    would lie within the slack of their own line, and stay for ever.
    No step leans on the bound of another hidden cell, so nothing adds up along the ray.

    On the lattice p is up to 0.71 cells from the middle of its cell and the ray up to 0.15 beside
    that, and q up to half a cell from a step of the march: less than a cell together in north and
    in east, and less than 1.5 along the ray.  The march looks at all cells within the slack, and
    takes each as near or as far as the slack allows, whichever is steeper.  Cells that the slack
    would let touch the radar are looked at one by one, from their nearest corner on.

    A radar that moves while it scans counts as the middle of the box that holds it, at its lowest:
    how far it is from there is slack, and the line is as much higher as the highest of it.  What it
    does not show from one place it may have in sight from another, where it hides what is not shown
    from there (7 of 100 rough terrains, after 3 cells of way, had ground above a bound for which
    each place counted by itself).

    The ground curves away below the line (`sight_line_m`).  Refraction bends sight down, too, so
    that more is seen and less is hidden: it is left out.
    """
    north, east = seen.middles_m(scan.window)
    not_seen = np.isneginf(scan.heights_m)
    if not not_seen.any():
        return np.full(not_seen.shape, np.inf)
    radars = scan.radar_nea_m[not_seen]
    low, high = radars.min(axis=0), radars.max(axis=0)
    slack = SLACK_CELLS * seen.cell_m + scan.drift_m + scan.registration_m
    slack += 0.5 * math.hypot(high[0] - low[0], high[1] - low[1])
    reach = min(scan.range_m - slack, proven_range_m(seen, scan))
    hidden = not_seen & (_distances_m(seen, scan) < reach)
    result = np.full(hidden.shape, np.inf)
    if hidden.any():
        middles = np.dstack(np.broadcast_arrays(north, east))
        corners = middles[[0, -1], [0, -1]]
        all_ne_m = np.concatenate([corners, [low[:2], high[:2]]])
        around = seen.part(*seen.about(all_ne_m, slack + 2.0 * seen.cell_m))
        south, west = around.cell_of(*corners[0].tolist())
        height, width = hidden.shape
        top = around.upper_m.copy()
        top[south : south + height, west : west + width][not_seen] = -np.inf  # it hides nothing
        bound = sight_line_m(around, top, (low, high), middles[hidden], slack)
        result[hidden] = np.where(np.isneginf(bound), np.inf, np.ceil(bound))
    return result


# --- lines of sight that go out from a radar over a lattice


class March(NamedTuple):
    """Rays towards points, a step of a cell at a time, from the first one on."""

    cells: IntArray  # (steps, rays)
    """What lies under each step, as indices of the ravelled array; off the map the nearest cell."""
    away_m: FloatArray  # (steps,)
    distance_m: FloatArray  # (points,)
    ray_of: IntArray  # (points,)


def march(
    lattice: Lattice, points_ne_m: FloatArray, radar_ne_m: tuple[float, float], beyond: int
) -> March:
    """Go out from a radar to so many cells beyond the farthest of some points, (K, 2).

    Each point has a ray that passes within RAY_CELLS / 2 of it.
    """
    away, cell_m = points_ne_m - np.asarray(radar_ne_m), lattice.cell_m
    distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
    farthest = max(float(distance.max()), cell_m)
    apart_rad = RAY_CELLS * cell_m / farthest
    index = np.rint(np.arctan2(away[:, 1], away[:, 0]) / apart_rad).astype(np.intp)
    first = int(index.min())
    used = np.bincount(index - first) > 0
    azimuth = (np.flatnonzero(used) + first) * apart_rad
    steps = np.arange(1.0, max(math.ceil(farthest / cell_m) + beyond, 2))
    (rows, columns), flat = lattice.shape, np.zeros((len(steps), len(azimuth)), dtype=np.intp)
    sides = (np.cos, lattice.north_min_m, rows), (np.sin, lattice.east_min_m, columns)
    for at_m, (along, least_m, count) in zip(radar_ne_m, sides, strict=True):
        at = np.multiply.outer(steps, along(azimuth))  # in place from here on
        at += (at_m - least_m) / cell_m
        flat *= count
        flat += np.clip(at, 0, count - 1, out=at).astype(np.intp)
    return March(flat, steps * cell_m, distance, (np.cumsum(used) - 1)[index - first])


def sight_line_m(
    lattice: Lattice,
    top_m: FloatArray,
    box_nea_m: tuple[FloatArray, FloatArray],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Altitude of the highest sight line from a radar to points over the terrain between.

    top_m: the highest of each cell.  box_nea_m: the lowest and the highest corner of where the
    radar was, (3,) each; points_ne_m (K, 2), K > 0 -> (K,), metres AMSL; +inf over unknown ground,
    -inf where nothing lies between.  slack_m: 1.5 cells for the lattice, how wrong the radar and
    the terrain may be, and how far the radar was from the middle of its box; the march looks at
    every cell within it of the line.

    Lines are straight over a round earth: seen from the radar, ground at a distance d is d^2 / 2
    R_e lower than its altitude says, and beyond what hides it the line is higher by as much.
    """
    low, high = box_nea_m
    size = 2 * math.ceil(slack_m / lattice.cell_m - 0.5) + 1
    highest_m = scipy.ndimage.maximum_filter(top_m, size=size, mode="nearest")
    north_m, east_m, _ = (0.5 * (low + high)).tolist()
    radar = north_m, east_m, float(low[2])
    near = _slope_over_near_cells(lattice, top_m, radar, points_ne_m, slack_m)
    line = _line_from_one_m(lattice, highest_m, near, radar, points_ne_m, slack_m)
    return float(high[2] - low[2]) + line


def _line_from_one_m(
    lattice: Lattice,
    highest_m: FloatArray,
    near_slope: FloatArray,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """`sight_line_m` from one radar over the highest cells within the slack, and over near ones.

    near_slope: of lines to the points over the cells beside the radar.

    One march along rays whose ends are RAY_CELLS apart serves all points: each takes the ray
    nearest to it, half of that beside it at most.  A line to anywhere in a cell (0.71 cells
    beside its middle) and between two steps (0.5) is then less than a cell from what the march
    looks at in north and in east, which is what the slack of 1.5 cells of a scan leaves for it.

    Slopes are rise over distance less distance / 2 R_e.  Of that a cell has the least, its rise
    the most that the slack allows.  What this leaves out of the sphere is the square of heights
    over R_e: z / (1 - z / R_e) is not below it.
    """
    cell = lattice.cell_m
    cells, away, distance, ray_of = march(lattice, points_ne_m, radar_nea_m[:2], 0)
    rise = highest_m.ravel().take(cells)
    rise -= radar_nea_m[2]
    nearest = np.maximum(away - slack_m, 0.5 * cell)  # nearer ones: one by one
    steepest = rise / (away + slack_m)[:, None]
    rise /= nearest[:, None]
    np.maximum(steepest, rise, out=steepest)
    steepest -= (np.maximum(away - slack_m, 0.0) / (2.0 * LEAST_RADIUS_M))[:, None]
    np.maximum.accumulate(steepest, axis=0, out=steepest)
    before = np.ceil(distance / cell).astype(np.intp) - 1
    slope = steepest[np.clip(before, 1, len(away)) - 1, ray_of]
    slope = np.where(before > 0, np.maximum(slope, near_slope), -np.inf)
    finite = np.isfinite(slope)
    runs = np.maximum(distance - slack_m, 0.0), distance + slack_m
    ends = [np.where(finite, slope, 0.0) * run + run**2 / (2.0 * LEAST_RADIUS_M) for run in runs]
    share = np.minimum(np.maximum(*ends) / LEAST_RADIUS_M, 1.0)
    with np.errstate(divide="ignore"):  # a line that never comes down again is no bound
        line = radar_nea_m[2] + LEAST_RADIUS_M * share / (1.0 - share)
    return np.where(finite, line, slope)


def _slope_over_near_cells(
    lattice: Lattice,
    top_m: FloatArray,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Slope of the steepest line to each point over the cells beside the radar, one by one.

    A cell that rises above the radar does so where it is nearest: at no distance at all if that
    may hold the radar, and then nothing is bounded behind it.  A line to anywhere in a point's
    cell goes over all cells whose circle is in the direction of that cell's.  (K, 2) -> (K,).
    """
    cell, radar_ne_m = lattice.cell_m, np.array(radar_nea_m[:2])
    reach_m = slack_m + cell  # the march takes no cell beyond for nearer than half a cell
    error_m = max(slack_m - SLACK_CELLS * cell, 0.0)
    rows, columns = lattice.about(radar_ne_m[None], reach_m + error_m)
    rise = top_m[rows, columns] - radar_nea_m[2]
    middles = np.broadcast_arrays(*lattice.middles_m((rows, columns)))
    to_cells = np.stack(middles, axis=-1) - radar_ne_m
    gaps = np.maximum(np.abs(to_cells) - 0.5 * cell, 0.0)
    nearest = np.maximum(np.hypot(gaps[..., 0], gaps[..., 1]) - error_m, 0.0)
    is_near = (nearest <= reach_m) & (rise > -np.inf)
    rise, nearest, to_cells = rise[is_near], nearest[is_near], to_cells[is_near]
    corners = np.abs(to_cells) + 0.5 * cell
    farthest = np.hypot(corners[:, 0], corners[:, 1]) + error_m
    with np.errstate(divide="ignore"):
        slopes = rise / np.where(rise > 0.0, nearest, farthest)
    (azimuths, halves, _), (towards, wide, far) = (
        _circles_seen(away, math.sqrt(0.5) * cell + error_m)
        for away in (to_cells, points_ne_m - radar_ne_m)
    )
    turned = np.abs(np.remainder(towards - azimuths[:, None] + math.pi, math.tau) - math.pi)
    is_over = (turned <= halves[:, None] + wide) & (nearest[:, None] <= far)
    return np.where(is_over, slopes[:, None], -np.inf).max(axis=0, initial=-np.inf)


def _circles_seen(away_m: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Azimuths of circles, half the angles that they take up, and their far ends.  (K, 2)."""
    distance = np.hypot(away_m[:, 0], away_m[:, 1])
    half = np.arcsin(np.minimum(radius_m / np.maximum(distance, 1e-9), 1.0))
    half[distance <= radius_m] = math.pi
    return np.arctan2(away_m[:, 1], away_m[:, 0]), half, distance + radius_m


# --- a map as bytes, and what tells it from others


def packed_map(known: KnownMap) -> bytes:
    """The map in numpy's compressed .npz, without what was given in advance."""
    buffer = io.BytesIO()
    lattice = [known.cell_m, known.north_min_m, known.east_min_m, known.registration_m]
    np.savez_compressed(buffer, lattice=lattice, upper_m=known.upper_m, seen=known.seen)
    return buffer.getvalue()


def unpacked_map(data: bytes) -> KnownMap:
    """Decode a map.  ValueError if the data cannot be read."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            cell_m, north_m, east_m, registration_m = held["lattice"].tolist()
            return KnownMap(
                cell_m=cell_m,
                north_min_m=north_m,
                east_min_m=east_m,
                upper_m=held["upper_m"],
                seen=held["seen"],
                registration_m=registration_m,
            )
    except Exception as error:  # whatever damaged bytes lead numpy to: a SyntaxError, too
        raise ValueError("it is cut short or damaged") from error


def digest_of(known: KnownMap) -> str:
    """Digest of a map, rounded to millimetres: the same on every computer."""
    lattice = known.cell_m, known.north_min_m, known.east_min_m, known.registration_m
    digest = hashlib.sha256(repr((known.upper_m.shape, _millimetres(lattice).tolist())).encode())
    digest.update(_millimetres(known.upper_m).astype("<i8").tobytes())
    for cells in (known.seen, known.surveyed):
        digest.update(np.packbits(cells).tobytes())
    if known.guess_m is not None:
        digest.update(_millimetres(known.guess_m).astype("<i8").tobytes())
    return digest.hexdigest()


def _millimetres(lengths_m: ArrayLike) -> NDArray[np.int64]:
    """Whole ones; of what is infinite, none that a length could have."""
    lengths = np.rint(np.asarray(lengths_m, dtype=np.float64) * 1e3)
    return np.where(np.isfinite(lengths), lengths, _NO_LENGTH).astype(np.int64)
