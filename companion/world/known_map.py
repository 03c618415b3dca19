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
from numpy.typing import ArrayLike, NDArray

from companion.geodesy import BoolArray, FloatArray
from companion.world.lattice import Lattice, Window
from companion.world.sight_lines import SLACK_CELLS, sight_line_m

NOT_SEEN = -math.inf  # the radar answered: sheltered, or out of range
NO_ANSWER = math.nan  # the radar did not answer

_NO_LENGTH = -(2**52)  # millimetres that no length has: 4.5 million km below the sea


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

    def square_m(
        self, centre_ne_m: tuple[float, float], reach_m: float
    ) -> tuple[float, float, FloatArray]:
        """A square of cells with all within reach of a point; off the map nothing is known.

        -> its southern and western edge, metres, and a copy of its upper bounds (N, N).
        """
        row, column = self.cell_of(*centre_ne_m)
        half = math.ceil(reach_m / self.cell_m) + 1
        around, (height, width) = np.arange(-half, half + 1), self.shape
        rows, columns = (row + around)[:, None], (column + around)[None, :]
        on_map = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        upper = self.upper_m[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
        square = np.where(on_map & ~np.isnan(upper), upper, np.inf)
        south_m = self.north_min_m + (row - half) * self.cell_m
        return float(south_m), float(self.east_min_m + (column - half) * self.cell_m), square


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
    slack = SLACK_CELLS * seen.cell_m + scan.drift_m + scan.registration_m
    not_seen = np.isneginf(scan.heights_m)
    reach = min(scan.range_m - slack, proven_range_m(seen, scan))
    hidden = not_seen & (_distances_m(seen, scan) < reach)
    result = np.full(hidden.shape, np.inf)
    if hidden.any():
        middles, radars = np.dstack(np.broadcast_arrays(north, east)), scan.radar_nea_m[hidden]
        corners = middles[[0, -1], [0, -1]]
        all_ne_m = np.concatenate([corners, radars[:, :2]])
        around = seen.part(*seen.about(all_ne_m, slack + 2.0 * seen.cell_m))
        south, west = around.cell_of(*corners[0].tolist())
        height, width = hidden.shape
        top = around.upper_m.copy()
        top[south : south + height, west : west + width][not_seen] = -np.inf  # it hides nothing
        bound = sight_line_m(around, top, radars, middles[hidden], slack)
        result[hidden] = np.where(np.isneginf(bound), np.inf, np.ceil(bound))
    return result


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
    lengths = np.rint(np.asarray(lengths_m, dtype=np.float64) * 1e3)
    return np.where(np.isfinite(lengths), lengths, _NO_LENGTH).astype(np.int64)
