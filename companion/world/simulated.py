"""What sensors would show of a world that is known: for planning without a vehicle.

`simulated_scan` is of a terrain radar, over the highest of each cell (`true_map`); `NearScene` has
what stands there, and what a near sensor shows of it.  All that stands is as tall as the sensor
speaks for: a plan view says everything.  Places and directions in it are complex: north + i east.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import LEAST_RADIUS_M, BoolArray, FloatArray
from companion.world.known_map import NOT_SEEN, KnownMap, Lattice, Scan, march
from companion.world.near_map import Kind, NearSensor, Sweep
from companion.world.terrain import Terrain

_NEAR_CELLS = 2.0  # what is so near is always seen: no ray has a step before it
SECTORS: dict[Kind, int] = {"obstacle_distance": 72, "distance_sensor": 8}
"""All round, of each kind: what their MAVLink messages have room for."""
_TINY = 1e-12  # m, or m/m: what is less is a point, or parallel
Places = NDArray[np.complex128]


def true_map(terrain: Terrain, like: Lattice) -> KnownMap:
    """A map of which everything is known: the highest terrain of each cell, in whole metres."""
    south = (like.north_min_m + np.arange(float(like.shape[0])) * like.cell_m)[:, None]
    west = (like.east_min_m + np.arange(float(like.shape[1])) * like.cell_m)[None, :]
    highest = terrain.highest_in_box_m(south, south + like.cell_m, west, west + like.cell_m)
    return KnownMap(
        cell_m=like.cell_m,
        north_min_m=like.north_min_m,
        east_min_m=like.east_min_m,
        upper_m=np.ceil(highest),
        seen=np.ones(highest.shape, dtype=bool),
    )


def simulated_scan(
    truth: KnownMap,
    radar_nea_m: tuple[float, float, float],
    range_m: float,
    terrain: Terrain | None = None,
) -> Scan:
    """What a complete radar at a point sees of the truth (design section 4).

    terrain: the truth is made from it where it is looked at, and the map only says where the cells
    are: so a scan takes as long in a big world as in a small one.
    """
    rows, columns = truth.about(np.array([radar_nea_m[:2]]), range_m)
    part = truth.part(rows, columns)
    part = part if terrain is None else true_map(terrain, part)
    north_m, east_m = part.middles_m()
    away_m = np.hypot(north_m - radar_nea_m[0], east_m - radar_nea_m[1])
    in_range = away_m <= range_m
    seen = in_range & (away_m <= _NEAR_CELLS * part.cell_m)
    if in_range.any():
        seen |= in_range & _in_sight(part, radar_nea_m, in_range)
    return Scan(
        row=rows.start,
        column=columns.start,
        heights_m=np.where(seen, part.upper_m, NOT_SEEN),
        radar_nea_m=np.broadcast_to(np.asarray(radar_nea_m), (*seen.shape, 3)),
        range_m=range_m,
    )


def _in_sight(
    part: KnownMap, radar_nea_m: tuple[float, float, float], wanted: BoolArray
) -> BoolArray:
    """The cells that rise above all before them on some ray.  (rows, columns).

    The ground here is as high as the highest of its cell at every step of a ray, and curves away
    as much as it may.  A cell is seen if it is no lower, as the radar looks, than all that the same
    ray crosses before; so of a cell that is not seen each ray across it has been over one that is,
    and that one hides it (`known_map._hidden_bound_m` builds on it).  On the face of a mountain a
    ray may meet hardly anything but such cells, or none but the first and the last.  Every wanted
    cell is crossed by a ray: they are RAY_CELLS apart at most, and steps of a cell do not jump over
    one.
    """
    rows, columns = np.nonzero(wanted)
    north, east = part.middles_m()
    middles = np.stack([north[rows, 0], east[0, columns]], axis=-1)
    top = np.pad(part.upper_m, 1, constant_values=-np.inf)  # beyond the edge there is nothing
    cell_m = part.cell_m
    wider = Lattice(cell_m, part.north_min_m - cell_m, part.east_min_m - cell_m, top.shape)
    cells, away, _, _ = march(wider, middles, radar_nea_m[:2], 2)
    slope = top.ravel().take(cells)
    slope -= radar_nea_m[2]
    slope /= away[:, None]
    slope -= (away / (2.0 * LEAST_RADIUS_M))[:, None]
    seen = np.zeros(top.shape, dtype=bool)
    seen.ravel()[cells[slope >= np.maximum.accumulate(slope, axis=0)]] = True
    return seen[1:-1, 1:-1]


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
        pieces = list[tuple[complex, complex, float]]()
        for thing in things:
            line = [complex(*corner) for corner in thing.corners_ne_m]
            ends = line[1:] + line[:1] if thing.closed else line[1:] or line
            pieces += [(a, b, thing.half_width_m) for a, b in zip(line, ends, strict=False)]
        begin, end, half = np.array(pieces, dtype=np.complex128).reshape(-1, 3).T
        self._begin, self._length_m, self._half_width_m = begin, np.abs(end - begin), half.real
        self._ahead = (end - begin) / np.maximum(self._length_m, _TINY)  # directions of the pieces

    def gaps_m(self, points_ne_m: FloatArray) -> FloatArray:
        """From points to the nearest thing, 0 where they touch.  (P, 2) -> (P,)."""
        gaps = [self._to_pieces(complex(*point))[1].min(initial=math.inf) for point in points_ne_m]
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
        mounted = cmath.rect(1.0, heading_rad) * complex(sensor.forward_m, sensor.right_m)
        eye, count = complex(*place_ne_m) + mounted, SECTORS[sensor.kind]
        width_rad = math.tau / count
        first_rad = heading_rad + sensor.yaw_rad - 0.5 * width_rad
        nearest, gap_m = self._to_pieces(eye)
        near = gap_m <= sensor.range_m
        sides_m = self._met_m(eye, first_rad + np.arange(float(count)) * width_rad, near)
        least_m = np.minimum(sides_m, np.roll(sides_m, -1))
        turned_rad = np.remainder(np.angle(nearest[near] - eye) - first_rad, math.tau)
        sector = (turned_rad / width_rad).astype(np.intp)
        np.minimum.at(least_m, np.minimum(sector, count - 1), gap_m[near])
        met = (least_m <= sensor.range_m) & (least_m >= sensor.blind_m)
        return Sweep(
            time_s=time_s,
            sensor_ne_m=(eye.real, eye.imag),
            first_rad=first_rad,
            width_rad=width_rad,
            clear_m=np.minimum(np.maximum(least_m, 0.0), sensor.range_m),
            echo_m=np.where(met, least_m, np.inf),
            range_m=sensor.range_m,
            blind_m=sensor.blind_m,
            error_m=sensor.error_m(speed_m_s),
            bearing_error_rad=sensor.bearing_error_rad,
        )

    def _to_pieces(self, point: complex) -> tuple[Places, FloatArray]:
        """The nearest place of the line of each piece, and how far its side is.  (K,) x2."""
        along_m = np.clip(((point - self._begin) * self._ahead.conj()).real, 0.0, self._length_m)
        nearest = self._begin + along_m * self._ahead
        return nearest, np.abs(nearest - point) - self._half_width_m

    def _met_m(self, eye: complex, bearing_rad: FloatArray, near: BoolArray) -> FloatArray:
        """How far rays get to the first of some pieces; inf: past all.  (R,) -> (R,)."""
        begin, ahead, half = self._begin[near], self._ahead[near], self._half_width_m[near]
        length_m, rays = self._length_m[near], np.exp(1j * bearing_rad)[:, None]  # (R, 1)
        met = [np.full((len(rays), 1), np.inf)]
        for end in (begin, begin + length_m * ahead):  # the circles about the ends
            seen = (end - eye) * rays.conj()  # ahead of the eye, and to the right
            root = half**2 - seen.imag**2
            at = seen.real - np.sqrt(np.maximum(root, 0.0))
            met.append(np.where((root >= 0.0) & (at >= 0.0), at, np.inf))
        eyes, turned = (eye - begin) * ahead.conj(), rays * ahead.conj()  # as the pieces have it
        aside = np.where(np.abs(turned.imag) < _TINY, _TINY, turned.imag)
        for side in (-half, half):
            at = (side - eyes.imag) / aside
            along = eyes.real + at * turned.real
            inside = (at >= 0.0) & (along >= 0.0) & (along <= length_m)
            met.append(np.where(inside, at, np.inf))
        return np.concatenate(met, axis=1).min(axis=1)
