"""What every simulated PX4 has in common: modes, arming, checks, failsafes, and what it tells.

What px4.md 1 to 3 and 6 to 8 and the recorded flights say; the vehicle kinds (multicopter.py,
fixed_wing.py) fly the modes.
"""

import abc
import math
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Final

import numpy as np

from vehicle_sim.autopilots import (
    Ack,
    Command,
    FirmwareProfile,
    Landed,
    Place,
    Reply,
    Result,
    Sender,
    SendTelemetry,
    Setpoint,
    State,
    Status,
    TargetEcho,
    Text,
    Waypoint,
)
from vehicle_sim.autopilots.px4 import failsafe
from vehicle_sim.autopilots.px4.ekf2 import Ekf2
from vehicle_sim.autopilots.px4.failsafe import Action, Cause, Incidents, Stations
from vehicle_sim.autopilots.px4.mission import Fence, Mission, Surroundings
from vehicle_sim.autopilots.px4.modes import (
    CUSTOM_MODES,
    MANUAL_MODES,
    NAMES,
    NAVIGATED,
    Mode,
    base_mode,
)
from vehicle_sim.autopilots.px4.setpoints import (
    Projection,
    SetpointFrames,
    Target,
    Vector,
    read_setpoint,
)
from vehicle_sim.conditions import SIM_PARAMETERS_PX4
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.parameters import Parameter, Parameters, table
from vehicle_sim.plans import PlanKind, Plans
from vehicle_sim.sensors.gps import Fix

CAPABILITIES: Final = 0xE8FF
SOFTWARE_VERSION: Final = 0x01110040
CUSTOM_VERSION: Final = bytes((0, 0, 0, 178, 57, 165, 123, 187))

_ON_EVENT: Final = frozenset({42, 46, 49, 77, 148, 300})
_BY_RATE: Final = {
    0.5: (147, 242, 436),
    1.0: (0, 2, 42, 230),
    5.0: (1, 245),
    8.0: (24,),
    10.0: (74, 85, 87, 111, 132, 141),
    30.0: (32, 331),
    50.0: (31, 33),
    100.0: (30,),
}
RATES_HZ: Final = dict(sorted((n, hz) for hz, ns in _BY_RATE.items() for n in ns))
"""What a fresh onboard link gets, by message number, in Hz of vehicle time."""
_NOT_TOLD: Final = frozenset({4, 8, 29, 36, 40, 62, 65, 83, 105, 241, 360, 380, 441, 12901, 12904})
"""Their intervals are taken, as the real one takes them."""
_NOT_STREAMABLE: Final = frozenset({0, 42})
"""Sent by other parts of PX4: SET_MESSAGE_INTERVAL fails, as for unknown messages."""


def profile(*, vehicle_type: int, rates_hz: dict[int, float]) -> FirmwareProfile:
    """PX4 on its onboard link (px4.md 2), for a vehicle of this MAV_TYPE."""
    told = frozenset(rates_hz) | {231}
    return FirmwareProfile(
        firmware="px4",
        vehicle_type=vehicle_type,
        autopilot=12,
        capabilities=CAPABILITIES,
        software_version=SOFTWARE_VERSION,
        custom_version=CUSTOM_VERSION,
        first_heartbeat_us=1_600_000,  # px4.md 3
        rates_hz=rates_hz,
        streamable=(told | _NOT_TOLD | {49, 77}) - _NOT_STREAMABLE,
        requestable=told | _ON_EVENT,
    )


ARMABLE_US: Final = 3_500_000
"""Boot to the first time that it can be armed: heartbeat 0 at 2.6 s, 3 at 3.6 s of the log."""
LANDED_US: Final = 1_800_000
"""Contact to "landing detected": 54.6 to 56.4 s of px4-offboard-short.tlog."""
_CHECK_PHASE_US: Final = 60_000
"""The checks run ten times a second: events at x.06 s in the logs."""
_STILL_US: Final = 2_000_000
"""Disarmed to the estimator's constant-position mode."""
_LOW_M: Final = 1.2
"""Below this, in the air, there is no height above ground: flags 0x33f in the logs."""
_CHECK_US: Final = 100_000
_DO_SET_MODE: Final = 176
_MAX_RAD_S: Final = 10.0


def parameter_rows(*names: str) -> tuple[Parameter, ...]:
    """Those of these tables in the alphabetic order that PX4 numbers them in, then the faults'."""
    return (*sorted(table(*names), key=lambda row: row.name), *SIM_PARAMETERS_PX4)


class Px4(abc.ABC):
    """An autopilot of vehicle_sim.autopilots.Autopilot: all of it but how the vehicle flies.

    A kind of vehicle implements _begin (a mode begins) and _fly (one step), calls _took_off() once
    in the air and _contact() on the ground.  What it may read: mode, armed, landed, local_m,
    target, estimate, home, and what was commanded (takeoff_place, reposition, land_place,
    speed_m_s, mission).
    """

    HANDLERS: ClassVar[Mapping[int, "Handler"]]
    """Handlers by MAV_CMD."""
    TABLES: ClassVar[tuple[str, ...]]
    """Of its parameters."""
    profile: FirmwareProfile
    measures_airspeed = False

    def __init__(
        self,
        vehicle: Vehicle,
        parameters: Mapping[str, float],
        plans: Plans,
        *,
        rng: np.random.Generator,
    ) -> None:
        self.vehicle = vehicle
        self.parameters = Parameters(parameter_rows(*self.TABLES), parameters)
        self._system = int(self.parameters["MAV_SYS_ID"])
        """As it has booted; a change counts from the next boot on."""
        self.plans = plans
        self.ekf = Ekf2(vehicle, rng)
        self.estimate = self.ekf.estimate
        self.battery = Battery()
        """The simulation may put its own here: the battery failsafe reads it."""
        self.mode = self.intended = Mode.LOITER
        """The mode that is flown, and the one that is wanted."""
        self.action = Action.NONE
        self.armed = False
        self.landed = True
        self.now_us = 0
        self.ground_amsl_m = vehicle.altitude_amsl_m
        self.origin: Place | None = None
        self.home: Place | None = None
        self.projection = Projection(vehicle.latitude_deg, vehicle.longitude_deg)
        self.local_m: Vector = (0.0, 0.0, 0.0)
        """The estimate in the local frame: north, east, down."""
        self.target: Target | None = None
        """The newest setpoint that OFFBOARD flies; None: none since OFFBOARD was entered."""
        self.takeoff_place: tuple[float, float, float] | None = None
        """NAV_TAKEOFF's latitude, longitude (NaN: not given) and altitude AMSL."""
        self.reposition: tuple[float, float, float, float] | None = None
        """DO_REPOSITION's latitude, longitude, altitude AMSL and yaw in radians; NaN: keep."""
        self.land_place: tuple[float, float] | None = None
        """NAV_LAND's latitude and longitude."""
        self.speed_m_s: float | None = None
        """DO_CHANGE_SPEED, in AUTO modes."""
        self.mission = Mission(plans, self._surroundings, self.emit, self._obey_mission)
        self.fence = Fence(plans)
        self.stations = Stations()
        self.pilot_present = False
        """Holds the sticks centred: without one the manual modes sink."""
        self.offboard_signal = False
        """A setpoint was seen within COM_OF_LOSS_T, as of the last check."""
        self._incidents = Incidents()
        self._remember_nothing()
        self._set_up()

    def _remember_nothing(self) -> None:
        """What is remembered of a flight, before there was one."""
        self._signal_us: int | None = None
        self._after_disarming = Mode.LOITER
        self._armed_us = 0
        self._flown = False
        self._contact_us: int | None = None
        self._landed_us: int | None = None
        self._fusing = False
        self._pending: list[Reply] = []
        self._said: list[Reply] = []
        self._select_due = False
        self._still, self._low = True, False
        self._disarmed_us = -_STILL_US
        self._attitude_rad = (0.0, 0.0, self.vehicle.heading_rad)
        self._turning_rad, self._turning_s = (0.0, 0.0, 0.0), 0.01
        self._next_check_us = _CHECK_PHASE_US

    # --- what a kind of vehicle does ----------------------------------------------------------

    @abc.abstractmethod
    def _set_up(self) -> None:
        """The end of the construction: the kind's own parts and memory."""

    @abc.abstractmethod
    def _begin(self, mode: Mode, before: Mode) -> None:
        """The flown mode has changed (also: was armed in it; also: the same one, commanded)."""

    @abc.abstractmethod
    def _fly(self, dt_s: float) -> None:
        """One step: steer by self.estimate, advance self.vehicle; on the ground too."""

    @abc.abstractmethod
    def target_echo(self) -> TargetEcho | None:
        """POSITION_TARGET_LOCAL_NED."""

    @abc.abstractmethod
    def _waypoint(self) -> Waypoint | None:
        """POSITION_TARGET_GLOBAL_INT, in AUTO modes only."""

    def _takeoff_altitude_m(self) -> float:
        """AMSL: NAV_TAKEOFF's, or MIS_TAKEOFF_ALT above home."""
        place, home = self.takeoff_place, self.home or self._reference
        if place is not None and math.isfinite(place[2]):
            return place[2]
        return home.altitude_amsl_m + self.parameters["MIS_TAKEOFF_ALT"]

    @property
    def _height_m(self) -> float:
        """Above the ground: SIH has a distance sensor."""
        return max(self.vehicle.altitude_amsl_m - self.ground_amsl_m, 0.0)

    def _surroundings(self) -> Surroundings:
        return Surroundings(self.now_us, self.estimate.place, self.home, self.ground_amsl_m)

    def _obey_mission(self, what: Mode | float) -> None:
        """A mission item changes the mode, with the next step, or the speed."""
        if not isinstance(what, Mode):
            self.speed_m_s = what
            return
        self.intended = what
        self._incidents.forgive()
        self._select_due = True

    # --- Autopilot ----------------------------------------------------------------------------

    @property
    def mode_name(self) -> str:
        """Name of the flight mode."""
        return NAMES[self.mode]

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float, fix: Fix) -> Sequence[Reply]:
        """Fly on to now_us."""
        self.now_us = now_us
        self.ground_amsl_m = ground_amsl_m
        if self._pending:
            self._said, self._pending = self._said + self._pending, []
        self.ekf.step(now_us, dt_s, self.vehicle, fix, still=self._still, low=self._low)
        estimate = self.estimate
        if self.origin is None:
            self._find_origin()
        else:
            north_m, east_m = self.projection.to_local(
                estimate.latitude_deg, estimate.longitude_deg
            )
            down_m = self.origin.altitude_amsl_m - estimate.altitude_amsl_m
            self.local_m = (north_m, east_m, down_m)
        if self._select_due:
            self._select_due = False
            self._select()
        if now_us >= self._next_check_us:
            self._next_check_us = now_us + _CHECK_US
            self._check()
        self._fly(dt_s)
        vehicle = self.vehicle  # its rates, as gyroscopes feel them: a point mass has none
        roll, pitch, yaw = vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad
        roll_before, pitch_before, yaw_before = self._attitude_rad
        turn = yaw - yaw_before
        if turn > math.pi or turn < -math.pi:
            turn = math.remainder(turn, math.tau)
        self._attitude_rad = (roll, pitch, yaw)
        self._turning_rad = (roll - roll_before, pitch - pitch_before, turn)
        self._turning_s = dt_s
        if self.armed and self.landed:
            self._disarm_by_itself()
        if not self._said:
            return ()
        said, self._said = self._said, []
        return said

    @property
    def rates_rad_s(self) -> tuple[float, float, float]:
        """Of roll, pitch and heading."""
        roll, pitch, yaw = self._turning_rad
        most, scale = _MAX_RAD_S, 1.0 / self._turning_s
        return (
            min(max(roll * scale, -most), most),
            min(max(pitch * scale, -most), most),
            min(max(yaw * scale, -most), most),
        )

    def on_setpoint(self, setpoint: Setpoint) -> Sequence[Reply]:
        """Take a setpoint as a sign of life, and in OFFBOARD as what to fly."""
        if self.origin is None and setpoint.is_global:
            return ()
        target = read_setpoint(
            setpoint,
            SetpointFrames(
                projection=self.projection,
                origin_amsl_m=self._reference.altitude_amsl_m,
                home_amsl_m=(self.home or self._reference).altitude_amsl_m,
                ground_amsl_m=self.ground_amsl_m,
                heading_rad=self.vehicle.heading_rad,
            ),
        )
        if target is not None:
            self._signal_us = self.now_us
            if not self.offboard_signal:  # the arming checks run at once for it
                self.offboard_signal = self._select_due = True
                self._next_check_us = self.now_us
            if self.mode is Mode.OFFBOARD:
                self.target = target
        return ()

    def on_heartbeat(self, sender: Sender, vehicle_type: int) -> Sequence[Reply]:
        """A heartbeat of another component."""
        ours = sender.system == self._system
        self.stations.hear(vehicle_type, self.now_us, ours=ours)
        return ()

    def on_parameter(self, name: str) -> Sequence[Reply]:  # noqa: ARG002 - read live
        """A parameter was set by a client."""
        return ()

    def on_plan(self, kind: PlanKind) -> Sequence[Reply]:
        """A mission, fence or rally list was replaced by a client."""
        if kind is PlanKind.MISSION:
            self.mission.restart()
        return ()

    def pilot_takes(self) -> Sequence[Reply]:
        """Fault: the pilot changes to Position mode and holds the sticks centred."""
        self.pilot_present = True
        self.command_mode(Mode.POSCTL)
        return ()

    def reset_estimate(self, north_m: float, east_m: float) -> Sequence[Reply]:
        """Fault: the estimator's position jumps."""
        self.ekf.shift(north_m, east_m)
        return ()

    def move_origin(self, north_m: float, east_m: float, up_m: float) -> Sequence[Reply]:
        """Fault: the estimator's origin moves."""
        if self.origin is None:
            return ()
        altitude_m = self.origin.altitude_amsl_m + up_m
        self._set_origin(self.projection.place(north_m, east_m, altitude_m))
        return ()

    def local_ned_m(self) -> Vector:
        """Position in the estimator's frame."""
        return self.local_m

    def status(self) -> Status:
        """The status for telemetry."""
        mode, armed = self.mode, self.armed
        return Status(
            mode=CUSTOM_MODES[mode],
            base_mode=base_mode(mode, armed=armed),
            system_status=self._system_status(),
            landed_state=self._landed_state(),
            prearm_ok=self.armable,
            origin=self.origin,
            waypoint=self._waypoint() if armed and mode in NAVIGATED else None,
            intended_mode=CUSTOM_MODES[self.intended],
            mission_current=self.mission.current,
            mission_state=self.mission.state,
            mission_total=self.mission.total,
            above_ground_m=self._height_m,
            fusing=self._fusing,
            fence_breached=self.fence.breached,
            fence_breaches=self.fence.breaches,
            failsafe=armed and self.action > Action.WARN,
        )

    # --- commands -----------------------------------------------------------------------------

    def on_command(self, command: Command) -> Sequence[Reply]:
        """Handle a command; returns the replies."""
        result = self.HANDLERS.get(command.number, _unsupported)(self, command)
        said, self._said = self._said, []
        ack = Ack(to=command.sender, command=command.number, result=result)
        if command.number == _DO_SET_MODE:
            # The receiver accepts whatever comes; the real result follows (px4.md 1, item 1).
            self._pending += [ack, *said]
            return [Ack(to=command.sender, command=command.number, result=Result.ACCEPTED)]
        return [ack, *said]

    # --- what it tells them -------------------------------------------------------------------

    def emit(self, *replies: Reply) -> None:
        """Send these at the end of the step."""
        self._said.extend(replies)

    def say(self, severity: int, words: str) -> None:
        """A STATUSTEXT; PX4 ends those that are events as well with a tab."""
        self.emit(Text(severity=severity, text=words + "\t"))

    def _took_off(self) -> None:
        """The land detector sees it in the air."""
        if self.landed:
            self.landed = False
            self._flown = True
            self._contact_us = self._landed_us = None

    def _contact(self, *, pressed: bool) -> None:
        """Stands on the ground, and does not want up (pressed) or does."""
        if self.landed or not pressed:
            self._contact_us = None
            return
        if self._contact_us is None:
            self._contact_us = self.now_us
        elif self.now_us - self._contact_us >= LANDED_US:
            self.landed = True
            self._landed_us = self.now_us

    def finish_takeoff(self) -> None:
        """The take-off has reached its height: Hold (COM_TAKEOFF_ACT 0)."""
        self._intend(Mode.LOITER)

    # --- checks -------------------------------------------------------------------------------

    def _check(self) -> None:
        """Ten times a second: arming checks, incidents; what follows is done in the next step."""
        now_us, parameters = self.now_us, self.parameters
        if self.stations.misses_companion(now_us, parameters["COM_OBC_LOSS_T"]):
            self.say(2, "Connection to mission computer lost")
        self._still = not self.armed and now_us - self._disarmed_us >= _STILL_US
        self._low = self._height_m < _LOW_M and not self.landed and self.mode is not Mode.TAKEOFF
        self.ekf.lag_s = parameters["EKF2_GPS_DELAY"] * 1e-3
        signal_us = self._signal_us
        lost_us = parameters["COM_OF_LOSS_T"] * 1e6
        self.offboard_signal = signal_us is not None and now_us - signal_us <= lost_us
        if self.ekf.fusing != self._fusing:
            self._tell_fusion()
        if self.armed:
            self._watch_ground_station()
            self._watch_fence()
            self._watch_battery()
        self._select_due = True

    def _tell_fusion(self) -> None:
        self._fusing = self.ekf.fusing
        if not self._flown:
            return
        words = "started" if self._fusing else "stopped"
        self.say(6, f"GNSS data fusion {words}")

    def _watch_ground_station(self) -> None:
        """If NAV_DLL_ACT says that it matters."""
        parameters = self.parameters
        chosen = failsafe.LINK_LOSS.get(int(parameters["NAV_DLL_ACT"]), Action.NONE)
        lost = self.stations.ground_station_lost(self.now_us, parameters["COM_DL_LOSS_T"])
        self._incidents.note(Cause.GROUND_STATION_LOST, chosen if lost else Action.NONE)

    def _watch_fence(self) -> None:
        home, parameters = self.home, self.parameters
        if home is None or not self.estimate.position_ok:
            return
        north_m, east_m, _ = self.local_m
        home_n, home_e = self.projection.to_local(home.latitude_deg, home.longitude_deg)
        away_m = math.hypot(north_m - home_n, east_m - home_e)
        above_m = self.estimate.altitude_amsl_m - home.altitude_amsl_m
        breached = (
            0.0 < parameters["GF_MAX_HOR_DIST"] < away_m
            or 0.0 < parameters["GF_MAX_VER_DIST"] < above_m
            or not self.fence.allows(self.projection, north_m, east_m)
        )
        self.fence.note(breached=breached)
        chosen = failsafe.FENCE.get(int(parameters["GF_ACTION"]), Action.WARN)
        action = chosen if breached else Action.NONE
        if self._incidents.note(Cause.FENCE, action):
            self.say(4, "Geofence: approaching or outside geofence")

    def _watch_battery(self) -> None:
        parameters = self.parameters
        thresholds = (parameters["BAT_CRIT_THR"], parameters["BAT_EMERGEN_THR"])
        choice = int(parameters["COM_LOW_BAT_ACT"])
        action = failsafe.battery_action(self.battery.remaining, thresholds, choice)
        if self._incidents.note(Cause.BATTERY, action):
            self.say(2, "Critical battery level, land now")

    def _select(self) -> None:
        """Which mode is flown now."""
        intended, position_ok = self.intended, self.estimate.position_ok
        action = Action.NONE
        if self.armed:
            action = failsafe.instead_of(
                intended,
                self._incidents.worst(),
                offboard_loss=failsafe.OFFBOARD_LOSS.get(
                    int(self.parameters["COM_OBL_RC_ACT"]), Action.POSITION
                ),
                offboard_signal=self.offboard_signal,
                position_ok=position_ok,
                precise=self.ekf.precise(self.now_us),
            )
        if action is not self.action:
            worse = action > self.action
            self.action = action
            if worse and action > Action.WARN:
                self.say(2, "Failsafe activated")
        if action in (Action.DISARM, Action.TERMINATE):
            self.disarm("external command")
            return
        mode = failsafe.MODES.get(action, intended)
        if mode is not self.mode:
            self._change(mode)

    # --- modes and arming ---------------------------------------------------------------------

    def _change(self, mode: Mode) -> None:
        """Fly this from now on."""
        before, self.mode = self.mode, mode
        if mode is Mode.OFFBOARD and before is not Mode.OFFBOARD:
            self.target = None
        if before is Mode.MISSION:
            self.mission.pause()
        if mode is Mode.MISSION:
            self.mission.begin()
        self._begin(mode, before)

    def _intend(self, mode: Mode) -> None:
        """Want this mode from now on; if nothing forbids it, it is flown at once."""
        self.intended = mode
        self._incidents.forgive()
        if mode not in (Mode.LAND, Mode.RTL, Mode.TAKEOFF):
            self._after_disarming = mode
        if mode is self.mode:
            self._begin(mode, mode)
        self._select()

    def command_mode(
        self,
        mode: Mode,
        *,
        takeoff: tuple[float, float, float] | None = None,
        reposition: tuple[float, float, float, float] | None = None,
        land: tuple[float, float] | None = None,
    ) -> Result:
        """Request a mode.  On the ground, disarmed, every mode is accepted."""
        if self.armed and not self._can_run(mode):
            return Result.TEMPORARILY_REJECTED
        self.takeoff_place, self.reposition, self.land_place = takeoff, reposition, land
        self._intend(mode)
        return Result.ACCEPTED

    def _can_run(self, mode: Mode) -> bool:
        """Whether it has what the mode needs."""
        precise = self.ekf.precise(self.now_us)
        offboard_ok = self.offboard_signal and precise
        return failsafe.can_run(mode, position_ok=precise, offboard_ok=offboard_ok)

    def _can_arm(self, position_ok: bool, signal: bool) -> bool:
        """Whether the mode now flown can be armed in."""
        if self.mode in MANUAL_MODES:
            return self.pilot_present
        if self.mode is Mode.MISSION and not self.mission.items:
            return False
        if self.mode is Mode.OFFBOARD:
            return signal and position_ok
        return self.mode is Mode.DESCEND or position_ok

    @property
    def armable(self) -> bool:
        """Whether it could be armed now."""
        return self.now_us >= ARMABLE_US and self._can_arm(
            self.estimate.position_ok, self.offboard_signal
        )

    def arm(self, *, forced: bool) -> Result:
        """Start the motors, or say why not."""
        if self.armed:
            return Result.ACCEPTED
        if not forced and not self.armable:
            self.say(2, "Arming denied: Resolve system health failures first")
            return Result.TEMPORARILY_REJECTED
        now_us = self.now_us
        self.armed = True
        self._still = False
        self._armed_us, self._landed_us, self._contact_us = now_us, None, None
        if self.estimate.position_ok:
            self.home = self.estimate.place
        self.say(6, "Armed by external command")
        self._begin(self.mode, self.mode)
        return Result.ACCEPTED

    def disarm(self, by: str) -> None:
        """Stop the motors.  The mode returns to the one last commanded for flight."""
        if not self.armed:
            return
        self.armed = False
        self._disarmed_us = self.now_us
        self.landed = self.landed or self._contact_us is not None
        self._incidents.forget()
        self.intended = self._after_disarming
        self.say(6, f"Disarmed by {by}")
        self.action = Action.NONE
        if self.intended is not self.mode:
            self._change(self.intended)

    def crash(self) -> Sequence[Reply]:
        """It has hit something, which its failure detector notices at once."""
        self.disarm("failure detector")
        said, self._said = self._said, []
        return said

    def _disarm_by_itself(self) -> None:
        """COM_DISARM_LAND after landing, COM_DISARM_PRFLT after arming without take-off."""
        now_us = self.now_us
        if self._landed_us is not None:
            wait_s = self.parameters["COM_DISARM_LAND"]
            if wait_s > 0.0 and now_us - self._landed_us >= wait_s * 1e6:
                self.disarm("landing")
        else:
            wait_s = self.parameters["COM_DISARM_PRFLT"]
            if wait_s > 0.0 and now_us - self._armed_us >= wait_s * 1e6:
                self.disarm("auto preflight disarming")

    def _system_status(self) -> int:
        if self.armed:
            return State.CRITICAL if self.action > Action.WARN else State.ACTIVE
        return State.STANDBY if self.armable else State.UNINIT

    def _landed_state(self) -> int:
        if self.landed:
            return Landed.ON_GROUND
        if self.mode is Mode.TAKEOFF:
            return Landed.TAKEOFF
        return Landed.LANDING if self.mode is Mode.LAND else Landed.IN_AIR

    # --- boot ---------------------------------------------------------------------------------

    @property
    def _reference(self) -> Place:
        """The origin, or where it is before there is one."""
        return self.origin or self.estimate.place

    def _find_origin(self) -> None:
        """With the first GPS that is fused: origin and home, and the origin is told once."""
        if self.estimate.position_ok:
            self._set_origin(self.estimate.place)
            self.home = self.estimate.place

    def _set_origin(self, place: Place) -> None:
        self.origin = place
        self.projection = Projection(place.latitude_deg, place.longitude_deg)
        self.emit(SendTelemetry(message=49))


Handler = Callable[[Px4, Command], Result]


def _unsupported(_px4: Px4, _command: Command) -> Result:
    return Result.UNSUPPORTED
