"""A horizontal lidar: beams in the plane of the vehicle's body, however it leans.

Of a spinning lidar each beam is measured from where the vehicle is when the beam gets there, of a
sector sensor all at once.  A distance is in metres; inf: no echo came back; NaN: not measured, as
nearer than the least distance.
"""

import cmath
import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.faults import LidarConditions
from vehicle_sim.geodesy import FloatArray
from vehicle_sim.scene import Scene
from vehicle_sim.world import LidarTable

_DUST_M = 3.0
_ABOVE_FEET_M = 0.15
_OFF_SPEED = (0.014, 0.02)  # no motor keeps step with an autopilot: rows of bogus "max" end


@final
class Lidar:
    """The sensor head."""

    def __init__(self, scene: Scene, settings: LidarTable, rng: np.random.Generator) -> None:
        self._scene, self._settings, self._rng = scene, settings, rng
        beams = round(360.0 / settings.step_deg)
        self.angles_rad = np.arange(beams, dtype=np.float64) * (math.tau / beams)
        """Of all beams, clockwise from the vehicle's nose, as it is mounted.  (B,)"""
        self.distances_m = np.full(beams, np.nan)
        """The newest of every beam.  (B,)"""
        self._turns = float(rng.random())
        off = rng.uniform(*_OFF_SPEED) * rng.choice([-1.0, 1.0])
        self._turns_1_s = settings.turns_1_s * (1.0 + float(off))
        self._turned_us = self.middle_us = 0
        """`middle_us` is when the newest sweep was half done."""

    def step(
        self,
        now_us: int,
        vehicle: Vehicle,
        local_m: tuple[float, float],
        conditions: LidarConditions,
    ) -> NDArray[np.intp]:
        """Measure what is due; returns which beams, in order.

        local_m: the vehicle's place; the local frame's north is taken for true north.
        """
        turns = self._turns + (now_us - self._turned_us) * 1e-6 * self._turns_1_s
        count = len(self.angles_rad)
        if self._settings.kind == "sectors":
            fired = np.arange(count if int(turns) > int(self._turns) else 0)
            if len(fired):
                self.middle_us = now_us
        else:
            fired = np.arange(int(self._turns * count), min(int(turns * count), 2 * count)) % count
            self.middle_us = now_us - round(5e5 / self._turns_1_s)
        self._turns, self._turned_us = turns % 1.0, now_us
        if len(fired) and not (conditions.dead or conditions.stuck):
            eye_nea_m = (*local_m, vehicle.altitude_amsl_m + _ABOVE_FEET_M)
            self.distances_m[fired] = self._measured(fired, eye_nea_m, vehicle, conditions)
        return fired[:0] if conditions.dead else fired

    def _measured(
        self,
        fired: NDArray[np.intp],
        eye_nea_m: tuple[float, float, float],
        vehicle: Vehicle,
        conditions: LidarConditions,
    ) -> FloatArray:
        settings, rng = self._settings, self._rng
        angles_rad = self.angles_rad[fired] + conditions.turned_rad
        turned = np.array([np.cos(angles_rad), np.sin(angles_rad)])
        ways = turned.T @ body_axes_neu(vehicle)[:2]
        true_m = self._scene.ray_lengths_m(eye_nea_m, ways, settings.range_m)
        noise, lost, dust = rng.standard_normal(len(fired)), *rng.random((2, len(fired)))
        told_m = true_m + settings.noise_m * noise
        told_m[lost < settings.lost_share] = np.inf
        if conditions.blind:
            told_m[:] = np.inf
        if conditions.dust:
            span_m = min(_DUST_M, settings.range_m) - settings.min_m
            near_m = settings.min_m + rng.random(len(fired)) * span_m
            told_m = np.where(dust < conditions.dust, np.minimum(told_m, near_m), told_m)
        told_m[told_m < settings.min_m] = np.nan
        told_m[told_m > settings.range_m] = np.inf
        return told_m


def body_axes_neu(vehicle: Vehicle) -> FloatArray:
    """Where the body's axes point: forward, right and down, each north, east, up.  -> (3, 3)."""
    sine_r, cosine_r = math.sin(vehicle.roll_rad), math.cos(vehicle.roll_rad)
    sine_p, cosine_p = math.sin(vehicle.pitch_rad), math.cos(vehicle.pitch_rad)
    nose = cmath.rect(1.0, vehicle.heading_rad)  # north + east j
    forward = cosine_p * nose
    right = complex(sine_r * sine_p, cosine_r) * nose
    down = complex(cosine_r * sine_p, -sine_r) * nose
    return np.array(
        [
            (forward.real, forward.imag, sine_p),
            (right.real, right.imag, -sine_r * cosine_p),
            (down.real, down.imag, -cosine_r * cosine_p),
        ]
    )
