"""Estimate of unseen terrain for guidance; never used in proofs.

Where the mission gives terrain for guidance (`KnownMap.guess_m`), that.  Else what has been seen is
continued: Gaussian-process regression (kriging) with a squared exponential covariance, which gives
of all surfaces through what was seen the smoothest one, and falls back to the plain where nothing
is near (Rasmussen and Williams 2006, algorithm 2.1; the peaks of eq. 1 have this very shape).
A sight line that bounds hidden ground bounds the guess too.  Decision 0021.
"""

from dataclasses import dataclass
from typing import TypeVar, final

import numpy as np
import scipy
from numpy.typing import NDArray

from companion.geodesy import BoolArray, FloatArray
from companion.world.known_map import KnownMap

_Any = TypeVar("_Any", bound=np.generic)
_REACH = 6.0  # of R about here: what lies farther away is as it was seen, or plain
_FINE = 1.6  # of R about here: farther away the guess is as coarse as its blocks
_BLOCK = 0.05  # of R: what was seen is averaged over such squares
_RIM = 0.2  # of R: what was seen farther inside says nothing of what was not
_MAX_BLOCKS = 300  # the nearest of them, and as many farther away
_HIGH = 0.2  # of the highest that was seen: only higher ones count far away
_SCALES = (0.15, 0.2, 0.27)  # of R: lengths of the covariance, the likeliest is taken
_NOISE = 0.02  # of the amplitude: cells are as high as the highest in them, not as their middle
_PLAIN = 0.02  # quantile of what was seen: the plain that mountains stand on


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guess:
    """The highest terrain of every cell, as seen, or as guessed; made only where it is read."""

    known: KnownMap
    near: tuple[slice, slice] | None
    """The rows and columns in which what was seen is continued; None: nowhere."""
    continued_m: FloatArray
    """(rows, columns) of these."""

    @staticmethod
    def nothing(known: KnownMap) -> "Guess":
        """What was seen or told, and nothing beyond."""
        return Guess(known=known, near=None, continued_m=np.empty((0, 0)))

    def at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> FloatArray:
        """Metres AMSL, -inf where nothing is guessed.  (N,), (M,), each rising -> (N, M)."""
        known = self.known
        upper, firm = taken(known.upper_m, rows, columns), taken(known.seen, rows, columns)
        if known.given is not None:
            firm = firm | taken(known.given, rows, columns)
        believed = np.where(firm, upper, -np.inf)
        if self.near is not None:
            (south, north), (west, east) = (
                np.searchsorted(index, (part.start, part.stop))
                for index, part in zip((rows, columns), self.near, strict=True)
            )
            here = slice(south, north), slice(west, east)
            first = self.near[0].start, self.near[1].start
            guess = taken(self.continued_m, rows[here[0]] - first[0], columns[here[1]] - first[1])
            np.copyto(believed[here], np.minimum(guess, upper[here]), where=~firm[here])
        if known.guess_m is not None:
            told = taken(known.guess_m, rows, columns)
            np.copyto(believed, np.minimum(told, upper), where=~(firm | np.isnan(told)))
        return believed


def taken(
    cells: NDArray[_Any], rows: NDArray[np.integer], columns: NDArray[np.integer]
) -> NDArray[_Any]:
    """The cells of these rows and columns; no copy of those that lie side by side.  -> (N, M)."""
    for axis, index in enumerate((rows, columns)):
        if len(index) and (np.diff(index) == 1).all():
            side_by_side = slice(index[0], index[-1] + 1)
            cells = cells[side_by_side] if axis == 0 else cells[:, side_by_side]
        else:
            cells = cells.take(index, axis=axis)
    return cells


def guess_of(known: KnownMap, here_ne_m: tuple[float, float], range_m: float) -> Guess:
    """What is guessed, seen from here.

    range_m is R: seen terrain is continued within 6 R of here.  A mountain that was forgotten from
    afar would be an open way, until one comes near.
    """
    near = _within(_REACH * range_m, known, here_ne_m)
    part = known.part(*near)
    told, unseen = part.guess_m, ~part.surveyed
    is_told = told is not None and not (np.isnan(told.min()) and np.isnan(told[unseen]).any())
    if is_told or not unseen.any() or unseen.all():
        return Guess.nothing(known)
    return Guess(known=known, near=near, continued_m=continued_m(part, range_m, here_ne_m))


def guessed_m(known: KnownMap, here_ne_m: tuple[float, float], range_m: float) -> FloatArray:
    """The highest terrain of all cells, as `Guess.at`."""
    rows, columns = (np.arange(count) for count in known.upper_m.shape)
    return guess_of(known, here_ne_m, range_m).at(rows, columns)


def _within(reach_m: float, known: KnownMap, here_ne_m: tuple[float, float]) -> tuple[slice, slice]:
    """The rows and columns within reach of here."""
    reach = round(reach_m / known.cell_m)
    row, column = known.cell_of(*here_ne_m)
    rows, columns = (slice(max(at - reach, 0), max(at + reach, 0)) for at in (row, column))
    return rows, columns


def continued_m(known: KnownMap, range_m: float, here_ne_m: tuple[float, float]) -> FloatArray:
    """What was seen of the terrain, continued where it was not; the plain far from it.

    -> (rows, columns), metres AMSL, at the middles of the cells: between those of the blocks by
    cubic interpolation; far from here, of the blocks.
    """
    size = max(round(_BLOCK * range_m / known.cell_m), 1)
    height, seen = _blocks(known, size)
    rows, columns = known.upper_m.shape
    if not seen.any():
        return np.full((rows, columns), -np.inf)
    plain = float(np.quantile(height[seen], _PLAIN))
    across = size * known.cell_m
    high = seen & (height - plain > _HIGH * float(height[seen].max() - plain))
    chosen = _rim(seen, high, _RIM * range_m / across, known, across, here_ne_m)
    if len(chosen) == 0:
        return np.full((rows, columns), plain)
    rise = height[chosen[:, 0], chosen[:, 1]] - plain
    scale, weights = _likeliest(chosen, rise, range_m / across)
    north = _correlation(np.arange(seen.shape[0]), chosen[:, 0], scale)
    east = _correlation(np.arange(seen.shape[1]), chosen[:, 1], scale)
    blocks = (north * weights) @ east.T
    result = plain + blocks.repeat(size, axis=0).repeat(size, axis=1)[:rows, :columns]
    near = _within(_FINE * range_m, known, here_ne_m)
    row, column = (np.arange(n)[part] for n, part in zip((rows, columns), near, strict=True))
    result[near] = plain + _between(_between(blocks, row, size).T, column, size).T
    return result


def _between(blocks: FloatArray, cells: NDArray[np.intp], size: int) -> FloatArray:
    """Values of blocks at rows of cells, `size` to a block, by cubic convolution.

    Keys 1981; at a third of the least length of the covariance, 1 % of its amplitude at most.
    (N, M), (K,) -> (K, M).
    """
    at = (cells + 0.5) / size - 0.5
    first = np.floor(at).astype(np.intp)
    t = at - first
    shares = (
        0.5 * t * ((2.0 - t) * t - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * ((4.0 - 3.0 * t) * t + 1.0),
        0.5 * t * t * (t - 1.0),
    )
    result = np.zeros((len(cells), blocks.shape[1]))
    for k, share in enumerate(shares):
        result += share[:, None] * blocks[np.clip(first + k - 1, 0, len(blocks) - 1)]
    return result


def _blocks(known: KnownMap, size: int) -> tuple[FloatArray, BoolArray]:
    """Means over squares of size x size cells, and whether half of a square was seen."""
    firm = known.surveyed
    terrain = np.where(firm, known.upper_m, 0.0)
    padding = [(0, -count % size) for count in firm.shape]

    def sums(cells: FloatArray) -> FloatArray:
        cells = np.pad(cells, padding)
        strips = cells.reshape(-1, size, cells.shape[1]).sum(axis=1)
        return np.asarray(sum(strips[:, k::size] for k in range(size)))

    count, total = sums(firm.astype(np.float64)), sums(terrain)
    return total / np.maximum(count, 1.0), count >= 0.5 * size * size


def _rim(
    seen: BoolArray,
    high: BoolArray,
    most: float,
    known: KnownMap,
    across_m: float,
    here_ne_m: tuple[float, float],
) -> NDArray[np.intp]:
    """The seen blocks next to what was not seen: all at the rim, every other behind.  (K, 2).

    Nearest first.  Of those that are too many, a fourth of the high ones, where mountains go on.
    """
    inside = scipy.ndimage.distance_transform_edt(seen)
    if seen.all():
        return np.empty((0, 2), dtype=np.intp)
    row, column = np.indices(seen.shape)
    use = seen & (inside <= most) & ((inside <= 1.5) | ((row + column) % 2 == 0))
    chosen = np.argwhere(use)
    here = (np.array(here_ne_m) - (known.north_min_m, known.east_min_m)) / across_m - 0.5
    away = ((chosen - here) ** 2).sum(axis=1)
    chosen = chosen[np.argsort(away, kind="stable")]
    far = chosen[_MAX_BLOCKS:]
    far = far[(far % 2 == 0).all(axis=1) & high[*far.T]][:_MAX_BLOCKS]
    return np.concatenate([chosen[:_MAX_BLOCKS], far])


def _likeliest(
    blocks: NDArray[np.intp], rise_m: FloatArray, range_blocks: float
) -> tuple[float, FloatArray]:
    """The length scale under which what was seen is likeliest, in blocks, and the weights.  (K,).

    blocks: rows and columns, (K, 2).
    Judged by every other of many blocks: the work grows with the third power.
    """
    every = 1 if len(rise_m) < _MAX_BLOCKS // 2 else 2
    some, rise = blocks[:_MAX_BLOCKS:every], rise_m[:_MAX_BLOCKS:every]
    best, likeliest = -np.inf, _SCALES[0] * range_blocks
    for scale in _SCALES:
        factor, weights = _solved(some, rise, scale * range_blocks)
        amplitude2 = max(float(rise @ weights) / len(rise), 1e-12)
        likelihood = -0.5 * len(rise) * np.log(amplitude2) - np.log(np.diag(factor)).sum()
        if likelihood > best:
            best, likeliest = likelihood, scale * range_blocks
    return likeliest, _solved(blocks, rise_m, likeliest)[1]


def _solved(
    blocks: NDArray[np.intp], rise_m: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray]:
    """Cholesky's factor of the covariance of blocks, (K, K), and the weights, (K,)."""
    covariance = _correlation(blocks[:, 0], blocks[:, 0], scale)
    covariance *= _correlation(blocks[:, 1], blocks[:, 1], scale)
    covariance[np.diag_indices(len(rise_m))] += _NOISE**2
    factor = scipy.linalg.cho_factor(covariance, lower=True, check_finite=False)
    return factor[0], scipy.linalg.cho_solve(factor, rise_m, check_finite=False)


def _correlation(at: NDArray[np.integer], of: NDArray[np.integer], scale: float) -> FloatArray:
    """Of rows or columns of blocks, by how many are between.  (K,), (J,) -> (K, J)."""
    apart = np.abs(at[:, None] - of[None, :])
    by_distance = np.exp(-0.5 * (np.arange(apart.max(initial=0) + 1) / scale) ** 2)
    return np.asarray(by_distance.take(apart))
