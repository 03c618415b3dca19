"""What ArduCopter and ArduPlane share: modes, commands, arming, and what there is to tell.

A personality derives from ArduPilot, adds its modes and flies; what runs by itself (boot,
estimator, failsafes, fence, statistics) is in core.py.  Sources: ardupilot.md 1, 2, 4, 5
and the recorded flights.
"""

import abc
import math
from collections.abc import Callable, Sequence

import numpy as np

from vehicle_sim.autopilots import (
    HIGHEST_HOME_M,
    Ack,
    Command,
    Landed,
    Place,
    Reboot,
    Reply,
    Result,
    SayParameter,
    Send,
    Setpoint,
    State,
    Status,
    Sticks,
    TargetEcho,
    Waypoint,
)
from vehicle_sim.autopilots.ardupilot.core import ArduPilotCore, Due
from vehicle_sim.autopilots.ardupilot.ekf3 import Timing
from vehicle_sim.autopilots.ardupilot.fence import NAMES
from vehicle_sim.autopilots.ardupilot.flat_earth import flat_earth_ned_m
from vehicle_sim.autopilots.ardupilot.style import (
    AUTOPILOT_VERSION,
    GPS_GLOBAL_ORIGIN,
    HEARTBEAT,
    HOME_POSITION,
)
from vehicle_sim.autopilots.attitude import AttitudeTarget
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.parameters import Parameters
from vehicle_sim.plans import PlanKind, Plans

__all__ = ["ArduPilot", "Due"]

FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0
RECOVERY_US = 10_000_000
"""How long a breached fence is left alone after a mode was chosen inside the breach."""
_FRAMES_AMSL, _FRAMES_ABOVE_HOME, _FRAMES_TERRAIN = (0, 5), (3, 6), (10, 11)


class ArduPilot(ArduPilotCore):
    """One vehicle's autopilot; a personality says what it flies like."""

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
        super().__init__(
            vehicle,
            parameters,
            plans,
            timing=timing,
            boot=boot,
            hardware_id=hardware_id,
            rng=rng,
        )
        self._handlers = self.handlers()

    # --- modes ------------------------------------------------------------------------------------

    @property
    def mode_name(self) -> str:
        """The mode it flies in, as its users call it."""
        return self.MODES.get(self.mode, str(self.mode))

    @abc.abstractmethod
    def enter_mode(self, mode: int) -> str | None:
        """Begin to fly in this mode, or say what is missing."""

    def set_mode(self, mode: int) -> bool:
        """Fly in this mode from now on, if it can be."""
        if mode not in self.MODES:
            self.say(4, f"No such mode {mode}")
            return False
        if mode == self.mode:
            return True
        refusal = self.enter_mode(mode)
        if refusal is not None:
            self.say(4, f"Mode change to {self.MODES[mode]} failed: {refusal}")
            return False
        self.mode = mode
        self.send(HEARTBEAT)
        return True

    # --- commands ---------------------------------------------------------------------------------

    def handlers(self) -> dict[int, Callable[[Command], Result]]:
        """What answers which MAV_CMD; a personality adds its own."""
        return {
            176: self._do_set_mode,
            179: self._do_set_home,
            207: self._do_fence_enable,
            224: self._do_set_mission_current,
            241: self._when_disarmed,
            245: self._when_disarmed,
            246: self._reboot,
            400: self._arm_or_disarm,
            401: self._run_prearm_checks,
            410: self._get_home,
            520: self._capabilities,
            42424: self._when_disarmed,  # DO_START_MAG_CAL, which lasts until it is cancelled
            42426: lambda _: Result.ACCEPTED,
        }

    def on_command(self, command: Command) -> Sequence[Reply]:
        """Do what is asked, or say why not."""
        result = Result.UNSUPPORTED
        if command.target_component in (0, 1):
            handler = self._handlers.get(command.number)
            if handler is not None:
                result = handler(command)
        ack = Ack(to=command.sender, command=command.number, result=result)
        return [ack, *self._taken()]

    def _do_set_mode(self, command: Command) -> Result:
        flags, number = command.parameters[:2]
        if not (math.isfinite(flags) and int(flags) & 1):
            return Result.DENIED
        if not math.isfinite(number):
            return Result.FAILED
        was_breached = self.fence.breached
        if not self.set_mode(int(number)):
            return Result.FAILED
        if was_breached and self.fence.enabled:
            self._fence_left_alone_us = self.now_us + RECOVERY_US
            self.fence.breached = was_breached
            self.say(6, "Manual recovery started")
        return Result.ACCEPTED

    def place_of(self, command: Command) -> Place | Result:
        """Where p5 to p7 are; of a COMMAND_LONG above sea level as in frame 0."""
        latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
        frame = command.frame or 0
        if not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude_m))):
            return Result.DENIED
        if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
            return Result.DENIED
        if frame in _FRAMES_ABOVE_HOME and self.home is not None:
            altitude_m += self.home.altitude_amsl_m
        elif frame not in (*_FRAMES_AMSL, *_FRAMES_TERRAIN):
            return Result.UNSUPPORTED_FRAME
        return Place(
            latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_amsl_m=altitude_m
        )

    def _do_set_home(self, command: Command) -> Result:
        if self.ekf.origin is None:
            return Result.FAILED
        p = command.parameters
        if p[0] == 1.0 or (p[4] == 0.0 and p[5] == 0.0 and p[6] == 0.0):
            if not self.ekf.position_ok:
                return Result.FAILED
            self.home = self.estimate.place
        else:
            place = self.place_of(command)
            if isinstance(place, Result):
                return Result.FAILED if place is Result.DENIED else place
            if abs(place.altitude_amsl_m) > HIGHEST_HOME_M:
                return Result.FAILED
            self.home = place
        self.send(HOME_POSITION)
        self.send(GPS_GLOBAL_ORIGIN)
        return Result.ACCEPTED

    def _do_fence_enable(self, command: Command) -> Result:
        if command.parameters[0] not in (0.0, 1.0):
            return Result.FAILED
        self.fence.enabled = command.parameters[0] == 1.0
        return Result.ACCEPTED

    def _do_set_mission_current(self, command: Command) -> Result:
        number = command.parameters[0]
        if not math.isfinite(number):
            return Result.DENIED
        return self.set_mission_current(int(number))

    def set_mission_current(self, number: int) -> Result:
        """MISSION_SET_CURRENT and its command."""
        if not 0 <= number < max(len(self.plans[PlanKind.MISSION]), 1):
            return Result.FAILED
        self.mission_current = number
        return Result.ACCEPTED

    def _when_disarmed(self, command: Command) -> Result:
        """Calibration and storage: there is nothing to do."""
        del command
        return Result.FAILED if self.armed else Result.ACCEPTED

    def _reboot(self, command: Command) -> Result:
        if command.parameters[0] not in (1.0, 3.0):
            return Result.UNSUPPORTED
        if self.armed:
            return Result.FAILED
        self._out.append(Reboot())
        return Result.ACCEPTED

    def _get_home(self, command: Command) -> Result:
        del command
        if self.home is None:
            return Result.FAILED
        self.send(HOME_POSITION)
        self.send(GPS_GLOBAL_ORIGIN)
        return Result.ACCEPTED

    def _capabilities(self, command: Command) -> Result:
        if command.parameters[0] == 1.0:
            self._out.append(Send(message=AUTOPILOT_VERSION, to=command.sender))
        return Result.ACCEPTED

    def _run_prearm_checks(self, command: Command) -> Result:
        del command
        if self.armed:
            return Result.TEMPORARILY_REJECTED
        refusal = self.arming_refusal()
        if refusal is not None:
            self.say(2, f"PreArm: {refusal}")
        return Result.ACCEPTED

    # --- arming -----------------------------------------------------------------------------------

    def _arm_or_disarm(self, command: Command) -> Result:
        arm, force = command.parameters[:2]
        if arm == 0.0:
            if self.armed and not (self.may_disarm or force == FORCE_DISARM):
                return Result.FAILED
            if self.armed:
                self.disarm()
            return Result.ACCEPTED
        if arm != 1.0:
            return Result.UNSUPPORTED
        if self.armed:
            return Result.ACCEPTED
        refusal = None if force in (FORCE_ARM, FORCE_DISARM) else self.arming_refusal()
        if refusal is not None:
            self.say(2, f"Arm: {refusal}")
            return Result.FAILED
        self.armed = self._was_armed = True
        if self.ekf.position_ok:
            self.home = self.estimate.place
        self.send(HOME_POSITION)
        self.send(GPS_GLOBAL_ORIGIN)
        self.on_armed()
        return Result.ACCEPTED

    @property
    def may_disarm(self) -> bool:
        """Without force."""
        return self.landed

    @abc.abstractmethod
    def arming_refusal(self) -> str | None:
        """Why it may not be armed now."""

    def common_refusal(self) -> str | None:
        """What both wait for."""
        if self.now_us < self.PREARM_US:
            return "Waiting for RC" if self.now_us < 3_000_000 else "EKF attitude is bad"
        if self.home is not None and self.fence.enabled and self.ekf.position_ok:
            outside = self.fence.outside(self.estimate.place, self.home)
            if outside:
                return "Vehicle breaching " + ", ".join(n for b, n in NAMES.items() if outside & b)
        return None

    def on_armed(self) -> None:
        """The motors may turn: say so."""
        return

    def disarm(self) -> None:
        """Stop the motors, wherever it is."""
        self.armed = False
        self.ekf.to_first_lane()

    # --- the rest of the protocol -----------------------------------------------------------------

    @abc.abstractmethod
    def on_setpoint(self, setpoint: Setpoint) -> Sequence[Reply]:
        """Steer for this from now on."""

    @abc.abstractmethod
    def on_attitude(self, target: AttitudeTarget) -> Sequence[Reply]:
        """Fly at this attitude from now on."""

    def on_sticks(self, sticks: Sticks) -> Sequence[Reply]:
        """MANUAL_CONTROL is not flown."""
        del sticks
        return ()

    def on_parameter(self, name: str) -> Sequence[Reply]:
        """A parameter has been set from outside; of a vector all three are told."""
        if name == "FENCE_ENABLE":
            self.fence.enabled = bool(self.parameters[name])
        if name.startswith("SIM_GPS1_GLTCH_"):
            return [
                SayParameter(name=f"SIM_GPS1_GLTCH_{axis}") for axis in "XYZ" if axis != name[-1]
            ]
        return ()

    def on_plan(self, kind: PlanKind) -> Sequence[Reply]:
        """A mission, fence or rally list has been replaced from outside."""
        names = {PlanKind.MISSION: "MIS_TOTAL", PlanKind.FENCE: "FENCE_TOTAL"}
        name, count = names.get(kind, "RALLY_TOTAL"), len(self.plans[kind])
        if kind is PlanKind.FENCE:
            self.fence.load(self.now_us)
        if self.parameters[name] != count:
            self.change_parameter(name, count)
        return self._taken()

    @abc.abstractmethod
    def pilot_takes(self) -> Sequence[Reply]:
        """Fault: the pilot changes to the mode that pilots hold the vehicle in."""

    def reset_estimate(self, north_m: float, east_m: float) -> Sequence[Reply]:
        """Fault: the estimator resets and its position jumps by this much."""
        self.ekf.reset(north_m, east_m)
        return self._taken()

    def move_origin(self, north_m: float, east_m: float, up_m: float) -> Sequence[Reply]:
        """Fault: the estimator's origin moves by this much."""
        self.ekf.move_origin(north_m, east_m, up_m)
        self.send(GPS_GLOBAL_ORIGIN)
        return self._taken()

    # --- telling ----------------------------------------------------------------------------------

    @abc.abstractmethod
    def base_mode(self) -> int:
        """base_mode of the heartbeat."""

    @abc.abstractmethod
    def system_status(self) -> State:
        """system_status of the heartbeat."""

    @abc.abstractmethod
    def landed_state(self) -> Landed:
        """What EXTENDED_SYS_STATE says."""

    def target_echo(self) -> TargetEcho | None:
        """POSITION_TARGET_LOCAL_NED."""
        return None

    def waypoint(self) -> Waypoint | None:
        """POSITION_TARGET_GLOBAL_INT."""
        return None

    def local_ned_m(self) -> tuple[float, float, float] | None:
        """Position in the estimator's frame, while it has one."""
        origin = self.ekf.origin
        if origin is None or not self.ekf.aiding:
            return None
        return flat_earth_ned_m(origin, self.estimate.place)

    def status(self) -> Status:
        """What there is to tell."""
        return Status(
            mode=self.mode,
            base_mode=self.base_mode(),
            system_status=self.system_status(),
            landed_state=self.landed_state(),
            prearm_ok=self.now_us >= self.PREARM_US,
            home=self.home,
            origin=self.ekf.origin,
            local_ned_m=self.local_ned_m(),
            target=self.target_echo(),
            waypoint=self.waypoint(),
            mission_current=self.mission_current,
            mission_state=self.mission_state(),
            mission_total=max(len(self.plans[PlanKind.MISSION]) - 1, 0),
            fence_breached=bool(self.fence.breached),
            fence_breaches=self.fence.breaches,
            fence_present=self.fence.present,
            fence_breach_type=self.fence.breach_type,
            fence_breach_ms=self.fence.breach_us // 1000,
            failsafe=self.failsafe,
            logging=self._was_armed,
        )

    def mission_state(self) -> int:
        """MISSION_STATE: 1 no mission, 2 not started, 3 active, 4 paused, 5 complete."""
        return 1 if len(self.plans[PlanKind.MISSION]) < 2 else 2
