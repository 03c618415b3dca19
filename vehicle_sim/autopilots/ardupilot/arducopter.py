"""ArduCopter 4.7 as measured: modes, arming, take-off, commands, setpoints, failsafes.

Source: ardupilot.md 2 to 5 and the recorded flights.  How it flies is in copter_flight.py,
copter_guided.py and copter_control.py; what it shares with ArduPlane is in autopilot.py.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, final

from vehicle_sim.autopilots import (
    Command,
    FirmwareProfile,
    Landed,
    Place,
    Reply,
    Result,
    Setpoint,
    State,
    Status,
    TargetEcho,
    Waypoint,
)
from vehicle_sim.autopilots.ardupilot.autopilot import (
    HEARTBEAT,
    TIMESYNC,
    ArduPilot,
    profile,
)
from vehicle_sim.autopilots.ardupilot.copter_flight import (
    FAILSAFE_PAUSE_US,
    NAMES,
    NEED_POSITION,
    NOT_ARMABLE,
    RETURNS,
    Flight,
    Mode,
)
from vehicle_sim.autopilots.ardupilot.copter_guided import (
    IGNORE_ACCELERATION,
    IGNORE_POSITION,
    IGNORE_VELOCITY,
    IGNORE_YAW,
    IGNORE_YAW_RATE,
    NOTHING,
    SetpointFrames,
    Stop,
    Submode,
    Target,
    read_setpoint,
)
from vehicle_sim.autopilots.ardupilot.ekf3 import Timing
from vehicle_sim.autopilots.ardupilot.flat_earth import (
    bearing_rad,
    distance_m,
    flat_earth_ned_m,
    offset,
)
from vehicle_sim.conditions import SIM_PARAMETERS
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.parameters import table
from vehicle_sim.plans import PlanKind
from vehicle_sim.sensors.gps import Fix

EKF_CHECKS = 10
"""In a row, ten a second, before the failsafe acts."""
READY_US = 2_450_000
"""From here on the heartbeat says STANDBY."""
ABOVE_HOME_FRAME = 3
AVOIDANCE_1_S = 0.5
_IGNORE_YAWS = IGNORE_YAW | IGNORE_YAW_RATE
ECHO_MASKS = {
    Submode.TAKEOFF: IGNORE_VELOCITY | IGNORE_ACCELERATION | _IGNORE_YAWS,
    Submode.POSITION: IGNORE_VELOCITY | IGNORE_ACCELERATION | _IGNORE_YAWS,
    Submode.POSITION_VELOCITY: _IGNORE_YAWS,
    Submode.VELOCITY: IGNORE_POSITION | _IGNORE_YAWS,
    Submode.ACCELERATION: IGNORE_POSITION | IGNORE_VELOCITY | _IGNORE_YAWS,
}
"""type_mask of POSITION_TARGET_LOCAL_NED: 0xDF8, 0xC00, 0xC07, 0xC3F."""


@final
class ArduCopter(ArduPilot):
    """One copter's autopilot; steers the copter that it is given."""

    vehicle: Copter
    profile: FirmwareProfile = profile(
        vehicle_type=2, capabilities=64495, rates_hz={HEARTBEAT: 1.0, TIMESYNC: 0.1}
    )
    MODES: ClassVar[Mapping[int, str]] = NAMES
    TABLE = (*table("ardupilot/shared", "ardupilot/copter"), *SIM_PARAMETERS)
    TIMING = Timing(
        initialised_us=4_460_000,
        attitude_us=5_900_000,
        origin_after_fix_us=10_000_000,
        using_after_fix_us=31_620_000,
    )
    PREARM_US: ClassVar[int] = 23_300_000
    HEIGHTS_NEED_HOME: ClassVar[bool] = False
    GCS_FAILSAFE: ClassVar[tuple[str, str]] = ("FS_GCS_ENABLE", "FS_GCS_TIMEOUT")
    CRASH_TEXT: ClassVar[str] = "Crash: Disarming: AngErr=90>30, Accel=0.5<3.0"

    def _set_up(self) -> None:
        self.flight = Flight(self, self.vehicle)
        self.fly = self.flight.step
        self.mode = Mode.STABILIZE
        self._refused_text: str | None = None
        self._ekf_failures = 0
        self._was_glitching = False

    # --- each step ----------------------------------------------------------------------------

    def read_parameters(self) -> None:
        """They are read live."""
        self.flight.read_parameters()

    def wait_for_home(self, fix: Fix) -> None:
        """Home comes with the estimator's origin."""

    def slow(self) -> None:
        """Ten times a second."""
        super().slow()
        self._check_ekf()
        ekf = self.ekf
        if ekf.glitching is not self._was_glitching:
            self._was_glitching = ekf.glitching
            self.send_text(2, "GPS Glitch or Compass error" if ekf.glitching else "Glitch cleared")

    # --- modes and failsafes --------------------------------------------------------------------

    def enter_mode(self, mode: int) -> str | None:
        """Checks are only made in flight, as the real one does."""
        if self.armed and mode in NEED_POSITION and not self.ekf.position_ok:
            return "requires position"
        if mode == Mode.AUTO and self.armed and not self.flight.auto.can_begin():
            return "init failed"
        if mode in RETURNS and self.armed and self.home is None:
            return "init failed"
        self.mode = mode
        self.flight.begin(mode)
        return None

    def _check_ekf(self) -> None:
        """It cannot fly without a position."""
        if self.armed and self.ekf.origin is not None and not self.ekf.position_ok:
            if self._ekf_failures < EKF_CHECKS:
                self._ekf_failures += 1
                if self._ekf_failures == EKF_CHECKS:
                    self.send_text(2, "EKF variance")
                    self.failsafe = True
                    self._on_ekf_failsafe()
        elif self._ekf_failures:
            self._ekf_failures -= 1
            if self._ekf_failures == 0 and self.failsafe:
                self.failsafe = False
                self.send_text(2, "EKF Failsafe Cleared")

    def _on_ekf_failsafe(self) -> None:
        """FS_EKF_ACTION 1: land, wherever it is."""
        if self.mode in (*NEED_POSITION, Mode.LAND) and self.parameters["FS_EKF_ACTION"]:
            self.set_mode(Mode.LAND)
            self.flight.motion.lands_with_position = False
            self.flight.motion.pauses_until_us = self.now_us + FAILSAFE_PAUSE_US
            self.send_text(2, "EKF Failsafe: changed to LAND Mode")

    def on_gcs_failsafe(self) -> None:
        """FS_GCS_ENABLE 1: return; 5: land."""
        self.send_text(4, "GCS Failsafe")
        self._go_home_or_land(land=self.parameters["FS_GCS_ENABLE"] == 5)

    def on_battery_failsafe(self, action: int) -> None:
        """1: land; 2: return; 3: return; 4: land; 5: stop the motors."""
        if action == 0:
            return None
        self.send_text(4, "Battery Failsafe")
        if action == 5:
            return self.disarm()
        return self._go_home_or_land(land=action in (1, 4))

    def on_fence_breach(self, action: int) -> None:
        """1: return, or land; 2: land; 4: brake, or land; 3 and 5 try SMARTRTL first, as RTL."""
        brakes = action == 4 and not self.landed
        if action != 0 and not (brakes and self.set_mode(Mode.BRAKE)):
            self._go_home_or_land(land=action in (2, 4))

    def _go_home_or_land(self, *, land: bool) -> None:
        if self.landed:
            self.disarm()
        elif land or not self.set_mode(Mode.RTL):
            self.set_mode(Mode.LAND)
            self.flight.motion.pauses_until_us = self.now_us + FAILSAFE_PAUSE_US

    @property
    def lands(self) -> bool:
        """In LAND, at the end of RTL, and where AUTO lands."""
        return self.flight.landing

    def crash(self) -> Sequence[Reply]:
        """It has hit something."""
        self.flight.crash()
        return super().crash()

    def pilot_takes(self) -> Sequence[Reply]:
        """Fault: LOITER."""
        self.set_mode(Mode.LOITER)
        return self._taken()

    # --- arming -----------------------------------------------------------------------------------

    def arming_refusal(self) -> str | None:
        """Why it may not be armed now."""
        if self.mode in NOT_ARMABLE:
            return f"{self.mode_name} mode not armable"
        if self.mode in NEED_POSITION and not self.ekf.position_ok:
            return "Need Position Estimate"
        if self.now_us < self.PREARM_US:
            return "AHRS: waiting for home"
        return self.common_refusal()

    def on_armed(self) -> None:
        """It idles until a take-off, or until DISARM_DELAY is over."""
        self.send_text(6, "Arming motors")
        self.flight.standing()

    def disarm(self) -> None:
        """Stop the motors, wherever it is."""
        if self.armed:
            self.send_text(6, "Disarming motors")
        super().disarm()
        self.flight.abandon_takeoff()

    # --- commands -------------------------------------------------------------------------------

    def handlers(self) -> dict[int, Callable[[Command], Result]]:
        """What ArduCopter answers besides."""
        return {
            **super().handlers(),
            17: lambda _: self._by_mode(Mode.LOITER),
            20: lambda _: self._by_mode(Mode.RTL),
            21: lambda _: self._by_mode(Mode.LAND),
            22: self._take_off,
            115: self._condition_yaw,
            178: self._change_speed,
            192: self._reposition,
            193: self._pause_or_continue,
            300: self._start_mission,
        }

    def _by_mode(self, mode: int) -> Result:
        return Result.ACCEPTED if self.set_mode(mode) else Result.FAILED

    def _take_off(self, command: Command) -> Result:
        if command.frame not in (None, ABOVE_HOME_FRAME):
            return Result.DENIED
        flight, home = self.flight, self.home
        ready = self.armed and self.landed and self.mode == Mode.GUIDED and home is not None
        if not ready or flight.motion.takeoff_us is not None or not self.ekf.position_ok:
            return Result.FAILED
        assert home is not None
        altitude_amsl_m = home.altitude_amsl_m + command.parameters[6]
        if not self.estimate.altitude_amsl_m < altitude_amsl_m < math.inf:
            return Result.FAILED
        flight.take_off(altitude_amsl_m)
        return Result.ACCEPTED

    def _condition_yaw(self, command: Command) -> Result:
        angle_deg, _, direction, relative = command.parameters[:4]
        if not 0.0 <= angle_deg <= 360.0 or relative not in (0.0, 1.0):
            return Result.FAILED
        angle_rad, heading_rad = math.radians(angle_deg), self.vehicle.heading_rad
        self.flight.yaw.fix(heading_rad, angle_rad, direction, relative=relative == 1.0)
        return Result.ACCEPTED

    def _change_speed(self, command: Command) -> Result:
        """Of the present submode only: beginning another one reads the parameters again."""
        kind, speed_m_s = command.parameters[:2]
        if not 0.0 < speed_m_s < math.inf:
            return Result.FAILED
        control = self.flight.control
        if kind > 2.9:
            control.speed_down_m_s = speed_m_s
        elif kind > 1.9:
            control.speed_up_m_s = speed_m_s
        else:
            control.speed_m_s = speed_m_s
        return Result.ACCEPTED

    def _reposition(self, command: Command) -> Result:
        """COMMAND_INT only; p2 bit 0 changes to GUIDED first."""
        if command.frame is None:
            return Result.UNSUPPORTED
        flags = command.parameters[1]
        changes = math.isfinite(flags) and bool(int(flags) & 1)
        if self.mode != Mode.GUIDED and not changes:
            return Result.DENIED
        place = self.place_of(command)
        if isinstance(place, Result):
            return Result.DENIED
        if self.mode != Mode.GUIDED and not self.set_mode(Mode.GUIDED):
            return Result.FAILED
        target = Target(place=place, velocity_neu_m_s=None, acceleration_neu_m_s2=NOTHING)
        return Result.ACCEPTED if self._take(target) else Result.FAILED

    def _pause_or_continue(self, command: Command) -> Result:
        """In GUIDED and AUTO: stop and ignore setpoints, or go on."""
        wanted = command.parameters[0]
        if wanted not in (0.0, 1.0):
            return Result.DENIED
        flight, pause = self.flight, wanted == 0.0
        if self.mode == Mode.GUIDED:
            flight.guided.stop()
            flight.guided.paused = pause
        elif self.mode == Mode.AUTO:
            flight.auto.paused = pause
        else:
            return Result.FAILED
        return Result.ACCEPTED

    def _start_mission(self, command: Command) -> Result:
        del command
        if not self.armed:
            return Result.FAILED
        if self.mode == Mode.AUTO:
            self.flight.auto.paused = False
            return Result.ACCEPTED
        return self._by_mode(Mode.AUTO)

    def fly_item(self, number: int) -> None:
        """Of the mission, in AUTO."""
        if self.mode == Mode.AUTO and number > 0:
            self.flight.auto.jump_to(number)

    # --- setpoints ----------------------------------------------------------------------------

    def on_setpoint(self, setpoint: Setpoint) -> Sequence[Reply]:
        """Steer for this from now on; outside GUIDED it is not even read."""
        origin, home, flight = self.ekf.origin, self.home, self.flight
        if self.mode != Mode.GUIDED or home is None or origin is None or flight.guided.paused:
            return ()
        bearings = SetpointFrames(
            vehicle=self.estimate.place,
            heading_rad=self.vehicle.heading_rad,
            home=home,
            origin=origin,
        )
        target = read_setpoint(setpoint, bearings)
        if isinstance(target, Stop):
            self._stop(target)
        elif self._take(target):
            self._refused_text = None
        return self._taken() if self._out else ()

    def _stop(self, stop: Stop) -> None:
        """It does not like it: stand still, and say what the real one would die of once."""
        self.flight.abandon_takeoff()
        self.flight.guided.stop()
        self.flight.yaw.look_ahead()
        told, self._refused_text = self._refused_text, stop.text
        if stop.text is not None and stop.text != told:
            self.send_text(2, stop.text)

    def _take(self, target: Target) -> bool:
        """Steer for it, unless it lies where the fence forbids: that is dropped in silence."""
        if target.place is not None and self.fence.outside(target.place, self.home):
            return False
        flight = self.flight
        if flight.motion.takeoff_us is not None:
            flight.abandon_takeoff()
        if target.place is None and self.fence.enabled:
            target = self._kept_inside(target)
        flight.guided.take(target, self.now_us)
        flight.yaw.command(
            target.yaw_rad, target.yaw_rate_rad_s if target.yaw_rad is None else None
        )
        return True

    def _kept_inside(self, target: Target) -> Target:
        """The avoidance library: a velocity that would cross the fence is slowed in time."""
        velocity = target.velocity_neu_m_s
        if velocity is None or self.home is None:
            return target
        here = self.estimate.place
        north, east, up = velocity
        speed = math.hypot(north, east)
        room_m = self.fence.room_m(here, self.home)
        if speed < 1e-3 or not math.isfinite(room_m):
            return target
        ahead_m = max(room_m, 0.0) + 1.0
        ahead = offset(here, north / speed * ahead_m, east / speed * ahead_m)
        if not self.fence.outside(ahead, self.home):
            return target
        left_m = max(room_m - self.parameters["FENCE_MARGIN"], 0.0)
        slow_m_s = math.sqrt(self.flight.control.tuning.acceleration_m_s2 * left_m)
        share = min(slow_m_s / speed, AVOIDANCE_1_S * left_m / speed, 1.0)
        slowed = (north * share, east * share, up)
        return target._replace(velocity_neu_m_s=slowed, acceleration_neu_m_s2=NOTHING)

    # --- telling --------------------------------------------------------------------------------

    def base_mode(self) -> int:
        """Custom mode and manual input enabled, stabilised; "guided" while it holds a position."""
        mode, armed = self.mode, self.armed
        if self.now_us < READY_US:
            holds = True
        elif mode == Mode.LAND:
            holds = self.flight.motion.lands_with_position
        elif mode in RETURNS:
            holds = armed
        else:
            holds = mode in NEED_POSITION
        return 0x51 | (0x08 if holds else 0) | (0x80 if armed else 0)

    def system_status(self) -> State:
        """Of a copter that has ended its landing: STANDBY, also while armed."""
        if self.now_us < READY_US:
            return State.BOOT
        if self.failsafe:
            return State.CRITICAL
        return State.STANDBY if self.landed else State.ACTIVE

    def landed_state(self) -> Landed:
        """What EXTENDED_SYS_STATE says."""
        if self.landed:
            return Landed.ON_GROUND
        if self.flight.landing:
            return Landed.LANDING
        return Landed.TAKEOFF if self.flight.taking_off else Landed.IN_AIR

    def target_echo(self) -> TargetEcho | None:
        """What GUIDED steers for; in other modes nothing is sent."""
        origin, guided = self.ekf.origin, self.flight.guided
        if self.mode != Mode.GUIDED or origin is None:
            return None
        position: tuple[float, float, float] | None
        if guided.submode is Submode.TAKEOFF:
            position = (0.0, 0.0, 0.0)  # the take-off's height is not told
        elif self.flight.holds_place:
            position = flat_earth_ned_m(origin, guided.place)
        else:
            position = None
        v_n, v_e, v_u = guided.velocity
        a_n, a_e, a_u = guided.acceleration
        return TargetEcho(
            position_ned_m=position,
            velocity_ned_m_s=(v_n, v_e, -v_u),
            acceleration_ned_m_s2=(a_n, a_e, -a_u),
            yaw_rad=0.0,
            type_mask=ECHO_MASKS[guided.submode],
        )

    def waypoint(self) -> Waypoint | None:
        """While it flies to a place that does not move."""
        flight = self.flight
        place: Place | None = None
        if self.mode == Mode.GUIDED and flight.guided.submode is Submode.POSITION:
            place = flight.guided.place
        elif self.mode == Mode.AUTO and flight.auto.goal is not None:
            place = flight.auto.goal.place
        elif self.mode in RETURNS:
            place = flight.motion.return_place
        if place is None:
            return None
        here = self.estimate.place
        return Waypoint(
            place=place,
            distance_m=distance_m(here, place),
            bearing_rad=bearing_rad(here, place),
            altitude_error_m=place.altitude_amsl_m - here.altitude_amsl_m,
        )

    def mission_state(self) -> int:
        """MISSION_STATE: 1 no mission, 2 not started, 3 active, 4 paused, 5 complete."""
        if len(self.plans[PlanKind.MISSION]) < 2:
            return 1
        auto = self.flight.auto
        if self.mode != Mode.AUTO:
            return 5 if auto.complete else 2
        return 4 if auto.paused else 5 if auto.complete else 3

    def status(self) -> Status:
        """The status for telemetry."""
        return self.status_with(
            base_mode=self.base_mode(),
            system_status=self.system_status(),
            landed_state=self.landed_state(),
            waypoint=self.waypoint(),
            mission_state=self.mission_state(),
        )
