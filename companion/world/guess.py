"""Estimate of unseen terrain for guidance; never used in proofs.

Where the mission gives terrain for guidance (`KnownMap.guess_m`), that.  Else what has been seen is
continued: Gaussian-process regression (kriging) with a squared exponential covariance, which gives
of all surfaces through what was seen the smoothest one, and falls back to the plain where nothing
is near (Rasmussen and Williams 2006, algorithm 2.1; the peaks of eq. 1 have this very shape).
A sight line that bounds hidden ground bounds the guess too.  Decision 0021.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from companion.geodesy import BoolArray, FloatArray
from companion.world.known_map import IntArray, KnownMap, Window

_REACH = 6.0
"""Of R about here, in which seen terrain is continued.  A mountain that was forgotten from afar
would be an open way, until one comes near."""
_BLOCKS_PER_RANGE = 20  # what was seen is averaged over squares so wide
_RIM = 4  # blocks: what was seen farther inside says nothing of what was not
_MAX_BLOCKS = 300  # the nearest of them, and as many farther away
_HIGH = 0.2  # of the highest that was seen: only higher ones count far away
_SCALES = (3.0, 4.0, 5.4)  # blocks: lengths of the covariance, the likeliest is taken
_NOISE = 0.02  # of the amplitude: cells are as high as the highest in them, not as their middle
_PLAIN = 0.02  # quantile of what was seen: the plain that mountains stand on


def believed_m(known: KnownMap, rows: slice, columns: slice) -> FloatArray:
    """The terrain of some cells as it was seen, or else told; -inf elsewhere, metres AMSL."""
    part = known.part(rows, columns)
    if part.guess_m is None:
        return np.where(part.surveyed, part.upper_m, -np.inf)
    guess_m = np.where(np.isnan(part.guess_m), -np.inf, np.minimum(part.guess_m, part.upper_m))
    return np.where(part.surveyed, part.upper_m, guess_m)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Continued:
    """What was seen, continued, within 6 R of here.  Places are counted in half cells of the map.

    So a vertex between cells has even ones, and the middle of a cell odd ones.
    """

    plain_m: float
    seen: IntArray
    """(K, 2), rows and columns of the middles of what it is continued from."""
    weights: FloatArray
    scale: float
    within: tuple[tuple[int, int], tuple[int, int]]
    """The first and last row, and column."""

    def at_m(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Metres AMSL; -inf beyond 6 R.  (N,), (M,), each rising -> (N, M)."""
        result = np.full((len(rows), len(columns)), -np.inf)
        parts = [
            slice(np.searchsorted(at, first), np.searchsorted(at, last, side="right"))
            for at, (first, last) in zip((rows, columns), self.within, strict=True)
        ]
        north, east = (
            _correlation(at[part], of, self.scale)
            for at, part, of in zip((rows, columns), parts, self.seen.T, strict=True)
        )
        result[parts[0], parts[1]] = self.plain_m + (north * self.weights) @ east.T
        return result


@final
class Blocks:
    """The means of what was seen over squares of cells, kept up to date."""

    def __init__(self, shape: tuple[int, int], size: int) -> None:
        """Of a map of which nothing was seen.  shape: of the map; size: of blocks, in cells."""
        self.size = size
        rows, columns = (-(-count // size) for count in shape)
        self.mean_m, self.seen = np.zeros((rows, columns)), np.zeros((rows, columns), dtype=bool)
        """(rows, columns): the means, and whether half of each block was seen."""

    def update(self, known: KnownMap, window: Window) -> None:
        """Take over what is known of a window of the map's cells."""
        size = self.size
        blocks = tuple(slice(axis.start // size, -(-axis.stop // size)) for axis in window)
        part = known.part(*(slice(size * block.start, size * block.stop) for block in blocks))
        rows, columns = (np.arange(0, count, size) for count in part.shape)
        firm = part.surveyed
        count, total = (
            np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
            for values in (firm.astype(np.float64), np.where(firm, part.upper_m, 0.0))
        )
        self.mean_m[blocks] = total / np.maximum(count, 1.0)
        self.seen[blocks] = count >= 0.5 * size * size

    def continued(self, cell: tuple[int, int]) -> Continued | None:
        """How the terrain goes on, seen from a cell; None: nothing was seen, or all."""
        size, reach = self.size, round(_REACH * _BLOCKS_PER_RANGE)
        row, column = (at // size for at in cell)
        rows, columns = (
            slice(max(at - reach, 0), min(max(at + reach, 0), count))
            for at, count in zip((row, column), self.seen.shape, strict=True)
        )
        mean_m, seen = self.mean_m[rows, columns], self.seen[rows, columns]
        if not seen.any() or seen.all():
            return None  # or it is too far off the map
        plain_m = float(np.quantile(mean_m[seen], _PLAIN))
        high = mean_m - plain_m > _HIGH * float(mean_m[seen].max() - plain_m)
        chosen = _rim(seen, high, (row - rows.start, column - columns.start))
        scale, weights = _likeliest(chosen, mean_m[*chosen.T] - plain_m)
        return Continued(
            plain_m=plain_m,
            seen=size * (2 * (chosen + np.array((rows.start, columns.start))) + 1),
            weights=weights,
            scale=2.0 * size * scale,
            within=(
                (2 * size * rows.start, 2 * size * (row + reach)),
                (2 * size * columns.start, 2 * size * (column + reach)),
            ),
        )


def guessed_m(known: KnownMap, here_ne_m: tuple[float, float], range_m: float) -> FloatArray:
    """The terrain of all cells as it was seen, told or guessed, metres AMSL; -inf: not at all.

    range_m is R.
    """
    rows, columns = known.shape
    whole = slice(0, rows), slice(0, columns)
    size = max(round(range_m / (_BLOCKS_PER_RANGE * known.cell_m)), 1)
    believed, blocks = believed_m(known, *whole), Blocks(known.shape, size)
    blocks.update(known, whole)
    goes_on = blocks.continued(known.cell_of(*here_ne_m))
    if goes_on is not None:
        guess = goes_on.at_m(2 * np.arange(rows) + 1, 2 * np.arange(columns) + 1)
        np.copyto(believed, np.minimum(guess, known.upper_m), where=np.isneginf(believed))
    return believed


def _rim(seen: BoolArray, high: BoolArray, block: tuple[int, int]) -> IntArray:
    """The seen blocks next to what was not seen: all at the rim, every other behind.  (K, 2).

    Nearest first.  Of those that are too many, a fourth of the high ones, where mountains go on.
    """
    rim, behind = (
        seen & ~scipy.ndimage.minimum_filter(seen, 2 * by + 1, mode="nearest") for by in (1, _RIM)
    )
    row, column = np.indices(seen.shape)
    chosen = np.argwhere(rim | (behind & ((row + column) % 2 == 0)))
    away = ((chosen - block) ** 2).sum(axis=1)
    chosen = chosen[np.argsort(away, kind="stable")]
    far = chosen[_MAX_BLOCKS:]
    far = far[(far % 2 == 0).all(axis=1) & high[*far.T]][:_MAX_BLOCKS]
    return np.concatenate([chosen[:_MAX_BLOCKS], far])


def _likeliest(blocks: IntArray, rise_m: FloatArray) -> tuple[float, FloatArray]:
    """The length scale under which what was seen is likeliest, in blocks, and the weights.  (K,).

    Judged by every other of many blocks: the work grows with the third power.
    """
    every = 1 if len(rise_m) < _MAX_BLOCKS // 2 else 2
    some, rise = blocks[:_MAX_BLOCKS:every], rise_m[:_MAX_BLOCKS:every]
    best, likeliest = -np.inf, _SCALES[0]
    for scale in _SCALES:
        factor, weights = _solved(some, rise, scale)
        amplitude2 = max(float(rise @ weights) / len(rise), 1e-12)
        likelihood = -0.5 * len(rise) * np.log(amplitude2) - np.log(np.diag(factor)).sum()
        if likelihood > best:
            best, likeliest = likelihood, scale
    return likeliest, _solved(blocks, rise_m, likeliest)[1]


def _solved(blocks: IntArray, rise_m: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Cholesky's factor of the covariance of blocks, (K, K), and the weights, (K,)."""
    rows, columns = np.ptp(blocks, axis=0) + 1
    north, east = (np.exp(-0.5 * (np.arange(1 - n, n) / scale) ** 2) for n in (rows, columns))
    table, key = np.outer(north, east), blocks @ (2 * columns - 1, 1)  # by how far they are apart
    covariance = table.take(key[:, None] - key[None, :] + table.size // 2)
    covariance[np.diag_indices(len(rise_m))] += _NOISE**2
    factor = scipy.linalg.cho_factor(covariance, lower=True, check_finite=False)
    return factor[0], scipy.linalg.cho_solve(factor, rise_m, check_finite=False)


def _correlation(at: IntArray, of: IntArray, scale: float) -> FloatArray:
    """Of rows or columns, by how far they are apart.  (K,), (J,) -> (K, J)."""
    separation = np.abs(at[:, None] - of[None, :])
    by_distance = np.exp(-0.5 * (np.arange(separation.max(initial=0) + 1) / scale) ** 2)
    return np.asarray(by_distance.take(separation))
