"""What ArduCopter and ArduPlane share: modes, commands, arming, failsafes, what there is to tell.

A personality derives from ArduPilot, adds its modes and flies.  Times are microseconds since boot.
What it says (`send_text`, `send`) is collected, and goes out with the answer to
what it is doing.  Sources: ardupilot.md 1, 2, 4, 5 and the recorded flights.
"""

import abc
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilots import (
    HIGHEST_HOME_M,
    Ack,
    Command,
    Estimate,
    FirmwareProfile,
    Place,
    Reboot,
    Reply,
    Result,
    Sender,
    SendMessage,
    SendTelemetry,
    Status,
    Text,
    height_amsl_m,
)
from vehicle_sim.autopilots.ardupilot.ekf3 import Ekf3, Timing
from vehicle_sim.autopilots.ardupilot.fence import NAMES, Fence
from vehicle_sim.autopilots.ardupilot.flat_earth import flat_earth_ned_m
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.dynamics.battery import Battery
from vehicle_sim.parameters import Parameter, Parameters
from vehicle_sim.plans import PlanKind, Plans
from vehicle_sim.sensors.gps import Fix

HEARTBEAT, GPS_GLOBAL_ORIGIN, AUTOPILOT_VERSION, HOME_POSITION = 0, 49, 148, 242
TIMESYNC = 111
CUSTOM_VERSION = b"2598e9d4"

TOLD = frozenset(
    {0, 1, 2, 24, 30, 31, 32, 33, 42, 49, 62, 74, 85, 87, 132, 147, 148, 162, 164, 168, 173, 193}
    | {242, 245}
)
STREAMABLE = TOLD | {
    *(26, 27, 29, 35, 36, 65, 116, 124, 125, 127, 129, 133, 136, 137, 143, 152, 163, 165, 178, 194),
    *(226, 235, 241, 246, 291, 295, 376, 435, 11020, 11030, 11039),
}
"""The others are taken, as the real one takes them, and not told here."""

DATA_STREAMS = {
    2: (1, 42, 24, 62, 162, 87),
    6: (33, 32),
    10: (30, 164),
    11: (74,),
    12: (168, 2, 147, 193, 132, 173),
}
"""MAV_DATA_STREAM: EXTENDED_STATUS, POSITION, EXTRA1, EXTRA2, EXTRA3."""


def profile(*, vehicle_type: int, capabilities: int, rates_hz: dict[int, float]) -> FirmwareProfile:
    """MAVLink as ArduPilot 4.7 speaks it: ardupilot.md 1 and the recorded flights."""
    return FirmwareProfile(
        firmware="ardupilot",
        vehicle_type=vehicle_type,
        autopilot=3,
        capabilities=capabilities,
        software_version=67567616,
        custom_version=CUSTOM_VERSION,
        first_heartbeat_us=900_000,  # ardupilot.md 1
        rates_hz=rates_hz,
        streamable=STREAMABLE,
        requestable=TOLD,
        data_streams=DATA_STREAMS,
    )


_FOR_THE_FLIGHT, _FROM_TAKE_OFF, _ONLY_WHEN_ARMED = 1.0, 2.0, 3.0
"""FENCE_AUTOENABLE: from an automatic take-off to the landing, from it on, or while armed."""
SLOW_US = 100_000
FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0
RECOVERY_US = 10_000_000
"""How long a breached fence is left alone after a mode was chosen inside the breach."""


class ArduPilot(abc.ABC):
    """One vehicle's autopilot; a personality says what it flies like."""

    profile: FirmwareProfile
    MODES: ClassVar[Mapping[int, str]]
    """Names of the modes by number."""
    TABLE: ClassVar[tuple[Parameter, ...]]
    TIMING: ClassVar[Timing]
    PREARM_US: ClassVar[int]
    """When the PREARM_CHECK bit gets healthy."""
    fly: Callable[[float, float], None]
    """Control and move the vehicle for one step of this length, over ground of this height AMSL."""
    HEIGHTS_NEED_HOME: ClassVar[bool]
    """Until there is a home, heights are above where it started."""
    GCS_FAILSAFE: ClassVar[tuple[str, str]]
    """The parameters that say whether a lost ground station matters, and after how long."""
    CRASH_TEXT: ClassVar[str]

    def __init__(
        self,
        vehicle: Vehicle,
        parameters: Mapping[str, float],
        plans: Plans,
        *,
        rng: np.random.Generator,
    ) -> None:
        self.vehicle = vehicle
        self.parameters = Parameters(self.TABLE, parameters)
        self.plans = plans
        self.battery: Battery | None = None
        """The power module's measurements, set by the simulation."""
        self.estimate = Estimate(latitude_deg=0.0, longitude_deg=0.0, altitude_amsl_m=0.0)
        self._out: list[Reply] = []
        self.ekf = Ekf3(self.estimate, self.TIMING, rng)
        self.fence = Fence(self.parameters, plans)
        self.now_us = 0
        self.mode = 0
        self.armed = False
        self.landed = True
        self.home: Place | None = None
        self.mission_current = 0
        self.failsafe = False
        self._was_armed = self._was_aiding = False
        self._attitude_rad = self.rates_rad_s = (0.0, 0.0, 0.0)
        self._slow_us = SLOW_US
        self._gcs_seen_us: int | None = None
        self._gcs_lost = False
        self._battery_low_since_us: int | None = None
        self._battery_acted = 0
        self._fence_left_alone_us = 0
        self._parameters_version = self.parameters.version
        self._handlers = self.handlers()
        self._set_up()

    @abc.abstractmethod
    def _set_up(self) -> None:
        """The end of the construction: the personality's own parts and memory."""

    # --- saying things ----------------------------------------------------------------------------

    def send_text(self, severity: int, text: str) -> None:
        """A STATUSTEXT."""
        self._out.append(Text(severity=severity, text=text))

    def send(self, *messages: int) -> None:
        """Send these telemetry messages once, to all links."""
        self._out.extend(SendTelemetry(message=message) for message in messages)

    def reply(self, reply: Reply) -> None:
        """Anything else."""
        self._out.append(reply)

    def reached(self, number: int) -> None:
        """Send MISSION_ITEM_REACHED to all links."""
        self.reply(SendMessage(message=mavlink.MAVLink_mission_item_reached_message(seq=number)))

    def _taken(self) -> list[Reply]:
        taken = self._out.copy()
        self._out.clear()
        return taken

    # --- each step --------------------------------------------------------------------------------

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float, fix: Fix) -> Sequence[Reply]:
        """Fly on to now_us, over ground of this height, with the newest GPS fix."""
        self.now_us = now_us
        ekf = self.ekf
        if self.home is None:
            self.wait_for_home(fix)
        ekf.step(now_us, self.vehicle, fix)
        if ekf.became_origin:
            self._on_origin()
        if self.parameters.version != self._parameters_version:
            self._parameters_version = self.parameters.version
            self.read_parameters()
        if now_us >= self._slow_us:
            self._slow_us += SLOW_US
            self.slow()
        self.fly(dt_s, ground_amsl_m)
        ekf.follow(self.vehicle)
        if self.home is None and self.HEIGHTS_NEED_HOME:
            self.estimate.altitude_amsl_m = 0.0
        return self._taken() if self._out else ()

    @abc.abstractmethod
    def wait_for_home(self, fix: Fix) -> None:
        """There is no home yet; the newest fix."""

    @abc.abstractmethod
    def read_parameters(self) -> None:
        """Some parameter has changed."""

    def slow(self) -> None:
        """Ten times a second: failsafes, fence."""
        self._watch_attitude()
        if self.ekf.aiding is not self._was_aiding:
            self._was_aiding = self.ekf.aiding
            how = "is using GPS" if self.ekf.aiding else "stopped aiding"
            self.send_text(6, f"EKF3 IMU0 {how}")
        self._check_fence()
        self._check_gcs()
        self._check_battery()

    def _watch_attitude(self) -> None:
        """Rates of turn, from where it pointed a tenth of a second ago."""
        vehicle = self.vehicle
        roll_rad, pitch_rad, yaw_rad = self._attitude_rad
        turned_rad = math.remainder(vehicle.heading_rad - yaw_rad, math.tau)
        self.rates_rad_s = (
            (vehicle.roll_rad - roll_rad) * 1e6 / SLOW_US,
            (vehicle.pitch_rad - pitch_rad) * 1e6 / SLOW_US,
            turned_rad * 1e6 / SLOW_US,
        )
        self._attitude_rad = (vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad)

    @property
    def flying(self) -> bool:
        """Whether flight time counts."""
        return not self.landed

    def _on_origin(self) -> None:
        """The estimator's origin is set, and home with it."""
        self.home = self.ekf.origin
        self.send(GPS_GLOBAL_ORIGIN, HOME_POSITION)

    # --- failsafes --------------------------------------------------------------------------------

    def _check_gcs(self) -> None:
        """After 4.9 s where 5 is set (measured)."""
        enabled, timeout_s = (self.parameters[name] for name in self.GCS_FAILSAFE)
        seen_us = self._gcs_seen_us
        if seen_us is None or self._gcs_lost or not enabled:
            return
        if self.now_us - seen_us >= (timeout_s - 0.1) * 1e6 and self.armed:
            self._gcs_lost = True
            self.on_gcs_failsafe()

    @abc.abstractmethod
    def on_gcs_failsafe(self) -> None:
        """The ground station has gone."""

    def on_heartbeat(self, sender: Sender, vehicle_type: int) -> Sequence[Reply]:
        """Only those of MAV_GCS_SYSID count."""
        del vehicle_type
        if sender.system == self.parameters["MAV_GCS_SYSID"]:
            self._gcs_seen_us = self.now_us
            if self._gcs_lost:
                self._gcs_lost = False
                self.send_text(4, "GCS Failsafe Cleared")
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
                self.send_text(4, f"Battery 1 is {how} {used}")
                if self.armed:
                    self.on_battery_failsafe(int(parameters[action]))
            return
        self._battery_low_since_us = None

    @abc.abstractmethod
    def on_battery_failsafe(self, action: int) -> None:
        """BATT_FS_LOW_ACT or BATT_FS_CRT_ACT."""

    def took_off(self) -> None:
        """An automatic take-off is over (AC_Fence::auto_enable_fence_after_takeoff)."""
        if self.parameters["FENCE_AUTOENABLE"] in (_FOR_THE_FLIGHT, _FROM_TAKE_OFF):
            self.fence.enabled = True
            self.fence.has_floor = True  # whatever its height; not if there is none

    def _check_fence(self) -> None:
        down = not self.armed or self.landed
        if self.parameters["FENCE_AUTOENABLE"] == _FOR_THE_FLIGHT and (down or self.lands):
            self.fence.enabled = False
        if not self.fence.enabled or self.home is None:
            self.fence.forget()
            return
        if down:
            self.fence.forget()
            return
        if not self.ekf.position_ok:
            self.fence.breached = 0
            return
        if self.fence.raises_floor(self.estimate.place, self.home, lands=self.lands):
            self.send_text(5, "Min Alt fence enabled (auto enable)")
        new = self.fence.check(self.estimate.place, self.home, self.now_us)
        if new and self.now_us >= self._fence_left_alone_us:
            names = [name for bit, name in NAMES.items() if new & bit]
            joined = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
            self.send_text(5, f"{joined} fence{'s' if len(names) > 1 else ''} breached")
            self.on_fence_breach(int(self.parameters["FENCE_ACTION"]))

    @property
    @abc.abstractmethod
    def lands(self) -> bool:
        """Whether it comes down to land: the fence has no floor then."""

    @abc.abstractmethod
    def on_fence_breach(self, action: int) -> None:
        """FENCE_ACTION: 0 only says it."""

    # --- modes ------------------------------------------------------------------------------------

    @property
    def mode_name(self) -> str:
        """Name of the flight mode."""
        return self.MODES.get(self.mode, str(self.mode))

    @abc.abstractmethod
    def enter_mode(self, mode: int) -> str | None:
        """Begin to fly in this mode, or say what is missing."""

    def set_mode(self, mode: int) -> bool:
        """Fly in this mode from now on, if it can be."""
        if mode not in self.MODES:
            return False
        if mode == self.mode:
            return True
        refusal = self.enter_mode(mode)
        if refusal is not None:
            self.send_text(4, f"Mode change to {self.MODES[mode]} failed: {refusal}")
            return False
        self.mode = mode
        self.send(HEARTBEAT)
        return True

    # --- commands ---------------------------------------------------------------------------------

    def handlers(self) -> dict[int, Callable[[Command], Result]]:
        """Handlers by MAV_CMD; subclasses add their own."""
        return {
            176: self._do_set_mode,
            179: self._do_set_home,
            207: self._do_fence_enable,
            224: self._do_set_mission_current,
            246: self._reboot,
            400: self._arm_or_disarm,
            401: self._run_prearm_checks,
            410: self._get_home,
            520: self._capabilities,
        }

    def on_command(self, command: Command) -> Sequence[Reply]:
        """Handle a command; returns the replies."""
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
        return Result.ACCEPTED

    def place_of(self, command: Command) -> Place | Result:
        """Where p5 to p7 are; of a COMMAND_LONG above sea level as in frame 0."""
        latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
        if not all(map(math.isfinite, (latitude_deg, longitude_deg, altitude_m))):
            return Result.DENIED
        if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
            return Result.DENIED
        height_m = height_amsl_m(command.frame or 0, altitude_m, self.home_amsl_m)
        if height_m is None:
            return Result.UNSUPPORTED_FRAME
        return Place(latitude_deg, longitude_deg, height_m)

    @property
    def home_amsl_m(self) -> float | None:
        """Height of home, once there is one."""
        return None if self.home is None else self.home.altitude_amsl_m

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
        self.send(HOME_POSITION, GPS_GLOBAL_ORIGIN)
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
        self.fly_item(number)
        return Result.ACCEPTED

    @abc.abstractmethod
    def fly_item(self, number: int) -> None:
        """Another item of the mission is the current one: in AUTO it goes there at once."""

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
        self.send(HOME_POSITION, GPS_GLOBAL_ORIGIN)
        return Result.ACCEPTED

    def _capabilities(self, command: Command) -> Result:
        if command.parameters[0] == 1.0:
            self._out.append(SendTelemetry(message=AUTOPILOT_VERSION, to=command.sender))
        return Result.ACCEPTED

    def _run_prearm_checks(self, command: Command) -> Result:
        del command
        if self.armed:
            return Result.TEMPORARILY_REJECTED
        refusal = self.arming_refusal()
        if refusal is not None:
            self.send_text(2, f"PreArm: {refusal}")
        return Result.ACCEPTED

    # --- arming -----------------------------------------------------------------------------------

    def _arm_or_disarm(self, command: Command) -> Result:
        arm, force = command.parameters[:2]
        if arm == 0.0:
            if self.flying and self.armed and force != FORCE_DISARM:
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
            self.send_text(2, f"Arm: {refusal}")
            return Result.FAILED
        self.armed = self._was_armed = True
        if self.parameters["FENCE_AUTOENABLE"] == _ONLY_WHEN_ARMED:
            self.fence.enabled = True
        if self.ekf.position_ok:
            self.home = self.estimate.place
        self.send(HOME_POSITION, GPS_GLOBAL_ORIGIN)
        self.on_armed()
        return Result.ACCEPTED

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

    @abc.abstractmethod
    def on_armed(self) -> None:
        """The motors may turn: say so."""

    def disarm(self) -> None:
        """Stop the motors, wherever it is."""
        self.armed = False
        if self.parameters["FENCE_AUTOENABLE"] == _ONLY_WHEN_ARMED:
            self.fence.enabled = False

    def crash(self) -> Sequence[Reply]:
        """It has hit something."""
        if self.armed:
            self.send_text(0, self.CRASH_TEXT)
            self.disarm()
        return self._taken()

    # --- the rest of the protocol -----------------------------------------------------------------

    def on_parameter(self, name: str) -> Sequence[Reply]:
        """A parameter has been set from outside."""
        if name == "FENCE_ENABLE":
            self.fence.enabled = bool(self.parameters[name])
        return ()

    def on_plan(self, kind: PlanKind) -> Sequence[Reply]:
        """A mission, fence or rally list was replaced by a client."""
        names = {PlanKind.MISSION: "MIS_TOTAL", PlanKind.FENCE: "FENCE_TOTAL"}
        name, count = names.get(kind, "RALLY_TOTAL"), len(self.plans[kind])
        if kind is PlanKind.FENCE:
            self.fence.load(self.now_us)
        self.parameters[name] = count
        return ()

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

    def local_ned_m(self) -> tuple[float, float, float] | None:
        """Position in the estimator's frame, while it has one."""
        origin = self.ekf.origin
        if origin is None or not self.ekf.aiding:
            return None
        return flat_earth_ned_m(origin, self.estimate.place)

    def status_with(self, **own: Any) -> Status:
        """What there is to tell; `own`: the fields that a personality fills in."""
        return Status(
            mode=self.mode,
            prearm_ok=self.now_us >= self.PREARM_US,
            origin=self.ekf.origin,
            mission_current=self.mission_current,
            mission_total=max(len(self.plans[PlanKind.MISSION]) - 1, 0),
            fence_breached=bool(self.fence.breached),
            fence_breaches=self.fence.breaches,
            fence_present=self.fence.present,
            fence_breach_type=self.fence.breach_type,
            fence_breach_ms=self.fence.breach_us // 1000,
            failsafe=self.failsafe,
            logging=self._was_armed,
            **own,
        )
