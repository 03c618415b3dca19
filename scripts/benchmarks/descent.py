"""A smooth curve made cheaper under the rules that the planner must keep, by gradients.

An augmented Lagrangian over the control points of a clamped cubic B-spline (L-BFGS-B); clearance,
radars, keep-outs, turn radius, climb and dive are bounds at samples, band and map are bounds
of the control points.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from scipy.ndimage import spline_filter
from scipy.optimize import minimize

from companion.campaign import truth
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.route_cost import Rates
from companion.geodesy import FloatArray
from companion.world.radars import Radar
from companion.world.zones import CircleZone

_SAMPLES_PER_POINT = 10


@final
class Smooth:
    """A cubic spline through heights on a square lattice: twice differentiable, and quick."""

    def __init__(self, north_m: FloatArray, east_m: FloatArray, height_m: FloatArray) -> None:
        self.corner_m = np.array([north_m[0], east_m[0]])
        self.cell_m = float(north_m[1] - north_m[0])
        self.coefficients = np.pad(spline_filter(height_m, order=3, mode="nearest"), 2, "edge")

    def at(self, ne_m: FloatArray) -> FloatArray:
        """Height and its derivatives to the north and east.  (S, 2) -> (3, S)."""
        shape = np.asarray(self.coefficients.shape)
        where = np.clip((ne_m - self.corner_m) / self.cell_m, 0.0, shape - 5.0 - 1e-9)
        index = where.astype(np.intp)
        t = where - index
        value = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4,
                          -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6.0  # fmt: skip
        slope = np.stack([-((1 - t) ** 2), 3 * t**2 - 4 * t, -3 * t**2 + 2 * t + 1, t**2])
        slope *= 0.5 / self.cell_m
        span = np.arange(1, 5)
        here = self.coefficients[
            (index[:, 0, None] + span)[:, :, None], (index[:, 1, None] + span)[:, None, :]
        ]
        by_east = np.einsum("sij,jks->kis", here, np.stack([value[..., 1], slope[..., 1]], 1))
        plain, along_e = by_east
        return np.stack([
            np.einsum("is,is->s", plain, value[..., 0]),
            np.einsum("is,is->s", plain, slope[..., 0]),
            np.einsum("is,is->s", along_e, value[..., 0]),
        ])  # fmt: skip


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """How far the bounds are drawn in, so that what the samples miss is kept too."""

    clearance_m: float = 5.0
    radar_m: float = 2.0
    turn: float = 0.002
    climb: float = 0.001


@final
class Problem:
    """Cost and bounds of a curve as functions of its control points, with gradients.

    hard: radars that must not be entered; soft: radars whose exposure is paid for.
    """

    def __init__(
        self,
        world: DrawnWorld,
        surface: Smooth,
        points: int,
        soft: tuple[Radar, ...],
        margins: Margins,
    ) -> None:
        self.world, self.surface, self.margins = world, surface, margins
        self.soft = soft
        self.hard = tuple(r for r in world.task.radars if r not in soft)
        self.zones = world.task.zones
        if any(not isinstance(zone, CircleZone) for zone in self.zones):
            raise ValueError("the optimum is found among circular keep-out zones only")
        self.rates = Rates.of(world)
        count = _SAMPLES_PER_POINT * points
        u = np.linspace(0.0, 1.0, count + 1)
        unit = truth.spline(np.eye(points))
        self.b0, self.b1, self.b2 = unit(u), unit.derivative()(u), unit.derivative(2)(u)
        self.quadrature = np.full(count + 1, 1.0 / count)
        self.quadrature[[0, -1]] *= 0.5

    def cost(
        self, r: FloatArray, v: FloatArray, length: float
    ) -> tuple[float, FloatArray, FloatArray]:
        """Kilometres of level flight, and the gradients by r and v."""
        world = self.world
        speed = np.maximum(np.linalg.norm(v, axis=-1), 1e-9)
        tilt = self.rates.height / (world.ceiling_amsl_m - world.floor_amsl_m)
        rate = 1.0 + tilt * (r[:, 2] - world.floor_amsl_m)
        by_r = np.zeros_like(r)
        by_r[:, 2] = tilt
        for radar in self.soft:
            offset = r - np.asarray(radar.centre_nea_m)
            distance = np.linalg.norm(offset, axis=-1)
            ratio4 = (distance / radar.range_m) ** 4
            seen = 1.0 / (1.0 + ratio4)
            edge = 1.0 / (1.0 + np.exp(np.clip((distance - radar.range_m) / 30.0 - 3.0, -50, 50)))
            rate = rate + self.rates.radar * seen * edge
            slope = -seen * seen * 4.0 * ratio4 / distance * edge - seen * edge * (1 - edge) / 30.0
            by_r += (self.rates.radar * slope / distance)[:, None] * offset
        q = self.quadrature / 1000.0
        uneven = 0.2 * (speed / length - 1.0)  # keeps the parameter even along the curve
        total = float(q @ (rate * speed)) + float(q @ (0.5 * uneven * (speed - length)))
        by_v = (q * (rate + uneven) / speed)[:, None] * v
        return total, by_r * (q * speed)[:, None], by_v

    def bounds(
        self, r: FloatArray, v: FloatArray, a: FloatArray
    ) -> list[tuple[FloatArray, Callable[[FloatArray], tuple[Any, Any, Any]]]]:
        """Each: values (S,), <= 0 where kept, and the pull-back of a gradient to r, v and a."""
        limits, m = self.world.task.limits, self.margins
        z = r[:, 2]
        need, by_n, by_e = self.surface.at(r[:, :2])
        normal = np.stack([by_n, by_e, -np.ones_like(z)], axis=-1) / 1000.0
        result: list[tuple[FloatArray, Callable[[FloatArray], tuple[Any, Any, Any]]]] = [
            ((need + m.clearance_m - z) / 1000.0, lambda w: (w[:, None] * normal, 0.0, 0.0))
        ]
        spheres = [(np.asarray(x.centre_nea_m), x.range_m + m.radar_m, 3) for x in self.hard]
        for zone in self.zones:
            assert isinstance(zone, CircleZone)  # made sure of in __init__
            wide = zone.radius_m + self.world.task.required_clearance_m + m.radar_m
            spheres.append((np.array([zone.north_m, zone.east_m, 0.0]), wide, 2))
        for centre, radius, axes in spheres:
            offset = r - centre
            offset[:, axes:] = 0.0
            distance = np.maximum(np.linalg.norm(offset, axis=-1), 1.0)
            away = -offset / (1000.0 * distance)[:, None]
            result.append(
                ((radius - distance) / 1000.0, lambda w, g=away: (w[:, None] * g, 0.0, 0.0))
            )
        cross = v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]
        flat = np.maximum(np.hypot(v[:, 0], v[:, 1]), 1e-6)
        radius = limits.turn_radius_m * (1.0 + m.turn)
        sign = np.sign(cross) * radius / flat**3
        bend = np.abs(cross) * radius / flat**3

        def turn(w: FloatArray) -> tuple[Any, Any, Any]:
            s, by_flat = w * sign, -3.0 * w * bend / flat**2
            by_v = np.stack(
                [s * a[:, 1] + by_flat * v[:, 0], -s * a[:, 0] + by_flat * v[:, 1], 0.0 * s], -1
            )
            return 0.0, by_v, np.stack([-s * v[:, 1], s * v[:, 0], 0.0 * s], axis=-1)

        result.append((bend - 1.0, turn))
        for up, angle in ((1.0, limits.climb_angle_rad), (-1.0, limits.dive_angle_rad)):
            tangent = math.tan(angle) * (1.0 - m.climb)
            slope = up * v[:, 2] / flat

            def climb(w: FloatArray, s: FloatArray = slope, up: float = up) -> tuple[Any, Any, Any]:
                by_flat = -w * s / flat**2
                by_v = np.stack([by_flat * v[:, 0], by_flat * v[:, 1], up * w / flat], axis=-1)
                return 0.0, by_v, 0.0

            result.append((slope - tangent, climb))
        return result

    def improve(self, control: FloatArray, rounds: int, iterations: int) -> FloatArray:
        """Augmented Lagrangian: control points that cost less and keep the bounds."""
        world = self.world
        limits = world.task.limits
        lower = np.array([limits.north_m[0], limits.east_m[0], world.floor_amsl_m]) + 1e-3
        upper = np.array([limits.north_m[1], limits.east_m[1], world.ceiling_amsl_m]) - 1e-3
        free = np.ones(control.shape, dtype=bool)
        free[0], free[-1, :2] = False, False
        box = [(lower[axis], upper[axis]) for axis in np.nonzero(free)[1]]
        inner = np.clip(control, lower, upper)
        inner[0], inner[-1, :2] = control[0], control[-1, :2]
        control = inner
        multipliers: dict[int, FloatArray] = {}
        stiff, weight = 300.0, self.quadrature * 100.0
        scale = 1000.0

        def lagrangian(x: FloatArray) -> tuple[float, FloatArray]:
            points = control.copy()
            points[free] = x * scale
            r, v, a = self.b0 @ points, self.b1 @ points, self.b2 @ points
            length = float(np.linalg.norm(np.diff(control, axis=0), axis=-1).sum())
            total, by_r, by_v = self.cost(r, v, length)
            by_a = np.zeros_like(r)
            for index, (value, pull) in enumerate(self.bounds(r, v, a)):
                push = np.maximum(value * stiff + multipliers.get(index, 0.0), 0.0)
                total += float(weight @ (push**2)) / (2.0 * stiff)
                if push.any():
                    to_r, to_v, to_a = pull(weight * push)
                    by_r, by_v, by_a = by_r + to_r, by_v + to_v, by_a + to_a
            gradient = self.b0.T @ by_r + self.b1.T @ by_v + self.b2.T @ by_a
            return total, gradient[free] * scale

        for _ in range(rounds):
            done = minimize(
                lagrangian,
                control[free] / scale,
                jac=True,
                method="L-BFGS-B",
                bounds=[(low / scale, high / scale) for low, high in box],
                options={"maxiter": iterations, "maxcor": 20, "ftol": 1e-10, "gtol": 1e-7},
            )
            control = control.copy()
            control[free] = done.x * scale
            r, v, a = self.b0 @ control, self.b1 @ control, self.b2 @ control
            for index, (value, _) in enumerate(self.bounds(r, v, a)):
                multipliers[index] = np.maximum(value * stiff + multipliers.get(index, 0.0), 0.0)
        return control
