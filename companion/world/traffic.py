"""Others in the air: tracks as moving cylinders, claims as straight pieces of space.

Two vehicles are apart if they are so horizontally or vertically.  All of this is sound for
continuous time and whole stretches, not for samples (docs/decisions/0023).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray

CLAIM_S = 1.0
"""How long a stretch has been claimed before it is entered."""
HEARD_S = 0.7
"""Who was not heard for longer may have claimed anything that it can reach since."""
STRAIGHT_M = 1.0
"""How far the path may be from the chord when it is claimed; from later ones, twice that."""
FORGOTTEN_S, CLAIM_FORGOTTEN_S = 60.0, 30.0
"""After a silence of so long an aircraft, or what a vehicle has claimed, counts no more."""
_CUTS = np.linspace(0.0, 1.0, 9)[:, None]
"""Where a claim is cut into pieces: shares of its length, (9, 1)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Separation:
    """Least distances between two vehicles' reported positions: one of the two is kept."""

    horizontal_m: float
    vertical_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """An aircraft, as last reported: a cylinder that moves straight on and grows."""

    name: str
    time_s: float
    """When it was there, by our clock."""
    position_nea_m: tuple[float, float, float]
    velocity_nea_m_s: tuple[float, float, float]
    error_m: float
    error_up_m: float
    """Infinite: it may be at any height."""
    growth_m_s: float
    growth_up_m_s: float
    system: int | None = None
    """MAVLink system id, if it is one that is heard on the link."""

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Centres, radii, half heights.  (N,) -> (N, 3), (N,), (N,)."""
        age_s = np.maximum(times_s - self.time_s, 0.0)
        centre = np.asarray(self.position_nea_m) + age_s[:, None] * self.velocity_nea_m_s
        return (
            centre,
            self.error_m + self.growth_m_s * age_s,
            self.error_up_m + self.growth_up_m_s * age_s,
        )

    def reach_s(self, here_nea_m: Sequence[float], speed_m_s: float, now_s: float) -> float:
        """Earliest time from now on at which it can be met by a vehicle of this speed."""
        age_s = max(now_s - self.time_s, 0.0)
        (north, east, _), (vn, ve, _) = self.position_nea_m, self.velocity_nea_m_s
        gap_m = math.dist((north + age_s * vn, east + age_s * ve), here_nea_m[:2])
        gap_m -= self.error_m + self.growth_m_s * age_s
        closing = math.hypot(vn, ve) + self.growth_m_s + speed_m_s
        return max(gap_m, 0.0) / max(closing, 1e-6)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A straight stretch that a vehicle of ours keeps to until it says otherwise."""

    system: int
    heard_s: float
    begin_nea_m: tuple[float, float, float]
    end_nea_m: tuple[float, float, float]

    def grown_m(self, now_s: float, fastest_m_s: float, longest_m: float) -> float:
        """How far from the stretch it may have claimed, or be, by now; 0 if it was just heard.

        fastest_m_s, longest_m: of any of ours, and of its claims.
        """
        silent_s = now_s - self.heard_s
        return longest_m + fastest_m_s * silent_s if silent_s > HEARD_S else 0.0

    def comes_near(
        self, low_ne_m: Sequence[float], high_ne_m: Sequence[float], kept_m: float
    ) -> bool:
        """Whether it may come nearer to a level box; else all in the box is free of it."""
        ends = zip(self.begin_nea_m, self.end_nea_m, strict=True)
        return all(
            low < max(begin, end) + kept_m and high > min(begin, end) - kept_m
            for low, high, (begin, end) in zip(low_ne_m, high_ne_m, ends, strict=False)
        )


def keeps_apart(
    points_nea_m: FloatArray,
    times_s: FloatArray,
    tracks: Iterable[Track],
    separation: Separation,
    slack_m: float = 0.0,
    share: float = 1.0,
) -> bool:
    """Whether a motion keeps the separation from all tracks, between its samples too.

    points_nea_m (N, 3) at times_s (N,), straight between them to slack_m.  A track may be anywhere
    in its cylinder.  share: of what is to be kept, errors included.
    """
    for track in tracks:
        centre, radius, half = track.at(times_s)
        apart = points_nea_m - centre
        level = _least_norm(apart[:-1, :2], apart[1:, :2])
        low, high = np.sort([apart[:-1, 2], apart[1:, 2]], axis=0)
        up = np.maximum(np.maximum(low, -high), 0.0)
        near = level < share * (separation.horizontal_m + radius[1:]) + slack_m
        if np.any(near & (up < share * (separation.vertical_m + half[1:]) + slack_m)):
            return False
    return True


def _least_norm(start: FloatArray, end: FloatArray) -> FloatArray:
    """Least distance of level segments from the origin.  (..., 2) x2 -> (...)."""
    x, y = start[..., 0], start[..., 1]
    dx, dy = end[..., 0] - x, end[..., 1] - y
    share = -(x * dx + y * dy) / np.maximum(dx * dx + dy * dy, 1e-12)
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    return np.hypot(x + share * dx, y + share * dy)


def free_pieces(
    points_nea_m: FloatArray, claim: Claim, separation: Separation, grown_m: float = 0.0
) -> FloatArray:
    """Which pieces between points keep the separation from a claim.  (N, 3) -> (N - 1,), bool.

    Sound: each piece, straight, as a whole from all of the claimed stretch; too careful by half
    the length of a piece at most.
    """
    begin, end = np.asarray(claim.begin_nea_m), np.asarray(claim.end_nea_m)
    level_m, up_m = separation.horizontal_m + grown_m, separation.vertical_m + grown_m
    kept_m = np.array([level_m, level_m, up_m])
    low, high = np.minimum(begin, end) - kept_m, np.maximum(begin, end) + kept_m
    if (points_nea_m.max(axis=0) <= low).any() or (points_nea_m.min(axis=0) >= high).any():
        return np.ones(len(points_nea_m) - 1, dtype=bool)
    cuts = begin + _CUTS * (end - begin)
    start, stop = points_nea_m[:-1], points_nea_m[1:]
    half_m = 0.5 * np.hypot(*(stop - start).T[:2])
    middle = 0.5 * (start[:, None, :2] + stop[:, None, :2])  # (N, 1, 2)
    level = _least_norm(cuts[:-1, :2] - middle, cuts[1:, :2] - middle) - half_m[:, None]
    bottom, top = np.minimum(cuts[:-1, 2], cuts[1:, 2]), np.maximum(cuts[:-1, 2], cuts[1:, 2])
    over = np.minimum(start[:, 2], stop[:, 2])[:, None] - top
    under = bottom - np.maximum(start[:, 2], stop[:, 2])[:, None]
    near = (level < level_m) & (np.maximum(over, under) < up_m)
    return np.asarray(~near.any(axis=1))


def straight_until(points_nea_m: FloatArray, most_m: float = STRAIGHT_M) -> int:
    """Index of the last point up to which no point is farther than that from the chord there."""
    begin = points_nea_m[0]
    for last in range(len(points_nea_m) - 1, 1, -1):
        chord = points_nea_m[last] - begin
        squared = max(float(chord @ chord), 1e-12)
        offset = points_nea_m[1:last] - begin
        share = np.clip(offset @ chord / squared, 0.0, 1.0)
        if np.linalg.norm(offset - share[:, None] * chord, axis=1).max() <= most_m:
            return last
    return min(1, len(points_nea_m) - 1)
