"""ArduPlane 4.7: boot, modes, arming, and what it answers; plane_flight.py flies it.

Times are vehicle time since boot.  Sources: ardupilot.md 1, 5, 7 and the recorded flight
arduplane-guided-reposition.tlog.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, final

from vehicle_sim.autopilots import (
    Command,
    Place,
    Reply,
    Result,
    Setpoint,
    State,
    Status,
    Waypoint,
    height_amsl_m,
)
from vehicle_sim.autopilots.ardupilot.autopilot import (
    GPS_GLOBAL_ORIGIN,
    HOME_POSITION,
    ArduPilot,
    profile,
)
from vehicle_sim.autopilots.ardupilot.ekf3 import Timing
from vehicle_sim.autopilots.ardupilot.plane_flight import Flight
from vehicle_sim.autopilots.ardupilot.plane_navigation import (
    AUTONOMOUS,
    BY_ITSELF,
    NAMES,
    Mode,
)
from vehicle_sim.conditions import SIM_PARAMETERS
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import table
from vehicle_sim.plans import PlanKind
from vehicle_sim.sensors.gps import Fix

ORIGIN_SAID_US = 2_261_000
"""From setting the origin to saying it and home."""
HOME_SET_US = 850_000
"""From the first fix to home."""
_RATES_HZ = dict.fromkeys((0, 1, 2, 24, 30, 32, 33, 42, 62, 74, 87, 147, 162, 168), 1.0) | {
    111: 0.1
}
"""What a fresh link gets unasked."""


@final
class ArduPlane(ArduPilot):
    """One vehicle's autopilot; steers the plane that it is given."""

    vehicle: Plane
    profile = profile(vehicle_type=1, capabilities=62319, rates_hz=_RATES_HZ)
    MODES: ClassVar[Mapping[int, str]] = NAMES
    TABLE = (*table("ardupilot/shared", "ardupilot/plane"), *SIM_PARAMETERS)
    TIMING = Timing(
        initialised_us=11_100_000,
        attitude_us=12_300_000,
        origin_after_fix_us=10_220_000,
        using_after_fix_us=11_240_000,
    )
    PREARM_US: ClassVar[int] = 22_800_000
    HEIGHTS_NEED_HOME: ClassVar[bool] = True
    GCS_FAILSAFE: ClassVar[tuple[str, str]] = ("FS_GCS_ENABL", "FS_LONG_TIMEOUT")
    CRASH_TEXT: ClassVar[str] = "Crash detected"

    def _set_up(self) -> None:
        self.mode = Mode.INITIALISING
        self._first_fix_us: int | None = None
        self._origin_due_us: int | None = None
        self._flight = Flight(self, self.vehicle)
        self.fly = self._flight.step

    # --- each step ----------------------------------------------------------------------------

    def wait_for_home(self, fix: Fix) -> None:
        """Home is where the first fix was, a moment later: plane does not wait for the EKF."""
        if not fix.usable:
            return
        if self._first_fix_us is None:
            self._first_fix_us = self.now_us
        elif self.now_us - self._first_fix_us >= HOME_SET_US:
            self.home = Place(fix.latitude_deg, fix.longitude_deg, fix.altitude_amsl_m)
            self.send(HOME_POSITION)

    def _on_origin(self) -> None:
        """The estimator's origin is set; it is told two seconds later."""
        self._origin_due_us = self.now_us + ORIGIN_SAID_US

    def slow(self) -> None:
        """Ten times a second: failsafes, fence, navigation."""
        super().slow()
        if self._origin_due_us is not None and self.now_us >= self._origin_due_us:
            self._origin_due_us = None
            self.send(GPS_GLOBAL_ORIGIN, HOME_POSITION)
        self._flight.navigate()

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        self._flight.read_parameters()

    @property
    def flying(self) -> bool:
        """Whether flight time counts."""
        return self._flight.flying

    # --- failsafes ----------------------------------------------------------------------------

    def on_gcs_failsafe(self) -> None:
        """FS_LONG_ACTN: 0 goes on in AUTO and returns otherwise, 1 returns."""
        goes_on = self.mode == Mode.AUTO and self.parameters["FS_LONG_ACTN"] == 0.0
        if not goes_on and self.flying:
            self.set_mode(Mode.RTL)
        self.send_text(4, f"GCS Failsafe On: {self.mode_name}")

    def on_battery_failsafe(self, action: int) -> None:
        """1 returns, 2 lands where the mission does, or returns."""
        landing = self.mode == Mode.AUTO and self._flight.mission.lands
        if action in (1, 2) and not landing:
            self.set_mode(Mode.RTL)

    def on_fence_breach(self, action: int) -> None:
        """FENCE_ACTION 0 only says it; all others fly home."""
        if action != 0 and self.mode not in (Mode.MANUAL, Mode.RTL):
            self.set_mode(Mode.RTL)

    # --- modes ----------------------------------------------------------------------------------

    def enter_mode(self, mode: int) -> str | None:
        """Begin to fly in this mode; plane refuses only those that nobody may choose."""
        if mode == Mode.INITIALISING:
            return "cannot be chosen"
        self._flight.enter(Mode(mode))
        return None

    @property
    def lands(self) -> bool:
        """Where AUTO does."""
        return self.mode == Mode.AUTO and self._flight.mission.lands

    def crash(self) -> Sequence[Reply]:
        """It has hit something."""
        self._flight.crashed = True
        return super().crash()

    def pilot_takes(self) -> Sequence[Reply]:
        """Fault: a pilot flies by FBWA."""
        self.set_mode(Mode.FBWA)
        return self._taken()

    # --- commands -------------------------------------------------------------------------------

    def handlers(self) -> dict[int, Callable[[Command], Result]]:
        """What answers which MAV_CMD."""
        return super().handlers() | {
            17: lambda _: self._change_to(Mode.LOITER),
            20: lambda _: self._change_to(Mode.RTL),
            22: lambda _: Result.FAILED,
            178: self._do_change_speed,
            192: self._do_reposition,
            300: self._mission_start,
            43000: self._guided_change_speed,
            43002: self._guided_change_heading,
        }

    def _change_to(self, mode: Mode) -> Result:
        self.set_mode(mode)
        return Result.ACCEPTED

    def _mission_start(self, command: Command) -> Result:
        if command.parameters[0] != 0.0 or command.parameters[1] != 0.0:
            return Result.DENIED
        return self._change_to(Mode.AUTO)

    def fly_item(self, number: int) -> None:
        """Of the mission, in AUTO."""
        if self.mode == Mode.AUTO:
            self._flight.mission.begin(number)

    def _do_reposition(self, command: Command) -> Result:
        p = command.parameters
        if command.frame is None:
            return Result.UNSUPPORTED
        if not math.isfinite(p[6]):
            self.send_text(2, "SIM: NaN height in DO_REPOSITION stops the real autopilot")
            return Result.DENIED
        place = self.place_of(command)
        if isinstance(place, Result):
            return Result.DENIED
        if p[4] == 0.0 and p[5] == 0.0:
            return Result.DENIED
        if self.fence.outside(place, self.home):
            return Result.DENIED
        switches = math.isfinite(p[1]) and int(p[1]) & 1
        if self.mode != Mode.GUIDED and not switches:
            return Result.FAILED
        self.set_mode(Mode.GUIDED)
        counter_clockwise = math.isfinite(p[3]) and p[3] != 0.0
        radius_m = p[2] if math.isfinite(p[2]) and p[2] > 0.0 else None
        self._flight.reposition(place, radius_m, counter_clockwise=counter_clockwise)
        return Result.ACCEPTED

    def _do_change_speed(self, command: Command) -> Result:
        if self.mode not in (Mode.GUIDED, Mode.AUTO):
            return Result.FAILED
        p = command.parameters
        return Result.ACCEPTED if self._flight.guided.change_speed(p[0], p[1]) else Result.FAILED

    def altitude_amsl_m(self, altitude_m: float, frame: float) -> float | None:
        """A height in a MAV_FRAME; None where that has none."""
        if not math.isfinite(altitude_m):
            return None
        home_m = self.home_amsl_m  # for the ground too: there are no terrain data
        return height_amsl_m(frame, altitude_m, home_m, home_m)

    def _guided_change_speed(self, command: Command) -> Result:
        kind, speed_m_s, acceleration = command.parameters[:3]
        if self.mode != Mode.GUIDED:
            return Result.FAILED
        least, most = self.parameters["AIRSPEED_MIN"], self.parameters["AIRSPEED_MAX"]
        if kind != 0.0 or not least <= speed_m_s <= most:
            return Result.DENIED
        finite = math.isfinite(acceleration)
        self._flight.guided.set_speed(speed_m_s, acceleration if finite else 0.0)
        return Result.ACCEPTED

    def _guided_change_heading(self, command: Command) -> Result:
        kind, heading_deg, acceleration = command.parameters[:3]
        if self.mode != Mode.GUIDED:
            return Result.FAILED
        if not 0.0 <= heading_deg < 360.0 or kind not in (0.0, 1.0, 2.0):
            return Result.DENIED
        if kind == 2.0:
            self._flight.guided.holds_heading = False
            return Result.ACCEPTED
        limit = acceleration if math.isfinite(acceleration) else 0.0
        guided = self._flight.guided
        guided.set_heading(math.radians(heading_deg), limit, course=kind == 0.0)
        return Result.ACCEPTED

    # --- setpoints ----------------------------------------------------------------------------

    def on_setpoint(self, setpoint: Setpoint) -> Sequence[Reply]:
        """Only heights are taken, and only in GUIDED."""
        if self.mode != Mode.GUIDED:
            return ()
        navigation = self._flight.navigation
        if not setpoint.is_global:
            if setpoint.frame == 7 and navigation.next is not None:
                self._add_height(-setpoint.position[2])
            return self._taken()
        if setpoint.frame in (0, 3, 5, 6, 10, 11) and not setpoint.type_mask & 4:
            altitude_m = self.altitude_amsl_m(setpoint.position[2], setpoint.frame)
            if altitude_m is not None:
                navigation.set_altitude(altitude_m)
            elif not math.isfinite(setpoint.position[2]):
                self.send_text(2, "SIM: NaN height in a setpoint stops the real autopilot")
        return self._taken()

    def _add_height(self, climb_m: float) -> None:
        navigation = self._flight.navigation
        if not math.isfinite(climb_m):
            self.send_text(2, "SIM: NaN height in a setpoint stops the real autopilot")
        elif navigation.next is not None:
            navigation.set_altitude(navigation.next.altitude_amsl_m + climb_m)

    # --- arming -------------------------------------------------------------------------------

    def arming_refusal(self) -> str | None:
        """Why it may not be armed now."""
        if not self.landed:
            return None
        if self._first_fix_us is None:
            return "GPS 1: Bad fix"
        if not self.ekf.position_ok:
            return "AHRS: not using configured AHRS type"
        return self.common_refusal()

    def on_armed(self) -> None:
        """The motor may turn."""
        self.send_text(6, "Throttle armed")
        if self.mode == Mode.AUTO:
            self._flight.mission.begin(1)

    def disarm(self) -> None:
        """Stop the motor, wherever it is."""
        super().disarm()
        self._flight.takeoff.abandon()
        self.send_text(6, "Throttle disarmed")

    # --- telling --------------------------------------------------------------------------------

    def base_mode(self) -> int:
        """Stabilised, with manual override except while it starts; guided where it navigates."""
        if self.mode == Mode.INITIALISING:
            return 0x11
        guided = 0x08 if self.mode in AUTONOMOUS else 0
        return 0x51 | guided | (0x80 if self.armed else 0)

    def system_status(self) -> State:
        """system_status of the heartbeat."""
        if self.mode == Mode.INITIALISING:
            return State.CALIBRATING
        if self.failsafe or self._gcs_lost or self._battery_acted:
            return State.CRITICAL
        if self._flight.crashed:
            return State.EMERGENCY
        return State.ACTIVE if self.flying else State.STANDBY

    def waypoint(self) -> Waypoint | None:
        """Where it goes; MANUAL says nothing."""
        return None if self.mode not in BY_ITSELF else self._flight.waypoint()

    def status(self) -> Status:
        """The status for telemetry."""
        return self.status_with(
            base_mode=self.base_mode(),
            system_status=self.system_status(),
            landed_state=self._flight.landed_state(),
            waypoint=self.waypoint(),
            mission_state=self.mission_state(),
            airspeed_m_s=self._flight.indicated_m_s,
        )

    def local_ned_m(self) -> tuple[float, float, float] | None:
        """Also before the EKF flies: then the simpler estimator's, about home."""
        local = super().local_ned_m()
        if local is None and self.home is not None and not self._flight.ever_aided:
            return 0.0, 0.0, self.home.altitude_amsl_m - self.estimate.altitude_amsl_m
        return local

    def target_echo(self) -> None:
        """It has none: it is steered by waypoints."""

    def mission_state(self) -> int:
        """MISSION_STATE: 1 no mission, 2 not started, 3 active, 5 complete."""
        if len(self.plans[PlanKind.MISSION]) < 2:
            return 1
        if self.mode == Mode.AUTO and self._flight.mission.runs:
            return 3
        return 5 if self._flight.mission_over else 2
