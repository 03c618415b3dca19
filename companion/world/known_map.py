"""The known map: the terrain seen by the vehicle's scans so far.

The map is a lattice of square cells over the mission's area, in the local frame.  Each cell
holds an upper bound of the terrain in it: the highest terrain where a scan saw the cell, the
sight line over what hides it where a scan could not see it, infinity where nothing is known.
What may be concluded from a cell that was not seen follows from what the radar promises (design
section 4, decision 0020).
"""

import hashlib
import io
import math
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from companion.geodesy import LEAST_RADIUS_M, BoolArray, FloatArray
from companion.world.lattice import Lattice, Window
from companion.world.rays import Rays, overlooking_line_m

NOT_SEEN = -math.inf  # the radar answered: sheltered, or out of range
NO_ANSWER = math.nan  # the radar did not answer

_NO_LENGTH = -(2**52)
"""Millimetres that no length has: 4.5 million km below the sea."""
_GROUP_CELLS, _GROUP_CELLS_UP = 0.25, 0.1
"""Radars this close, level and up, count as one: what that costs is proven as slack and as height
(`sight_line_m`), and saves a march for each position of a moving radar."""
_SLACK_CELLS = 1.5
"""Of a sight line, for the lattice alone (`_hidden_bound_m`, `_line_from_one_m` say why)."""


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
    whole_width: bool = False
    """Whether each cell that it shows was seen in every direction in which the cell lies."""
    supersedes: bool = False
    """Whether it is all that is known of its window: cells without an answer are unknown again."""


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

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", self.upper_m.shape)

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
        upper, seen = after.upper_m[_window(scan)], after.seen[_window(scan)]  # views
        now_seen = np.isfinite(scan.heights_m)
        if scan.supersedes:
            upper[:], seen[:] = np.inf, False
        np.copyto(upper, scan.heights_m, where=now_seen)
        seen |= now_seen
        if scan.complete:
            np.copyto(upper, np.minimum(upper, _hidden_bound_m(after, scan)), where=~seen)
        elif scan.whole_width:
            np.copyto(upper, np.minimum(upper, _overlooked_bound_m(after, scan)), where=~seen)
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
        return replace(self, registration_m=self.registration_m + by_m)

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
    return _farthest_seen_m(scan, _distances_m(known, scan))


def _farthest_seen_m(scan: Scan, distance_m: FloatArray) -> float:
    return float(distance_m[np.isfinite(scan.heights_m)].max(initial=0.0))


def _distances_m(known: KnownMap, scan: Scan) -> FloatArray:
    north, east = known.middles_m(scan.row, scan.column, scan.heights_m.shape)
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

    The ground curves away below the line (`sight_line_m`).  Refraction bends sight down, too, so
    that more is seen and less is hidden: it is left out.
    """
    north, east = seen.middles_m(scan.row, scan.column, scan.heights_m.shape)
    slack = _SLACK_CELLS * seen.cell_m + scan.drift_m + scan.registration_m
    not_seen = np.isneginf(scan.heights_m)
    distance = _distances_m(seen, scan)
    reach = min(scan.range_m - slack, _farthest_seen_m(scan, distance))
    hidden = not_seen & (distance < reach)
    result = np.full(hidden.shape, np.inf)
    if hidden.any():
        rows, columns = np.nonzero(hidden)
        middles = np.stack([north[rows, 0], east[0, columns]], axis=-1)
        radars = scan.radar_nea_m[rows, columns]
        corners = np.stack([north[[0, -1], 0], east[0, [0, -1]]], axis=-1)
        all_ne_m = np.concatenate([corners, radars[:, :2]])
        part = seen.part(*seen.about(all_ne_m, slack + 2.0 * seen.cell_m))
        around = replace(part, upper_m=part.upper_m.copy())
        south, west = part.cell_of(*corners[0].tolist())
        height, width = hidden.shape
        obstacles = around.upper_m[south : south + height, west : west + width]  # a view of a copy
        obstacles[not_seen] = -np.inf  # it hides nothing
        bound = sight_line_m(around, radars, middles, slack)
        result[hidden] = np.where(np.isneginf(bound), np.inf, np.ceil(bound))
    return result


def _overlooked_bound_m(after: KnownMap, scan: Scan) -> FloatArray:
    """Upper bound of what a radar passed over that is not complete but shows whole cells only.

    Proof.  Let p be any point of the ground in a cell that was not shown.  If all cells that lines
    over the cell can reach at some distance behind it were shown, the line over p leads to one of
    them, and to a point q of it that was seen.  Nothing stands in the way from the radar to q, so p
    is below that line, and q is no higher than its cell.  Between its ends the line is no higher
    than if altitudes were over a plane: straight over a round earth it sags below that, and
    refraction takes away a part of the sag, so nothing is taken off for it.  -> (rows, columns) of
    the scan's window; +inf where nothing behind the cell was seen all across.
    """
    result = np.full(scan.heights_m.shape, np.inf)
    answered = np.nonzero(~np.isnan(scan.heights_m))
    if not len(answered[0]):
        return result
    north, east = after.middles_m(scan.row, scan.column, scan.heights_m.shape)
    middles = np.stack([north[answered[0], 0], east[0, answered[1]]], axis=-1)
    slack = _SLACK_CELLS * after.cell_m + scan.drift_m + scan.registration_m
    window = after.part(*_window(scan))
    for radar_nea_m, above_m, spread_m, members in _groups(
        scan.radar_nea_m[answered], after.cell_m
    ):
        rows, columns = answered[0][members], answered[1][members]
        top = np.full(result.shape, np.inf)  # beyond what was not seen from here nothing is proven
        top[rows, columns] = scan.heights_m[rows, columns]
        top[np.isneginf(top)] = np.inf
        unseen = np.isinf(top[rows, columns])
        if unseen.any() and not unseen.all():
            radar = (*radar_nea_m[:2], radar_nea_m[2] + above_m)
            line = overlooking_line_m(
                window, top, radar, middles[members][unseen], slack + spread_m
            )
            result[rows[unseen], columns[unseen]] = np.ceil(line)
    return result


def sight_line_m(
    known: KnownMap,
    radars_nea_m: FloatArray,
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Altitude of the highest sight line from radars to points over the terrain between.

    radars_nea_m (K, 3), points_ne_m (K, 2) -> (K,), metres AMSL; +inf over unknown ground, -inf
    where nothing lies between.  slack_m: 1.5 cells for the lattice, and how wrong the radar and the
    terrain may be; the march looks at every cell within it of the line.

    Lines are straight over a round earth: seen from the radar, ground at a distance d is d^2 / 2
    R_e lower than its altitude says, and beyond what hides it the line is higher by as much.

    Radars that are close to each other, as on a flight along, count as one in the middle of
    them; how far they are from it is added to the slack.
    """
    groups = _groups(radars_nea_m, known.cell_m)
    slack = slack_m + max((spread for _, _, spread, _ in groups), default=0.0)
    size = 2 * math.ceil(slack / known.cell_m - 0.5) + 1
    highest = scipy.ndimage.maximum_filter(known.upper_m, size=size, mode="nearest")
    filtered = replace(known, upper_m=highest)
    result = np.empty(len(points_ne_m))
    for radar_nea_m, sink, _, members in groups:
        points = points_ne_m[members]
        result[members] = sink + _line_from_one_m(known, filtered, radar_nea_m, points, slack)
    return result


_Group = tuple[tuple[float, float, float], float, float, slice | NDArray[np.intp]]
"""A radar's north, east and altitude; what the highest of the group is above it; how far the
others are from it; and which they are."""


def _groups(radars_nea_m: FloatArray, cell_m: float) -> list[_Group]:
    """Radars that are within a fraction of a cell of each other."""
    if len(radars_nea_m) == 0:
        return []
    low, high = radars_nea_m.min(axis=0), radars_nea_m.max(axis=0)
    fine = np.array([_GROUP_CELLS, _GROUP_CELLS, _GROUP_CELLS_UP]) * cell_m
    key = np.zeros(len(radars_nea_m), dtype=np.intp)
    for axis in np.flatnonzero(high > low):
        bins = ((radars_nea_m[:, axis] - low[axis]) / fine[axis]).astype(np.intp)
        key = key * (int(bins.max()) + 1) + bins
    if not key.any():
        return [_group(radars_nea_m, slice(None))]
    order = np.argsort(key, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(key[order])) + 1)
    return [_group(radars_nea_m[part], part) for part in parts]


def _group(radars_nea_m: FloatArray, members: slice | NDArray[np.intp]) -> _Group:
    """The radar in the middle, as low as the lowest: lines over terrain are steepest from there."""
    low, high = radars_nea_m.min(axis=0), radars_nea_m.max(axis=0)
    middle = 0.5 * (low + high)
    spread = 0.5 * math.hypot(high[0] - low[0], high[1] - low[1])
    radar = (float(middle[0]), float(middle[1]), float(low[2]))
    return radar, float(high[2] - low[2]), spread, members


def _line_from_one_m(
    known: KnownMap,
    highest: KnownMap,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """`sight_line_m` from one radar; `highest` holds the highest cell within the slack.

    One march along rays whose ends are RAY_CELLS apart serves all points: each takes the ray
    nearest to it, half of that beside it at most.  A line to anywhere in a cell (0.71 cells
    beside its middle) and between two steps (0.5) is then less than a cell from what the march
    looks at in north and in east, which is what the slack of 1.5 cells of a scan leaves for it.

    Slopes are rise over distance less distance / 2 R_e.  Of that a cell has the least, its rise
    the most that the slack allows.  What this leaves out of the sphere is the square of heights
    over R_e: z / (1 - z / R_e) is not below it.
    """
    cell = highest.cell_m
    rays = Rays.towards(points_ne_m, radar_nea_m[:2], cell)
    distance = rays.distance_m
    steps = np.arange(1.0, max(math.ceil(rays.farthest_m / cell), 2))
    flat = highest.crossed(radar_nea_m[:2], rays.azimuth_rad, steps)
    rise = highest.upper_m.ravel().take(flat)
    rise -= radar_nea_m[2]
    nearest = np.maximum(steps * cell - slack_m, 0.5 * cell)  # nearer ones: one by one
    steepest = rise / (steps * cell + slack_m)[:, None]
    rise /= nearest[:, None]
    np.maximum(steepest, rise, out=steepest)
    steepest -= (np.maximum(steps * cell - slack_m, 0.0) / (2.0 * LEAST_RADIUS_M))[:, None]
    np.maximum.accumulate(steepest, axis=0, out=steepest)
    before = np.ceil(distance / cell).astype(np.intp) - 1
    slope = steepest[np.clip(before, 1, len(steps)) - 1, rays.ray_of]
    near = _slope_over_near_cells(known, radar_nea_m, points_ne_m, slack_m)
    slope = np.where(before > 0, np.maximum(slope, near), -np.inf)
    finite = np.isfinite(slope)
    runs = np.maximum(distance - slack_m, 0.0), distance + slack_m
    ends = [np.where(finite, slope, 0.0) * run + run**2 / (2.0 * LEAST_RADIUS_M) for run in runs]
    share = np.minimum(np.maximum(*ends) / LEAST_RADIUS_M, 1.0)
    with np.errstate(divide="ignore"):  # a line that never comes down again is no bound
        line = radar_nea_m[2] + LEAST_RADIUS_M * share / (1.0 - share)
    return np.where(finite, line, slope)


def _slope_over_near_cells(
    known: KnownMap,
    radar_nea_m: tuple[float, float, float],
    points_ne_m: FloatArray,
    slack_m: float,
) -> FloatArray:
    """Slope of the steepest line to each point over the cells beside the radar, one by one.

    A cell that rises above the radar does so where it is nearest: at no distance at all if that
    may hold the radar, and then nothing is bounded behind it.  A line to anywhere in a point's
    cell goes over all cells whose circle is in the direction of that cell's.  (K, 2) -> (K,).
    """
    cell = known.cell_m
    reach_m = slack_m + cell  # the march takes no cell beyond for nearer than half a cell
    error_m = max(slack_m - _SLACK_CELLS * cell, 0.0)
    around = math.ceil((reach_m + error_m) / cell) + 1
    row, column = known.cell_of(*radar_nea_m[:2])
    rows, columns = (np.arange(at - around, at + around + 1) for at in (row, column))
    limits = known.upper_m.shape
    tops = known.upper_m[
        np.ix_(np.clip(rows, 0, limits[0] - 1), np.clip(columns, 0, limits[1] - 1))
    ]
    north = known.north_min_m + (rows + 0.5) * cell - radar_nea_m[0]
    east = known.east_min_m + (columns + 0.5) * cell - radar_nea_m[1]
    off = np.abs(north)[:, None], np.abs(east)[None, :]
    nearest = np.maximum(np.hypot(*(np.maximum(x - 0.5 * cell, 0.0) for x in off)) - error_m, 0.0)
    farthest = np.hypot(*(x + 0.5 * cell for x in off)) + error_m
    rise = tops - radar_nea_m[2]
    with np.errstate(divide="ignore"):
        slope = np.where(rise > 0.0, rise / np.where(rise > 0.0, nearest, 1.0), rise / farthest)
    near = np.nonzero((nearest <= reach_m) & (rise > -np.inf))
    to_cells = np.stack([north[near[0]], east[near[1]]], axis=-1)
    to_points = points_ne_m - np.asarray(radar_nea_m[:2])
    (azimuth, half, _), (towards, wide, far) = (
        _circles_seen(away, math.sqrt(0.5) * cell + error_m) for away in (to_cells, to_points)
    )
    result = np.full(len(points_ne_m), -np.inf)
    for each in range(len(azimuth)):
        turned = np.abs(np.remainder(towards - azimuth[each] + math.pi, math.tau) - math.pi)
        at = near[0][each], near[1][each]
        over = (turned <= half[each] + wide) & (nearest[at] <= far)
        np.maximum(result, slope[at], out=result, where=over)
    return result


def _circles_seen(away_m: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Azimuths of circles, half the angles that they take up, and their far ends.  (K, 2)."""
    distance = np.hypot(away_m[:, 0], away_m[:, 1])
    half = np.arcsin(np.minimum(radius_m / np.maximum(distance, 1e-9), 1.0))
    half[distance <= radius_m] = math.pi
    return np.arctan2(away_m[:, 1], away_m[:, 0]), half, distance + radius_m


def _window(scan: Scan) -> Window:
    rows, columns = scan.heights_m.shape
    return slice(scan.row, scan.row + rows), slice(scan.column, scan.column + columns)


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
    lengths = np.asarray(lengths_m, dtype=np.float64)
    known = np.isfinite(lengths)
    return np.where(known, np.rint(np.where(known, lengths, 0.0) * 1e3), _NO_LENGTH).astype(
        np.int64
    )
