"""Flights of the simulated PX4 multicopter along the curve of px4.md 5, and what they measure.

The curve is sine-generated (heading = 2.405 sin: a figure eight), least radius 50 m, 756 m long,
with 3 m of height up and down.  Errors are taken against the estimator's position, as there.
"""

import math
from typing import Any, Literal, NamedTuple, final

import harness
import numpy as np
from harness import STEP_US, STRONG, ZERO, Vector

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.conditions import GpsConditions
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.plans import Plans
from vehicle_sim.sensors.gps import PX4, Gps

Kind = Literal["position", "position + velocity", "pos + vel + acc", "velocity"]

LENGTH_M = 756.0
GROUND_AMSL_M = 488.0
_SWING_RAD = 2.404825557695773
"""First zero of J0: the curve closes."""
_SPACING_M = 0.25
_HEIGHT_M, _WAVE_M = 20.0, 3.0
_RUN_S = 42.0
_RAMP_M_S2 = 2.0
"""The target gathers speed like this; measuring begins 2 s after, at least after 9 s."""


@final
class Rig(harness.Rig):
    """One PX4 multicopter in still air, without links: what goes in and what comes out."""

    def __init__(self, seed: int = 1, **parameters: float) -> None:
        self.copter = Copter(
            latitude_deg=47.397742,
            longitude_deg=8.545594,
            altitude_amsl_m=GROUND_AMSL_M,
            limits=STRONG,
        )
        self.plans = Plans()
        given = {"SIH_KDV": 0.25, "COM_OBL_RC_ACT": 5.0, **parameters}
        rng = np.random.default_rng(seed)
        self.px4 = PERSONALITIES["px4", "copter"].boot(self.copter, given, self.plans, rng)
        gps = Gps(PX4, np.random.default_rng(seed + 1000))
        super().__init__(self.px4, GROUND_AMSL_M, gps, GpsConditions(fix_type=3, lag_s=0.0))

    def command(self, number: int, *parameters: float, **fields: Any) -> list[int]:
        """The results that came at once: PX4 does not answer everything."""
        return self.answers(number, *parameters, **fields)

    def send(
        self,
        position: Vector | None = None,
        velocity: Vector | None = None,
        acceleration: Vector | None = None,
        yaw_rad: float | None = None,
        *,
        mask: int | None = None,
        frame: int = 1,
        is_global: bool = False,
    ) -> None:
        """A setpoint; what is None is masked, unless a mask is given."""
        wanted = 0x800
        wanted |= 0 if position else 0x007
        wanted |= 0 if velocity else 0x038
        wanted |= 0 if acceleration else 0x1C0
        wanted |= 0x400 if yaw_rad is None else 0
        self.give(
            position or ZERO,
            velocity or ZERO,
            acceleration or ZERO,
            mask=wanted if mask is None else mask,
            frame=frame,
            is_global=is_global,
            yaw_rad=yaw_rad or 0.0,
        )

    def stream(self, seconds: float, rate_hz: float = 20.0, **setpoint: Vector) -> None:
        """The same setpoint again and again."""
        every = round(1e6 / rate_hz / STEP_US)
        for index in range(round(seconds * 1e6 / STEP_US)):
            if index % every == 0:
                self.send(**setpoint)  # type: ignore[arg-type]
            self.step()

    def take_off(self, height_m: float = _HEIGHT_M, seconds: float = 16.0) -> None:
        """Boot, OFFBOARD, arm, climb above the origin."""
        target = (0.0, 0.0, -height_m)
        self.run(5.0)
        self.stream(2.5, position=target)
        self.command(176, 1.0, 6.0)
        self.stream(0.2, position=target)
        self.command(400, 1.0)
        self.stream(seconds, position=target)


@final
class Curve:
    """The closed curve, as points every quarter of a metre."""

    def __init__(self) -> None:
        along = np.arange(0.0, LENGTH_M, _SPACING_M)
        fine = np.arange(0.0, LENGTH_M, _SPACING_M / 16.0) + _SPACING_M / 32.0
        heading = self._heading(fine)
        steps = (_SPACING_M / 16.0) * np.stack((np.cos(heading), np.sin(heading)), axis=1)
        self.points = np.vstack((np.zeros((1, 2)), np.cumsum(steps, axis=0)[15::16]))[:-1]
        self.directions = np.stack(
            (np.cos(self._heading(along)), np.sin(self._heading(along))), axis=1
        )

    @staticmethod
    def _heading(along_m: np.ndarray) -> np.ndarray:
        return _SWING_RAD * np.sin(2.0 * np.pi * along_m / LENGTH_M)

    def at(self, along_m: float, speed_m_s: float) -> tuple[Vector, Vector, Vector, float]:
        """Position, velocity, acceleration (north, east, down) and yaw of the target there."""
        phase = 2.0 * math.pi * along_m / LENGTH_M
        yaw_rad = _SWING_RAD * math.sin(phase)
        turn = _SWING_RAD * math.cos(phase) * 2.0 * math.pi / LENGTH_M
        place = along_m / _SPACING_M
        index, share = int(place), place - int(place)
        size = len(self.points)
        north, east = self.points[index % size] * (1.0 - share) + (
            self.points[(index + 1) % size] * share
        )
        slope = _WAVE_M * math.cos(phase) * 2.0 * math.pi / LENGTH_M
        sine, cosine = math.sin(yaw_rad), math.cos(yaw_rad)
        lateral = speed_m_s * speed_m_s * turn
        return (
            (float(north), float(east), -_HEIGHT_M - _WAVE_M * math.sin(phase)),
            (speed_m_s * cosine, speed_m_s * sine, -speed_m_s * slope),
            (-lateral * sine, lateral * cosine, 0.0),
            yaw_rad,
        )

    def nearest(self, north_m: float, east_m: float, near_m: float) -> tuple[float, float]:
        """Distance along the curve of the nearest point within 60 m of near_m, and across it."""
        size = len(self.points)
        reach = round(60.0 / _SPACING_M)
        indices = (round(near_m / _SPACING_M) + np.arange(-reach, reach + 1)) % size
        offsets = np.array((north_m, east_m)) - self.points[indices]
        best = int(np.argmin(np.einsum("ij,ij->i", offsets, offsets)))
        direction = self.directions[indices[best]]
        offset = offsets[best]
        along_m = near_m + (best - reach) * _SPACING_M + float(direction @ offset)
        return along_m, float(direction[0] * offset[1] - direction[1] * offset[0])


class Tracking(NamedTuple):
    """One row of the table: metres and m/s."""

    along_mean_m: float
    along_max_m: float
    cross_rms_m: float
    cross_max_m: float
    altitude_rms_m: float
    speed_m_s: float


def fly(
    kind: Kind,
    speed_m_s: float,
    rate_hz: float = 20.0,
    *,
    lead_s: float = 0.0,
    carrot_m: float | None = None,
    seed: int = 1,
    **parameters: float,
) -> Tracking:
    """One run of 42 s; lead_s: how far ahead of its time the target is sent.

    carrot_m: position only, this far ahead of the nearest point, whatever the time is.
    """
    rig, curve = Rig(seed, **parameters), Curve()
    rig.take_off()
    every = round(1e6 / rate_hz / STEP_US)
    start_us = rig.now_us
    ramp_s = speed_m_s / _RAMP_M_S2
    settling_s = max(9.0, ramp_s + 2.0)
    samples = list[tuple[float, float, float, float]]()
    reached_m = 0.0
    for index in range(round(_RUN_S * 1e6 / STEP_US)):
        elapsed_s = (rig.now_us - start_us) * 1e-6
        if index % every == 0:
            target_m, moving_m_s = _moved(elapsed_s, speed_m_s)
            target_m += moving_m_s * lead_s
            if carrot_m is not None:
                target_m = reached_m + carrot_m
            _send(rig, curve, kind, target_m, moving_m_s)
        rig.step()
        if index % 5:
            continue
        north_m, east_m, down_m = rig.px4.local_m
        reached_m, cross_m = curve.nearest(north_m, east_m, reached_m)
        target_m, _ = _moved((rig.now_us - start_us) * 1e-6, speed_m_s)
        wanted_down_m = curve.at(reached_m, speed_m_s)[0][2]
        if elapsed_s >= settling_s:
            samples.append((target_m - reached_m, cross_m, down_m - wanted_down_m, rig.speed_m_s))
    along, cross, height, speed = np.array(samples).T
    return Tracking(
        along_mean_m=float(along.mean()),
        along_max_m=float(np.abs(along).max()),
        cross_rms_m=float(np.sqrt((cross**2).mean())),
        cross_max_m=float(np.abs(cross).max()),
        altitude_rms_m=float(np.sqrt((height**2).mean())),
        speed_m_s=float(speed.mean()),
    )


def _moved(elapsed_s: float, speed_m_s: float) -> tuple[float, float]:
    """Distance of the target along the curve, and its speed."""
    ramp_s = speed_m_s / _RAMP_M_S2
    if elapsed_s < ramp_s:
        return 0.5 * _RAMP_M_S2 * elapsed_s * elapsed_s, _RAMP_M_S2 * elapsed_s
    return speed_m_s * (elapsed_s - 0.5 * ramp_s), speed_m_s


def _send(rig: Rig, curve: Curve, kind: Kind, along_m: float, speed_m_s: float) -> None:
    position, velocity, acceleration, yaw_rad = curve.at(along_m, speed_m_s)
    rig.send(
        None if kind == "velocity" else position,
        None if kind == "position" else velocity,
        acceleration if kind == "pos + vel + acc" else None,
        yaw_rad,
    )


class Row(NamedTuple):
    """One row of px4.md 5: what was flown and what the real one did."""

    kind: Kind
    speed_m_s: float
    rate_hz: float
    real: Tracking
    """Along is NaN where it was not measured."""
    lead_s: float = 0.0
    carrot_m: float | None = None

    def fly(self, seed: int = 1) -> Tracking:
        """The same with the simulated one."""
        return fly(
            self.kind,
            self.speed_m_s,
            self.rate_hz,
            lead_s=self.lead_s,
            carrot_m=self.carrot_m,
            seed=seed,
        )


def _row(kind: Kind, speed: float, rate: float, figures: str, lead_s: float = 0.0) -> Row:
    return Row(kind, speed, rate, Tracking(*map(float, figures.split())), lead_s)


def _carrot(carrot_m: float, *figures: float) -> Row:
    real = Tracking(math.nan, math.nan, *figures)
    return Row("position", real.speed_m_s, 20.0, real, carrot_m=carrot_m)


_P: Kind = "position"
_PV: Kind = "position + velocity"
_PVA: Kind = "pos + vel + acc"
TABLE: tuple[Row, ...] = (
    _row(_P, 5.0, 20.0, "5.5 5.8 0.20 0.45 0.13 5.1"),
    _row(_PV, 5.0, 20.0, "0.2 0.7 0.18 0.43 0.16 5.0"),
    _row(_PVA, 5.0, 20.0, "0.3 0.4 0.40 0.80 0.13 5.1"),
    _row(_P, 8.0, 20.0, "8.7 9.0 0.33 0.66 0.13 8.0"),
    _row(_PV, 8.0, 20.0, "0.4 0.7 0.62 1.26 0.12 8.1"),
    _row(_PVA, 8.0, 20.0, "0.5 0.9 0.46 0.96 0.17 8.1"),
    _row(_P, 10.0, 20.0, "10.9 11.2 0.22 0.43 0.14 10.0"),
    _row(_PV, 10.0, 20.0, "0.4 0.6 0.84 1.51 0.11 10.1"),
    _row(_PVA, 10.0, 20.0, "0.7 1.0 0.69 1.10 0.12 10.1"),
    _row(_P, 12.0, 20.0, "15.8 18.8 0.65 1.11 0.23 11.9"),
    _row(_PV, 12.0, 20.0, "5.5 9.2 0.60 0.95 0.12 12.0"),
    _row(_PVA, 12.0, 20.0, "11.0 17.9 0.44 0.96 0.22 11.5"),
    _row("velocity", 8.0, 20.0, "7.3 8.7 0.70 1.34 1.00 8.0"),
    _row(_PV, 8.0, 5.0, "0.9 1.2 0.48 0.70 0.13 8.1"),
    _row(_PVA, 8.0, 5.0, "1.0 1.2 0.41 1.09 0.11 8.0"),
    _row(_PV, 8.0, 10.0, "0.5 0.7 0.40 0.89 0.13 8.0"),
    _row(_PVA, 8.0, 10.0, "0.5 0.8 0.28 0.60 0.16 7.9"),
    _row(_PV, 8.0, 50.0, "0.3 0.7 0.59 1.23 0.22 8.2"),
    _row(_PVA, 8.0, 50.0, "0.3 0.9 0.41 0.81 0.08 8.1"),
    _row(_P, 8.0, 2.0, "10.5 10.8 0.29 0.59 0.09 8.0"),
    _row(_P, 8.0, 5.0, "9.3 9.6 0.21 0.48 0.14 8.0"),
    _row(_PVA, 8.0, 20.0, "-0.8 1.3 0.43 0.87 0.16 8.0", 0.15),
    _row(_PVA, 10.0, 20.0, "0.3 3.1 0.61 1.06 0.07 10.3", 0.15),
    _carrot(5.0, 0.38, 0.75, 0.10, 4.6),
    _carrot(8.0, 0.35, 0.62, 0.10, 7.3),
    _carrot(10.0, 0.30, 0.67, 0.12, 9.2),
)
"""px4.md 5, one row each."""
