"""The ground that ArduPilot's vehicles stand on: state, saying things, each step, failsafes.

Times are vehicle time since boot, in microseconds.  What it says (`say`, `send`,
`change_parameter`) is collected, and goes out with the answer to what it is doing.
Sources: ardupilot.md 1, 4, 5 and the recorded flights.
"""

import abc
import bisect
import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from vehicle_sim.autopilots import (
    Estimate,
    Place,
    Reply,
    SayParameter,
    Send,
    Sender,
    Style,
    Text,
)
from vehicle_sim.autopilots.ardupilot.ekf3 import Ekf3, Timing
from vehicle_sim.autopilots.ardupilot.fence import NAMES, Fence
from vehicle_sim.autopilots.ardupilot.style import GPS_GLOBAL_ORIGIN, HOME_POSITION
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import PlanKind, Plans
from vehicle_sim.sensors.gps import Fix

Due = tuple[int, Reply | tuple[str, float]]
"""When since boot, and what: something to say, or a parameter that changes and is said."""

SLOW_US = 100_000
EKF_CHECKS = 10
"""In a row, ten a second, before the failsafe acts."""
FIRST_STATISTICS_US, STATISTICS_US = 30_440_000, 31_010_000


class ArduPilotCore(abc.ABC):
    """What runs by itself in every one of ArduPilot's vehicles."""

    style: Style
    MODES: ClassVar[Mapping[int, str]]
    """Names of the modes by number."""
    PREARM_US: ClassVar[int]
    """When the PREARM_CHECK bit gets healthy."""

    def __init__(
        self,
        vehicle: Vehicle,
        parameters: Parameters,
        plans: Plans,
        *,
        timing: Timing,
        boot: Sequence[Due],
        hardware_id: int,
        rng: np.random.Generator,
    ) -> None:
        self.vehicle = vehicle
        self.parameters = parameters
        self.plans = plans
        self.hardware_id = hardware_id
        self.rng = rng
        self.battery: Battery | None = None
        """What the power module measures; whoever drains it puts it here."""
        self.estimate = Estimate(latitude_deg=0.0, longitude_deg=0.0, altitude_amsl_m=0.0)
        self._out: list[Reply] = []
        self.ekf = Ekf3(self.estimate, timing, self._out, rng)
        self.fence = Fence(parameters, plans)
        self.now_us = 0
        self.mode = 0
        self.armed = False
        self.landed = True
        self.home: Place | None = None
        self.mission_current = 0
        self.failsafe = False
        self._was_armed = False
        self._attitude_rad = (0.0, 0.0, 0.0)
        self._due = sorted(boot, key=lambda row: row[0])
        self._slow_us = SLOW_US
        self._statistics_us = FIRST_STATISTICS_US
        self._flown_us = 0
        self._said_flown_s = 0
        self._ekf_failures = 0
        self._gcs_seen_us: int | None = None
        self._gcs_lost = False
        self._battery_low_since_us: int | None = None
        self._battery_acted = 0
        self._fence_left_alone_us = 0
        self._parameters_version = parameters.version

    # --- saying things ----------------------------------------------------------------------------

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT."""
        self._out.append(Text(severity=severity, text=text))

    def send(self, message: int) -> None:
        """One stream message out of turn, to everybody."""
        self._out.append(Send(message=message))

    def reply(self, reply: Reply) -> None:
        """Anything else."""
        self._out.append(reply)

    def change_parameter(self, name: str, value: float) -> None:
        """Set a parameter by itself and tell everybody."""
        if name in self.parameters:
            self.parameters[name] = value
            self._out.append(SayParameter(name=name))

    def later(self, after_us: int, what: Reply | tuple[str, float]) -> None:
        """Say this so much later."""
        bisect.insort(self._due, (self.now_us + after_us, what), key=lambda row: row[0])

    def _taken(self) -> list[Reply]:
        taken = self._out.copy()
        self._out.clear()
        return taken

    # --- each step --------------------------------------------------------------------------------

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float, fix: Fix) -> Sequence[Reply]:
        """Fly on to now_us, over ground of this height, with the newest GPS fix."""
        self.now_us = now_us
        ekf = self.ekf
        ekf.step(now_us, self.vehicle, fix)
        if ekf.became_origin:
            self._on_origin()
        if self._due and self._due[0][0] <= now_us:
            self._say_due()
        if self.parameters.version != self._parameters_version:
            self._parameters_version = self.parameters.version
            self.read_parameters()
        if now_us >= self._slow_us:
            self._slow_us += SLOW_US
            self.slow()
        self.fly(dt_s, ground_amsl_m)
        ekf.follow(self.vehicle)
        return self._taken() if self._out else ()

    @abc.abstractmethod
    def fly(self, dt_s: float, ground_amsl_m: float) -> None:
        """Control and move the vehicle for one step, by the estimate."""

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        return

    def slow(self) -> None:
        """Ten times a second: failsafes, fence, statistics."""
        if self.armed and self.flying:
            self._flown_us += SLOW_US
        self._watch_attitude()
        if self.now_us >= self._statistics_us:
            first = self._statistics_us == FIRST_STATISTICS_US
            self._statistics_us += 30_010_000 if first else STATISTICS_US
            self.say_statistics()
        self._check_fence()
        self._check_gcs()
        self._check_battery()

    def _watch_attitude(self) -> None:
        """Rates of turn, from where it pointed a tenth of a second ago."""
        e, vehicle = self.estimate, self.vehicle
        roll_rad, pitch_rad, yaw_rad = self._attitude_rad
        e.roll_rate_rad_s = (vehicle.roll_rad - roll_rad) * 1e6 / SLOW_US
        e.pitch_rate_rad_s = (vehicle.pitch_rad - pitch_rad) * 1e6 / SLOW_US
        turned_rad = math.remainder(vehicle.heading_rad - yaw_rad, math.tau)
        e.yaw_rate_rad_s = turned_rad * 1e6 / SLOW_US
        self._attitude_rad = (vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad)

    @property
    def flying(self) -> bool:
        """Whether flight time counts."""
        return not self.landed

    def _say_due(self) -> None:
        while self._due and self._due[0][0] <= self.now_us:
            what = self._due.pop(0)[1]
            if isinstance(what, tuple):
                self.change_parameter(*what)
            else:
                self._out.append(what)

    def _on_origin(self) -> None:
        """The estimator's origin is set, and home with it."""
        self.home = self.ekf.origin
        self.send(GPS_GLOBAL_ORIGIN)
        self.send(HOME_POSITION)
        self.say(6, "EKF3 IMU0 origin set")
        self.change_parameter("MIS_TOTAL", max(len(self.plans[PlanKind.MISSION]), 1))

    def say_statistics(self) -> None:
        """Time flown, if it has changed, and time run: PARAM_VALUEs that nobody asked for."""
        flown_s = self._flown_us // 1_000_000
        if flown_s != self._said_flown_s:
            self._said_flown_s = flown_s
            self.change_parameter("STAT_FLTTIME", flown_s)
        self.change_parameter("STAT_RUNTIME", self.now_us // 1_000_000)

    # --- failsafes --------------------------------------------------------------------------------

    def check_ekf(self) -> None:
        """Ten times a second, of vehicles that cannot fly without a position."""
        if self.armed and self.ekf.origin is not None and not self.ekf.position_ok:
            if self._ekf_failures < EKF_CHECKS:
                self._ekf_failures += 1
                if self._ekf_failures == EKF_CHECKS - 1 and self.ekf.primary == 0:
                    self.ekf.switch_lane(1)
                elif self._ekf_failures == EKF_CHECKS:
                    self.say(2, "EKF variance")
                    self.failsafe = True
                    self.on_ekf_failsafe()
        elif self._ekf_failures:
            self._ekf_failures -= 1
            if self._ekf_failures == 0 and self.failsafe:
                self.failsafe = False
                self.say(2, "EKF Failsafe Cleared")

    def on_ekf_failsafe(self) -> None:
        """What to do without a position."""
        return

    def _check_gcs(self) -> None:
        seen_us = self._gcs_seen_us
        if seen_us is None or self._gcs_lost or not self.gcs_failsafe_enabled:
            return
        if self.now_us - seen_us >= self.gcs_timeout_s * 1e6 and self.armed:
            self._gcs_lost = True
            self.on_gcs_failsafe()

    @property
    def gcs_failsafe_enabled(self) -> bool:
        """Whether a lost ground station matters."""
        return bool(self.parameters["FS_GCS_ENABLE"])

    @property
    def gcs_timeout_s(self) -> float:
        """How long it may be silent; 4.9 s was measured where 5 is set."""
        return self.parameters["FS_GCS_TIMEOUT"] - 0.1

    def on_gcs_failsafe(self) -> None:
        """The ground station has gone."""
        return

    def on_heartbeat(self, sender: Sender, vehicle_type: int) -> Sequence[Reply]:
        """Only those of MAV_GCS_SYSID count."""
        del vehicle_type
        if sender.system == self.parameters["MAV_GCS_SYSID"]:
            self._gcs_seen_us = self.now_us
            if self._gcs_lost:
                self._gcs_lost = False
                self.say(4, "GCS Failsafe Cleared")
        return self._taken()

    def _check_battery(self) -> None:
        battery, parameters = self.battery, self.parameters
        if battery is None or not parameters["BATT_MONITOR"] or self._battery_acted == 2:
            return
        left_mah = parameters["BATT_CAPACITY"] - battery.consumed_mah
        for level, name, action in ((2, "CRT", "BATT_FS_CRT_ACT"), (1, "LOW", "BATT_FS_LOW_ACT")):
            volts, mah = parameters[f"BATT_{name}_VOLT"], parameters[f"BATT_{name}_MAH"]
            low = (volts > 0.0 and battery.voltage_v < volts) or (mah > 0.0 and left_mah < mah)
            if not low or level <= self._battery_acted:
                continue
            if self._battery_low_since_us is None:
                self._battery_low_since_us = self.now_us
            if self.now_us - self._battery_low_since_us >= parameters["BATT_LOW_TIMER"] * 1e6:
                self._battery_acted = level
                how = "critical" if level == 2 else "low"
                used = f"{battery.voltage_v:.2f}V used {battery.consumed_mah:.0f} mAh"
                self.say(4, f"Battery 1 is {how} {used}")
                if self.armed:
                    self.on_battery_failsafe(int(parameters[action]))
            return
        self._battery_low_since_us = None

    def on_battery_failsafe(self, action: int) -> None:
        """BATT_FS_LOW_ACT or BATT_FS_CRT_ACT."""
        del action

    def _check_fence(self) -> None:
        if not self.fence.enabled or self.home is None:
            return
        if not self.armed or self.landed or not self.ekf.position_ok:
            self.fence.breached = 0
            return
        new = self.fence.check(self.estimate.place, self.home, self.now_us)
        if new and self.now_us >= self._fence_left_alone_us:
            names = [name for bit, name in NAMES.items() if new & bit]
            joined = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
            self.say(5, f"{joined} fence{'s' if len(names) > 1 else ''} breached")
            self.on_fence_breach(int(self.parameters["FENCE_ACTION"]))

    def on_fence_breach(self, action: int) -> None:
        """FENCE_ACTION: 0 only says it."""
        del action
