"""Model of EKF3: the estimate and status of ArduPilot's estimator.

An inertial filter follows the truth closely for some seconds regardless of GPS: the estimate here
is the truth plus an error, which this module models: almost none while GPS is fused, a step when
the filter resets to a receiver that has jumped, a slow drift without GPS, and a frozen position
when it has "stopped aiding".  Times are those of the recorded flight arducopter-gps-loss.tlog
(ardupilot.md 5).
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from vehicle_sim.autopilots import Estimate, Place
from vehicle_sim.autopilots.ardupilot.flat_earth import offset
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import around, degrees_east, metres_per_degree
from vehicle_sim.sensors.gps import Fix

UNINITIALISED, NOTHING_YET = 0x400, 0x000
WITHOUT_GPS, WITH_GPS = 0x0A7, 0x33F
GLITCHING = 0x8000
BEFORE_RESET = 0x8027
"""Attitude, velocity and height, no position: for the last moment before it gives in."""
DEAD_RECKONING = 0x025
"""Attitude, vertical speed and height: horizontal position and velocity have timed out."""

LATENCY_S = 0.1
"""GPS latency that the filter allows for."""
GATE_M, GATE_GROWTH_M_S = 3.75, 0.106
"""Innovation that has a variance ratio of 1, and how fast that grows while GPS is rejected:
13.33 for 50 m at once, 10.53 after 9.5 s."""
GLITCH_SAID_US = 900_000
"""Rejected for so long: the glitch flag; the vehicle's text comes 0.2 s later."""
POSITION_LOST_US = 9_600_000
GIVES_IN_US = 10_290_000
"""Rejected for so long: the position is reset to what GPS says."""
GLITCH_OVER_US = 9_850_000
"""Accepted for so long: the flag is cleared."""
STEADY_US = 7_150_000
"""Without GPS for so long: position and velocity have timed out."""
STOPS_US = 15_050_000
"""Without GPS for so long: "stopped aiding"."""
OUTAGE_US = 1_000_000
"""After a gap of this length the first fix is accepted."""
RESUMES_US = 90_000
FOLLOWS = 0.02
"""Share of a GPS error that is taken over with each fix."""
DRIFT_M_S2 = 0.01


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How a vehicle's estimator starts; microseconds."""

    initialised_us: int
    attitude_us: int
    """Flags 0xA7: attitude, velocities and height."""
    origin_after_fix_us: int
    using_after_fix_us: int


@final
class Ekf3:
    """The estimator; writes the estimate that it is given."""

    def __init__(self, estimate: Estimate, timing: Timing, rng: np.random.Generator) -> None:
        self.estimate = estimate
        self.origin: Place | None = None
        self.aiding = False
        """There is a position in its local frame: LOCAL_POSITION_NED is sent."""
        self.glitching = False
        """GPS is rejected, or was until a moment ago."""
        self.became_origin = False
        """Within this very step."""
        self._timing = timing
        self._fix: Fix | None = None
        self._fix_since_us: int | None = None
        self._heard_us = 0
        self._rejected_since_us: int | None = None
        self._accepted_us = 0
        self._aided_before = False
        self._error_deg = 0j
        """North + east j, as all horizontal vectors here."""
        self._bias_m = 0j
        direction_rad = rng.uniform(0.0, math.tau)
        self._drift_m_s2 = DRIFT_M_S2 * complex(math.cos(direction_rad), math.sin(direction_rad))
        self._rng = rng
        estimate.flags = UNINITIALISED

    @property
    def position_ok(self) -> bool:
        """Whether there is a horizontal position that may be flown by."""
        return self.estimate.position_ok

    # --- each step --------------------------------------------------------------------------------

    def step(self, now_us: int, vehicle: Vehicle, fix: Fix) -> None:
        """Take the sensors' word for what the vehicle does now, and the newest fix."""
        self.became_origin = False
        if fix is not self._fix:
            self._fix = fix
            self._on_fix(now_us, vehicle, fix)
        if (
            not self.aiding
            or self._rejected_since_us is not None
            or now_us - self._heard_us > 500_000
        ):
            self._slow(now_us, vehicle, fix)
        if self.glitching and self._rejected_since_us is None:
            self._watch_recovery(now_us)

    def follow(self, vehicle: Vehicle) -> None:
        """The estimate at the end of a step, when the vehicle has moved."""
        e = self.estimate
        e.altitude_amsl_m = vehicle.altitude_amsl_m
        e.velocity_up_m_s = vehicle.velocity_up_m_s
        if self.aiding:
            e.latitude_deg = vehicle.latitude_deg + self._error_deg.real
            e.longitude_deg = around(vehicle.longitude_deg + self._error_deg.imag)
            e.velocity_north_m_s = vehicle.velocity_north_m_s
            e.velocity_east_m_s = vehicle.velocity_east_m_s
        elif self.origin is None and self._fix_since_us is None:
            e.altitude_amsl_m = 0.0

    # --- GPS --------------------------------------------------------------------------------------

    def _on_fix(self, now_us: int, vehicle: Vehicle, fix: Fix) -> None:
        if fix.fix_type < 3:
            self._fix_since_us = None if not self._aided_before else self._fix_since_us
            return
        if self._fix_since_us is None:
            self._fix_since_us = now_us
        gap_us, self._heard_us = now_us - self._heard_us, now_us
        if not self.aiding:
            if not self._aided_before:
                self.estimate.latitude_deg = fix.latitude_deg
                self.estimate.longitude_deg = fix.longitude_deg
            return
        off_m = self._innovation_m(vehicle, fix)
        size_m = math.hypot(off_m.real, off_m.imag)
        rejected_us = self._rejected_since_us
        since_s = 0.0 if rejected_us is None else (now_us - rejected_us) * 1e-6
        gate_m = GATE_M + GATE_GROWTH_M_S * since_s
        self._tell(size_m / gate_m)
        back = gap_us > OUTAGE_US
        if size_m <= gate_m or back:
            self._accept(now_us, off_m * (1.0 if back else FOLLOWS))
        elif rejected_us is None:
            self._reject(now_us)

    def _innovation_m(self, vehicle: Vehicle, fix: Fix) -> complex:
        """What the fix says beyond what was expected."""
        metres_north, metres_east = metres_per_degree(vehicle.latitude_deg)
        error_deg = self._error_deg
        north_deg = fix.latitude_deg - vehicle.latitude_deg - error_deg.real
        east_deg = degrees_east(vehicle.longitude_deg + error_deg.imag, fix.longitude_deg)
        # half of what the velocity changed by since, since the fix is of a moment ago
        north_m_s = vehicle.velocity_north_m_s - 0.5 * LATENCY_S * vehicle.acceleration_north_m_s2
        east_m_s = vehicle.velocity_east_m_s - 0.5 * LATENCY_S * vehicle.acceleration_east_m_s2
        off_m = complex(north_deg * metres_north, east_deg * metres_east)
        return off_m + LATENCY_S * complex(north_m_s, east_m_s) + self._bias_m

    def _accept(self, now_us: int, shift_m: complex) -> None:
        if self._rejected_since_us is not None:
            self._rejected_since_us = None
            self._accepted_us = now_us
        if not self.estimate.position_ok:
            self.estimate.position_ok = True
            self.estimate.flags = WITH_GPS
        self._shift(shift_m)

    def _shift(self, by_m: complex) -> None:
        """Move the error by this much."""
        metres_north, metres_east = metres_per_degree(self.estimate.latitude_deg)
        self._error_deg += complex(by_m.real / metres_north, by_m.imag / metres_east)

    def _reject(self, now_us: int) -> None:
        self._rejected_since_us = now_us

    def _tell(self, ratio: float) -> None:
        """The figures of EKF_STATUS_REPORT; what noise would make of the speed's is drawn."""
        self.estimate.velocity_variance = 0.004 + 0.016 * self._rng.random()
        self.estimate.horizontal_variance = ratio

    # --- what happens by itself -------------------------------------------------------------------

    def _slow(self, now_us: int, vehicle: Vehicle, fix: Fix) -> None:
        """Starting, rejecting GPS, or without it."""
        if not self.aiding:
            self._start(now_us, vehicle, fix)
            return
        rejected_us = self._rejected_since_us
        if rejected_us is not None:
            since_us = now_us - rejected_us
            if since_us >= GIVES_IN_US and fix.fix_type >= 3:
                self._give_in(now_us, vehicle, fix)
            elif since_us >= POSITION_LOST_US:
                self.estimate.flags = BEFORE_RESET
            elif since_us >= GLITCH_SAID_US and not self.glitching:
                self.glitching = True
                self.estimate.flags = WITH_GPS | GLITCHING
        if fix.fix_type < 3:
            self._without_gps(now_us)

    def _give_in(self, now_us: int, vehicle: Vehicle, fix: Fix) -> None:
        """Believe GPS again: the position jumps."""
        self._accept(now_us, self._innovation_m(vehicle, fix))
        self.estimate.flags = WITH_GPS | GLITCHING
        self._tell(0.017)

    def _watch_recovery(self, now_us: int) -> None:
        if now_us - self._accepted_us >= GLITCH_OVER_US:
            self.glitching = False
            self.estimate.flags = self.estimate.flags & ~GLITCHING

    def _without_gps(self, now_us: int) -> None:
        since_us = now_us - self._heard_us
        self._shift(self._drift_m_s2 * (since_us * 1e-6) * 0.01)
        if since_us >= STOPS_US:
            self.aiding = False
            self._fix_since_us = None
            self._rejected_since_us = None
            self.estimate.flags = WITHOUT_GPS
            self.estimate.position_ok = False
            self.estimate.frozen_altitude_amsl_m = self.estimate.altitude_amsl_m
            self.estimate.velocity_north_m_s = self.estimate.velocity_east_m_s = 0.0
            self.estimate.horizontal_variance = 0.0
        elif since_us >= STEADY_US and self.estimate.position_ok:
            self.estimate.flags = DEAD_RECKONING
            self.estimate.position_ok = False

    def _start(self, now_us: int, vehicle: Vehicle, fix: Fix) -> None:
        timing, e = self._timing, self.estimate
        if e.flags != WITHOUT_GPS:
            if now_us >= timing.attitude_us:
                e.flags = WITHOUT_GPS
            elif now_us >= timing.initialised_us:
                e.flags = NOTHING_YET
        since_us = self._fix_since_us
        if since_us is None or fix.fix_type < 3:
            return
        if self.origin is None and now_us - since_us >= timing.origin_after_fix_us:
            self.origin = e.place
            self.became_origin = True
        wait_us = RESUMES_US if self._aided_before else timing.using_after_fix_us
        if self.origin is not None and now_us - since_us >= wait_us:
            self._begin_aiding(vehicle, fix)

    def _begin_aiding(self, vehicle: Vehicle, fix: Fix) -> None:
        self.aiding = True
        self._aided_before = True
        self._error_deg = 0j
        self._shift(self._innovation_m(vehicle, fix))
        self.follow(vehicle)
        self.estimate.flags = WITH_GPS
        self.estimate.position_ok = True
        self.estimate.frozen_altitude_amsl_m = None
        self._tell(0.0001)

    # --- faults -----------------------------------------------------------------------------------

    def reset(self, north_m: float, east_m: float) -> None:
        """The position jumps by this much and stays there: GPS is now believed to be off by it."""
        self._shift(complex(north_m, east_m))
        self._bias_m += complex(north_m, east_m)

    def move_origin(self, north_m: float, east_m: float, up_m: float) -> None:
        """Put the origin elsewhere: local positions change, global ones do not."""
        if self.origin is not None:
            self.origin = offset(self.origin, north_m, east_m, up_m)
