"""What stands in a world that is known, and what a near sensor shows of it.

For planning without a vehicle.  All that stands is as tall as the sensor speaks for: a plan view
says everything.  Places and directions are complex numbers here: north + i east.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from companion.geodesy import BoolArray, FloatArray
from companion.world.near_map import Kind, NearSensor, Sweep

SECTORS: dict[Kind, int] = {"obstacle_distance": 72, "distance_sensor": 8}
"""All round, of each kind: what their MAVLink messages have room for."""
_TINY = 1e-12  # m, or m/m: what is less is a point, or parallel
Places = NDArray[np.complex128]


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
