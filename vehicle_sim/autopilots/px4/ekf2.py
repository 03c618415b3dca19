"""EKF2 of PX4 as seen from outside: where it believes to be, with GPS, without, and back again.

The inertial sensors are the truth's own increments; what is modelled is the error on top of them.
With GPS the error follows the receiver's noise, smoothed as the filter smooths it.  Without, it
grows as recorded: flags, accuracies and times are those of px4-gps-loss.tlog and px4.md 8.
"""

import math
from typing import Final, final

import numpy as np

from vehicle_sim.autopilots import Estimate
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import around, degrees_east, metres_per_degree
from vehicle_sim.sensors.gps import Fix

FLAGS_NORMAL: Final = 0x37F
"""ESTIMATOR_STATUS.flags in flight with GPS."""
FLAGS_BOOTING: Final = 0x0E5
"""Before GPS is fused: height only, constant-position mode."""
_STILL_FLAG, _HEIGHT_FLAG = 0x080, 0x040
"""Constant position: disarmed; height above ground: not right after take-off or before landing."""
FLAGS_NO_POSITION: Final = 0x365
"""After EKF2_NOAID_TOUT without GPS."""
FLAGS_NOT_FUSING: Final = 0x065
"""After GNSS data fusion has stopped."""

FUSION_STARTS_US: Final = 2_040_000
"""Boot to the first fused GPS: between 1.65 s and 2.65 s of px4-offboard-short.tlog."""
TIMEOUT_US: Final = 5_060_000
"""Loss of GPS to the loss of position: EKF2_NOAID_TOUT 5 s; 80.97 to 86.06 s in the log."""
FUSION_STOPS_US: Final = 7_200_000
"""Loss of GPS to "GNSS data fusion stopped": 80.97 to 88.19 s in the log."""
FUSION_RESTARTS_US: Final = 1_240_000
"""Fix back to "fusion started": 110.97 to 112.20 s in the log."""
POSITION_RETURNS_US: Final = 1_000_000
"""Fusion started to a position that suffices to land by: 112.20 to 113.21 s in the log."""
PRECISE_US: Final = 1_200_000
"""Fusion started to a position that suffices for all else: to 113.4 s."""
RESET_US: Final = 7_000_000
"""A position that is refused for this long is believed after all (source: reset_timeout_max)."""
GATE_M: Final = 5.0
"""Innovation that is refused: about EKF2_GPS_P_GATE (5) standard deviations of what is recorded."""
_GAIN: Final = 0.06
"""Share of an innovation that one fix corrects at 8 Hz: smooths over about two seconds."""
_JUMP_S: Final = 0.25
"""The output follows a reset of the state with this time constant (recorded: 31 m in a second)."""
_SINK_M_S: Final = -0.05
"""The height's error meanwhile: 1.2 m below the truth after 26 s."""
_JUDGE_US: Final = 100_000
_GAP_US: Final = 300_000
"""Fixes come every 125 ms: this much later, they do not."""
_NOISE_M_S: Final = (0.10, 0.10)
"""Standard deviation of the velocity's error in flight, horizontal axis and vertical: hover of
px4-offboard-8mps.tlog, whose position wanders by 0.13 m."""
_NOISE_ON_GROUND: Final = 0.15
_NOISE_S: Final = (0.8, 1.5)
_FIX_S: Final = 0.125
_KEPT: Final = math.exp(-_FIX_S / _NOISE_S[0])
_KEPT_UP: Final = math.exp(-_FIX_S / _NOISE_S[1])
_FRESH_M_S: Final = _NOISE_M_S[0] * math.sqrt(1.0 - _KEPT * _KEPT)
_FRESH_UP_M_S: Final = _NOISE_M_S[1] * math.sqrt(1.0 - _KEPT_UP * _KEPT_UP)
_BLOCK: Final = 256
_DRIFT_M_S: Final = 0.2
_DRIFT_M_S2: Final = 0.05
"""Without GPS the error starts with this velocity and acceleration: 31 m after 31 s."""


@final
class Ekf2:
    """The estimator: steps an Estimate along with the truth."""

    def __init__(self, vehicle: Vehicle, rng: np.random.Generator) -> None:
        self._rng = rng
        self.lag_s = 0.0
        """What it takes the receiver's latency for: EKF2_GPS_DELAY."""
        self._error_m, self._error_up_m = 0j, 0.0
        """Of the position, north + east j as all horizontal vectors here, and of the height."""
        self._held_m, self._held_up_m = 0j, 0.0
        """What the output has still to make of a jump."""
        self._holding = False
        self._rate_m_s, self._climb_m_s = 0j, 0.0
        self._drift_m_s2 = 0j
        self._drifting = False
        self._noise: list[float] = []
        self._metres_north, self._metres_east = metres_per_degree(vehicle.latitude_deg)
        self._fix_us = self._judge_us = self._good_us = self._refused_us = 0
        self._returned_us: int | None = None
        self._seen_us: int | None = None
        """Since when there are fixes again that are not fused yet."""
        self._booted = False
        self.fusing = False
        """Whether GPS is in use: "GNSS data fusion stopped" and "started" tell its changes."""
        self.estimate = Estimate(
            latitude_deg=vehicle.latitude_deg,
            longitude_deg=vehicle.longitude_deg,
            altitude_amsl_m=vehicle.altitude_amsl_m,
            flags=FLAGS_BOOTING,
            velocity_variance=math.nan,
            horizontal_variance=math.nan,
            horizontal_accuracy_m=0.01,
        )

    def step(
        self, now_us: int, dt_s: float, vehicle: Vehicle, fix: Fix, *, still: bool, low: bool
    ) -> None:
        """One step on; fix is the receiver's newest.

        still: disarmed (constant-position mode); low: in the air, but hardly.
        """
        if fix.time_us != self._fix_us:
            self._fix_us = fix.time_us
            if fix.fix_type >= 3:
                self._take(now_us, vehicle, fix)
                if self.estimate.position_ok:
                    self._stir(still=still)
            else:
                self._seen_us = None
        if now_us >= self._judge_us:
            self._judge_us = now_us + _JUDGE_US
            self._metres_north, self._metres_east = metres_per_degree(vehicle.latitude_deg)
            self._judge(now_us, still=still, low=low)
        if self._booted:
            if now_us - self._good_us > _GAP_US:
                self._drift(dt_s)
            self._error_m += self._rate_m_s * dt_s
            self._error_up_m += self._climb_m_s * dt_s
        error_m, up_m = self._error_m, self._error_up_m
        if self._holding:
            self._let_go(dt_s)
            error_m, up_m = error_m + self._held_m, up_m + self._held_up_m
        estimate, rate_m_s = self.estimate, self._rate_m_s
        estimate.latitude_deg = vehicle.latitude_deg + error_m.real / self._metres_north
        estimate.longitude_deg = around(vehicle.longitude_deg + error_m.imag / self._metres_east)
        estimate.altitude_amsl_m = vehicle.altitude_amsl_m + up_m
        estimate.velocity_north_m_s = vehicle.velocity_north_m_s + rate_m_s.real
        estimate.velocity_east_m_s = vehicle.velocity_east_m_s + rate_m_s.imag
        estimate.velocity_up_m_s = vehicle.velocity_up_m_s + self._climb_m_s

    def precise(self, now_us: int) -> bool:
        """Whether the position is good enough for all modes, and not for landing only."""
        if not self.estimate.position_ok:
            return False
        return self._returned_us is None or now_us - self._returned_us >= PRECISE_US

    def shift(self, north_m: float, east_m: float) -> None:
        """Fault: the position jumps by this much at once."""
        self._error_m += complex(north_m, east_m)

    def _take(self, now_us: int, vehicle: Vehicle, fix: Fix) -> None:
        """A new fix."""
        lag_s = self.lag_s
        # Where the receiver says to be, less where the filter says: to be corrected.
        error_m = complex(
            (fix.latitude_deg - vehicle.latitude_deg) * self._metres_north,
            degrees_east(vehicle.longitude_deg, fix.longitude_deg) * self._metres_east,
        )
        error_m += complex(fix.velocity_north_m_s, fix.velocity_east_m_s) * lag_s
        up_m = fix.altitude_amsl_m + fix.velocity_up_m_s * lag_s - vehicle.altitude_amsl_m
        if not self.estimate.position_ok:
            self._wait(now_us, error_m, up_m)
            return
        innovation_m = error_m - self._error_m
        away_m = math.hypot(innovation_m.real, innovation_m.imag)
        gate_m = GATE_M + 3.0 * (now_us - self._good_us) * 1e-6
        self.estimate.horizontal_variance = away_m / gate_m
        if away_m > gate_m and now_us - self._refused_us < RESET_US:
            self._good_us = now_us  # the receiver's velocity is believed meanwhile
            return
        if away_m > gate_m:
            self._reset(error_m, up_m)
        self._good_us = self._refused_us = now_us
        if self._drifting:
            self._drifting = False
            self._rate_m_s = 0j
        self._error_m += _GAIN * (error_m - self._error_m)
        self._error_up_m += _GAIN * (up_m - self._error_up_m)

    def _wait(self, now_us: int, error_m: complex, up_m: float) -> None:
        """A fix while there is no position: some are wanted before one is believed."""
        if self.fusing and self._returned_us is not None:
            self._good_us = self._refused_us = now_us
            return
        if self._seen_us is None:
            self._seen_us = now_us
        due_us = self._seen_us + FUSION_RESTARTS_US if self._booted else FUSION_STARTS_US
        if now_us < due_us:
            return
        if self._booted:
            self._reset(error_m, up_m)
            self._returned_us = now_us
        else:
            self._booted = True
            self._error_m, self._error_up_m = _GAIN * error_m, _GAIN * up_m
            self.estimate.position_ok = True
        self.fusing = True
        self._good_us = self._refused_us = now_us

    def _reset(self, error_m: complex, up_m: float) -> None:
        """The state jumps to this error; the output follows it."""
        self._held_m += self._error_m - error_m
        self._held_up_m += self._error_up_m - up_m
        self._holding = True
        self._error_m, self._error_up_m = error_m, up_m
        self._rate_m_s, self._climb_m_s = 0j, 0.0
        self._drifting = False
        self._refused_us = self._fix_us

    def _stir(self, *, still: bool) -> None:
        """The errors that are always there: velocities wander, and the position with them."""
        if len(self._noise) < 3:
            self._noise = self._rng.standard_normal(3 * _BLOCK).tolist()
        draw = self._noise.pop
        size = _NOISE_ON_GROUND if still else 1.0
        fresh_m_s = complex(size * _FRESH_M_S * draw(), size * _FRESH_M_S * draw())
        self._rate_m_s = _KEPT * self._rate_m_s + fresh_m_s
        self._climb_m_s = _KEPT_UP * self._climb_m_s + size * _FRESH_UP_M_S * draw()

    def _drift(self, dt_s: float) -> None:
        """A step without GPS: the error grows by itself."""
        if not self._drifting:
            self._drifting = True
            angle_rad = float(self._rng.uniform(0.0, math.tau))
            size = float(self._rng.uniform(0.85, 1.15))
            way = complex(size * math.cos(angle_rad), size * math.sin(angle_rad))
            self._rate_m_s, self._drift_m_s2 = way * _DRIFT_M_S, way * _DRIFT_M_S2
            self._climb_m_s = _SINK_M_S
        self._rate_m_s += self._drift_m_s2 * dt_s

    def _let_go(self, dt_s: float) -> None:
        """The output makes its jump."""
        share = math.exp(-dt_s / _JUMP_S)
        self._held_m, self._held_up_m = self._held_m * share, self._held_up_m * share
        if abs(self._held_m.real) + abs(self._held_m.imag) + abs(self._held_up_m) < 1e-3:
            self._held_m, self._held_up_m, self._holding = 0j, 0.0, False

    def _judge(self, now_us: int, *, still: bool, low: bool) -> None:
        """Flags and accuracies, ten times a second."""
        estimate = self.estimate
        if not self._booted:
            return
        gap_us = now_us - self._good_us
        if estimate.position_ok and gap_us >= TIMEOUT_US:
            estimate.position_ok = False
            self._seen_us = self._returned_us = None
        if self.fusing and gap_us >= FUSION_STOPS_US:
            self.fusing = False
        returned_us = self._returned_us
        if returned_us is not None and not estimate.position_ok:
            estimate.position_ok = self.fusing and now_us - returned_us >= POSITION_RETURNS_US
        estimate.flags = self._flags(still=still, low=low)
        gap_s = max(gap_us * 1e-6 - 0.2, 0.0)
        since_s = now_us * 1e-6 if returned_us is None else (now_us - returned_us) * 1e-6
        settling = math.exp(-since_s / 0.7) * 0.73 if returned_us is not None else 0.0
        grown = 1.0 if returned_us is not None else min(since_s / 8.0, 1.0)
        estimate.horizontal_accuracy_m = 0.29 * grown + settling + gap_s * (0.06 + 0.0335 * gap_s)
        nothing = not self.fusing
        north, east = abs(self._rate_m_s.real), abs(self._rate_m_s.imag)
        estimate.velocity_variance = math.nan
        if nothing:
            estimate.horizontal_variance = math.nan
        else:
            estimate.velocity_variance = (0.05 + 0.5 * (north + east)) * math.exp(-gap_s)

    def _flags(self, *, still: bool, low: bool) -> int:
        """ESTIMATOR_STATUS.flags."""
        if not self.fusing:
            return FLAGS_NOT_FUSING
        if not self.estimate.position_ok and self._returned_us is None:
            return FLAGS_NO_POSITION
        flags = FLAGS_NORMAL | (_STILL_FLAG if still else 0)
        return flags & ~_HEIGHT_FLAG if low else flags
