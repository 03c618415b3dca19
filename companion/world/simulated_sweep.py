"""What stands in a world that is known, and what a near sensor shows of it.

For planning without a vehicle.  All that stands is as tall as the sensor speaks for: a plan view
says everything.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.world.lattice import IntArray
from companion.world.near_map import Kind, NearSensor, Sweep

SECTORS: dict[Kind, int] = {"obstacle_distance": 72, "distance_sensor": 8}
"""All round, of each kind: what their MAVLink messages have room for."""
_TINY = 1e-12  # m/m: what is less is parallel


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    """What stands along a line of corners: a tree or post is one, a wall two or more."""

    corners_ne_m: Sequence[tuple[float, float]]
    half_width_m: float = 0.0
    """So far to all sides of the line: the radius of a tree."""
    closed: bool = False
    """A building: the line is a ring."""


@final
class NearScene:
    """All things that stand in a world.  Each is made of pieces: straight, with round ends."""

    def __init__(self, things: Sequence[Thing], *, rate_hz: float = 10.0) -> None:
        """rate_hz: how often a sensor looks around: 10 is what small spinning lidars do."""
        self.things, self.rate_hz = tuple(things), rate_hz
        rows = [row for thing in things for row in _pieces(thing)]
        columns = np.array(rows, dtype=np.float64).reshape(-1, 5)
        self._from, self._along = columns[:, :2], columns[:, 2:4] - columns[:, :2]
        self._half_width_m = columns[:, 4]

    def gaps_m(self, points_ne_m: FloatArray) -> FloatArray:
        """From points to the nearest thing, 0 where they touch.  (P, 2) -> (P,)."""
        gaps = [self._to_pieces(point)[1].min(initial=math.inf) for point in points_ne_m]
        return np.maximum(np.array(gaps, dtype=np.float64), 0.0)

    def sweep(
        self,
        sensor: NearSensor,
        time_s: float,
        place_ne_m: tuple[float, float],
        heading_rad: float,
        speed_m_s: float = 0.0,
    ) -> Sweep:
        """What a sensor shows that measures without an error; it claims those that it has.

        The distance to a convex thing has one least value over the bearings that it takes up.  So
        what is nearest in a sector is on one of its sides, or is the nearest point of a piece.
        """
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        north_m = place_ne_m[0] + cos * sensor.forward_m - sin * sensor.right_m
        east_m = place_ne_m[1] + sin * sensor.forward_m + cos * sensor.right_m
        eye: FloatArray = np.array([north_m, east_m])
        count = SECTORS[sensor.kind]
        width_rad = math.tau / count
        first_rad = heading_rad + sensor.yaw_rad - 0.5 * width_rad
        nearest, gap_m = self._to_pieces(eye)
        near = np.flatnonzero(gap_m <= sensor.range_m)
        sides_m = self._met_m(eye, first_rad + np.arange(float(count)) * width_rad, near)
        least_m = np.minimum(sides_m, np.roll(sides_m, -1))
        away = nearest[near] - eye
        turned_rad = np.arctan2(away[:, 1], away[:, 0]) - first_rad
        sector = np.remainder(turned_rad, math.tau) / width_rad
        np.minimum.at(least_m, np.minimum(sector.astype(np.intp), count - 1), gap_m[near])
        met = (least_m <= sensor.range_m) & (least_m >= sensor.blind_m)
        return Sweep(
            time_s=time_s,
            sensor_ne_m=(north_m, east_m),
            first_rad=first_rad,
            width_rad=width_rad,
            clear_m=np.minimum(np.maximum(least_m, 0.0), sensor.range_m),
            echo_m=np.where(met, least_m, np.inf),
            range_m=sensor.range_m,
            blind_m=sensor.blind_m,
            error_m=sensor.error_m(speed_m_s),
            bearing_error_rad=sensor.bearing_error_rad,
        )

    def _to_pieces(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The nearest place of the line of each piece, and how far its side is.  (K, 2), (K,)."""
        length2 = np.maximum((self._along**2).sum(axis=1), _TINY)
        share = np.clip(((point - self._from) * self._along).sum(axis=1) / length2, 0.0, 1.0)
        nearest = self._from + share[:, None] * self._along
        return nearest, np.hypot(*(nearest - point).T) - self._half_width_m

    def _met_m(self, eye: FloatArray, bearing_rad: FloatArray, near: IntArray) -> FloatArray:
        """How far rays get to the first of some pieces; inf: past all.  (R,) -> (R,)."""
        start, along, half = self._from[near], self._along[near], self._half_width_m[near]
        ways = np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=-1)[:, None, :]  # (R,1,2)
        met = [np.full((len(bearing_rad), 1), np.inf)]
        for end in (start, start + along):  # the circles about the ends
            away = end - eye
            ahead = (ways * away).sum(axis=-1)
            root = half**2 - ((away**2).sum(axis=-1) - ahead**2)
            at = ahead - np.sqrt(np.maximum(root, 0.0))
            met.append(np.where((root >= 0.0) & (at >= 0.0), at, np.inf))
        length_m = np.maximum(np.hypot(*along.T), _TINY)
        unit = along / length_m[:, None]
        left = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
        aside, aside_s = ((eye - start) * left).sum(axis=-1), (ways * left).sum(axis=-1)
        aside_s = np.where(np.abs(aside_s) < _TINY, _TINY, aside_s)
        for side in (-half, half):
            at = (side - aside) / aside_s
            ahead = ((eye - start) * unit).sum(axis=-1) + at * (ways * unit).sum(axis=-1)
            inside = (at >= 0.0) & (ahead >= 0.0) & (ahead <= length_m)
            met.append(np.where(inside, at, np.inf))
        return np.concatenate(met, axis=1).min(axis=1)


def _pieces(thing: Thing) -> list[tuple[float, ...]]:
    """From north and east, to north and east, and the half-width of each."""
    corners = list(thing.corners_ne_m)
    ends = corners[1:] + corners[:1] if thing.closed else corners[1:] or corners
    return [(*a, *b, thing.half_width_m) for a, b in zip(corners, ends, strict=False)]
