"""What PX4's multicopter and aeroplane share: modes, arming, commands, failsafes, what is told.

Source: px4.md 1 to 3 and 6 to 8, and the recorded flights (1.17).  Results of commands that were
not measured are those of the source: a mode that cannot run is TEMPORARILY_REJECTED.
"""

import enum
import math
from collections.abc import Callable, Sequence
from typing import Final

from vehicle_sim.autopilot import core, values
from vehicle_sim.autopilot.core import GPS_GLOBAL_ORIGIN, Mode
from vehicle_sim.autopilot.earth import Projection
from vehicle_sim.autopilot.estimator import Timing, told
from vehicle_sim.autopilot.guards import Zones
from vehicle_sim.autopilot.legs import Does
from vehicle_sim.autopilot.setpoints import Target, given, read_by_px4
from vehicle_sim.autopilot.values import Command, Landed, Place, Reply, Result, State
from vehicle_sim.faults import sim_parameters
from vehicle_sim.parameters import table
from vehicle_sim.plans import PlanKind

_NAN: Final = math.nan

# --- on the wire ----------------------------------------------------------------------------------

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


def _mode(name: str, main: int, sub: int, flies: str, base: int, *, needs: bool = True) -> Mode:
    return Mode(name, main << 16 | sub << 24, flies, needs_position=needs, base=base)


_BY_HAND, _BY_ITSELF, _BY_COMMAND = 0x51, 0x1D, 0x11
"""base_mode as recorded: 29 in AUTO, 17 in OFFBOARD."""
MODES: Final = (
    _mode("Hold", 4, 3, "hold", _BY_ITSELF),
    _mode("Manual", 1, 0, "sink", _BY_HAND, needs=False),
    _mode("Altitude", 2, 0, "sink", _BY_HAND, needs=False),
    _mode("Position", 3, 0, "sink", _BY_HAND),
    _mode("Acro", 5, 0, "sink", _BY_HAND, needs=False),
    _mode("Stabilized", 7, 0, "sink", _BY_HAND, needs=False),
    _mode("Offboard", 6, 0, "fly_target", _BY_COMMAND, needs=False),
    _mode("Takeoff", 4, 2, "climb", _BY_ITSELF),
    _mode("Mission", 4, 4, "fly_mission", _BY_ITSELF),
    _mode("Return", 4, 5, "fly_back", _BY_ITSELF),
    _mode("Land", 4, 6, "land", _BY_ITSELF),
    _mode("Descend", 4, 6, "descend", _BY_ITSELF, needs=False),
)
"""Descend is a failsafe only, told as AUTO:LAND."""
_NAMES: Final = {mode.number: mode.name for mode in reversed(MODES)}
NAVIGATED: Final = frozenset({"Takeoff", "Hold", "Mission", "Return", "Land"})
"""Modes in which the navigator has a place to go to."""

_GOOD: Final = 0x37F
_TIMING: Final = Timing(
    # px4-gps-loss.tlog and px4.md 8
    stages=((0.0, 0x0E5),),
    flags=told(good=_GOOD, glitch=_GOOD, yields=_GOOD, lost=0x365, stopped=0x065),
    origin_s=2.0,  # between 1.65 and 2.65 s of px4-offboard-short.tlog
    good_s=2.0,
    gate_m=5.375,  # about EKF2_GPS_P_GATE (5) standard deviations of what is recorded
    yields_s=6.875,  # source: reset_timeout_max 7 s, from the last fix that was used
    lost_s=5.06,  # EKF2_NOAID_TOUT 5 s: 80.97 to 86.06 s in the log
    stopped_s=7.2,  # "GNSS data fusion stopped": at 88.19 s
    back_s=1.24,  # "fusion started": 110.97 to 112.20 s
    trusted_s=1.0,  # Land: at 113.21 s
    precise_s=1.2,  # all else: at 113.4 s
    follows=0.06,  # at 8 Hz: smooths over about two seconds
    drift_m_s=0.2,
    drift_m_s2=0.05,  # 31 m after 31 s
    sink_m_s=-0.05,  # 1.2 m below the truth after 26 s
    jump_s=0.25,  # 31 m in a second
    noise_m_s=0.1,  # hover of px4-offboard-8mps.tlog, whose position wanders by 0.13 m
    velocity_ratio=0.05,
    freezes=False,
)


def firmware(parameters: str, *, vehicle_type: int, rates_hz: dict[int, float]) -> core.Firmware:
    """PX4 on its onboard link (px4.md 2), for one kind of vehicle."""
    told, rows = frozenset(rates_hz) | {231}, table("px4", parameters)
    return core.Firmware(
        family="px4",
        vehicle_type=vehicle_type,
        autopilot=12,
        capabilities=0xE8FF,
        software_version=0x01110040,
        custom_version=bytes((0, 0, 0, 178, 57, 165, 123, 187)),
        first_heartbeat_us=1_600_000,  # px4.md 3
        rates_hz=rates_hz,
        streamable=(told | _NOT_TOLD | {GPS_GLOBAL_ORIGIN, 77}) - _NOT_STREAMABLE,
        requestable=told | {42, 46, GPS_GLOBAL_ORIGIN, 77, core.AUTOPILOT_VERSION},
        # in the alphabetic order that PX4 numbers them in, then the faults'
        table=(*sorted(rows, key=lambda row: row.name), *sim_parameters("px4")),
        modes=MODES,
        orders={20: "Return"},
        pilot="Position",
        missions="Mission",
        first_item=0,
        timing=_TIMING,
        frame=Projection,
        prearm_s=3.5,  # heartbeat 0 at 2.6 s, 3 at 3.6 s of the log
        first_check_s=0.06,  # events at x.06 s in the logs
        believes_landing_s=1.8,  # contact to "landing detected": 54.6 to 56.4 s of offboard-short
        refused=Result.TEMPORARILY_REJECTED,
        arms="Armed by external command\t",
        disarms="Disarmed by {}\t",
        cannot_arm="Arming denied: {}\t",
    )


# --- failsafes: which mode is flown instead of the wanted one (px4.md 6 to 8) ---------------------

Action = enum.IntEnum(
    "Action",
    "NONE WARN POSITION ALTITUDE STABILIZED HOLD RETURN LAND DESCEND DISARM TERMINATE",
    start=0,
)
"""failsafe_action_t: the worse, the greater."""
_CHOICES: Final = {
    "COM_OBL_RC_ACT": "POSITION ALTITUDE STABILIZED RETURN LAND HOLD TERMINATE DISARM",
    "GF_ACTION": "NONE WARN HOLD RETURN TERMINATE LAND",
    "NAV_DLL_ACT": "NONE HOLD RETURN LAND NONE TERMINATE DISARM",
}
"""What the values of these parameters ask for; another one asks for the first."""
_STILL_S: Final = 2.0  # disarmed to the estimator's constant-position mode
_LOW_M: Final = 1.2
"""Below this, in the air, there is no height above ground: flags 0x33f in the logs."""
_STILL_FLAG, _HEIGHT_FLAG = 0x080, 0x040
_NAV_LAND: Final = 21
_TEXTS: Final = {
    "fence": (4, "Geofence: approaching or outside geofence\t"),
    "battery": (2, "Critical battery level, land now\t"),
}
"""What is said when one of these begins or gets worse."""
NOWHERE: Final = Place(_NAN, _NAN, _NAN)


class Px4(core.Autopilot):
    """One vehicle's autopilot."""

    fly_leg: Callable[[], None]  # of the mission and no return; or none any more

    def __init__(self, boot: core.Boot) -> None:
        super().__init__(boot)
        self.intended = self.mode
        """The mode that is wanted; `mode` is flown."""
        self.action = Action.NONE
        self.local_m: values.Vector = (0.0, 0.0, 0.0)
        """The estimate in the local frame: north, east, down."""
        self.target: Target | None = None
        """The newest one that OFFBOARD flies, in the local frame; None: none since it began."""
        self.asked, self.asked_yaw_rad = NOWHERE, _NAN
        """Where the command that brought about the mode wants it; NaN: not given."""
        self.speed_m_s: float | None = None
        """DO_CHANGE_SPEED, in AUTO modes."""
        self.offboard_signal = False
        self._signal_s = -math.inf
        """A setpoint was seen within COM_OF_LOSS_T, as of the last check; and when it was."""
        self._breached = False  # the fence, when it last knew where it was
        self._zones = Zones(self.plans)
        self._ill: dict[str, Action] = {}  # what fence, ground station and battery ask for now
        self._incidents: dict[str, Action] = {}
        """What they have brought about: it stays when they are well again, until another mode is
        commanded."""
        self._after_disarming = self.mode
        self._disarmed_s = -_STILL_S
        self.handlers |= {
            21: self._land_or_take_off,
            22: self._land_or_take_off,
            176: self._set_mode_number,
            178: self._change_speed,
            179: self._set_home,
            192: self._reposition,
            300: self._start_mission,
            401: lambda _: Result.ACCEPTED,
        } | dict.fromkeys((410, 519, 520), self.tell)

    # --- each step ----------------------------------------------------------------------------

    def look(self) -> None:
        """In every step, before the checks."""
        if self.estimate.origin is not None:
            self.local_m = self.frame.ned_m(self.estimate)

    @property
    def height_m(self) -> float:
        """Above the ground: SIH has a distance sensor."""
        return max(self.vehicle.altitude_amsl_m - self.ground_m, 0.0)

    @property
    def reference(self) -> Place:
        """The origin, or where it is before there is one."""
        return self.estimate.origin or self.estimate.place

    @property
    def base(self) -> Place:
        """Home, or what comes nearest to it."""
        return self.home or self.reference

    def check(self) -> None:
        """Ten times a second: arming checks, incidents."""
        now_s, p = self.now_s, self.parameters
        self._check_estimate()
        self.offboard_signal = now_s - self._signal_s <= p["COM_OF_LOSS_T"]
        if self.armed:
            lost = p["COM_DL_LOSS_T"] < now_s - self.station_s < math.inf
            ill = {
                "ground station": self._choice("NAV_DLL_ACT") if lost else Action.NONE,
                "fence": self._choice("GF_ACTION") if self._breaches() else Action.NONE,
                "battery": self._battery_action(),
            }
            for cause, action in ill.items():
                if action > self._ill.get(cause, Action.NONE):
                    self._incidents[cause] = action
                    if cause in _TEXTS:
                        self.say(*_TEXTS[cause])
            self._ill = ill
        self._select()

    def _check_estimate(self) -> None:
        """Flags and accuracies."""
        estimate, now_s = self.estimate, self.now_s
        estimate.still = not self.armed and now_s - self._disarmed_s >= _STILL_S
        flags = _TIMING.flags.get(estimate.state, _TIMING.stages[0][1])
        if flags == _GOOD:
            low = self.height_m < _LOW_M and not self.landed and self.mode.name != "Takeoff"
            flags |= _STILL_FLAG if estimate.still else 0
            flags &= ~_HEIGHT_FLAG if low else -1
        estimate.flags = flags
        silent_s, returned_s = max(now_s - estimate.used_s - 0.2, 0.0), estimate.returned_s
        settled_m = 0.29 * min(now_s / 8.0, 1.0)
        if returned_s is not None:
            settled_m = 0.29 + 0.73 * math.exp((returned_s - now_s) / 0.7)
        estimate.horizontal_accuracy_m = settled_m + silent_s * (0.06 + 0.0335 * silent_s)
        if not estimate.aiding:
            estimate.velocity_variance = estimate.horizontal_variance = _NAN

    def _breaches(self) -> bool:
        """Whether it is outside of the fence, as far as it knows where it is."""
        home, p, here = self.home, self.parameters, self.estimate.place
        if home is not None and self.estimate.position_ok:
            away_m = math.dist(self.local_m[:2], self.frame.ned_m(home)[:2])
            above_m = here.altitude_amsl_m - home.altitude_amsl_m
            beyond = 0.0 < p["GF_MAX_HOR_DIST"] < away_m or 0.0 < p["GF_MAX_VER_DIST"] < above_m
            self._breached = beyond or self._zones.forbid(self.frame, here, union=True)
        return self._breached

    def _battery_action(self) -> Action:
        """COM_LOW_BAT_ACT: 0 warn, 2 land, 3 return, then land when critical turns emergency."""
        left, choice = self.battery.remaining, int(self.parameters["COM_LOW_BAT_ACT"])
        if left > self.parameters["BAT_CRIT_THR"]:
            return Action.NONE
        if choice == 3 and left > self.parameters["BAT_EMERGEN_THR"]:
            return Action.RETURN
        return Action.LAND if choice in (2, 3) else Action.WARN

    def _choice(self, name: str) -> Action:
        """What the value of this parameter asks for."""
        choices, value = _CHOICES[name].split(), int(self.parameters[name])
        return Action[choices[value if 0 <= value < len(choices) else 0]]

    def _failsafe(self) -> Action:
        """What is to be done instead of the wanted mode; NONE while that can be flown."""
        intended, ok, precise = self.intended, self.estimate.position_ok, self.estimate.precise
        action = max(self._incidents.values(), default=Action.NONE)
        action = action if action > Action.WARN else Action.NONE
        if intended.name == "Offboard":
            if not self.offboard_signal or not precise:
                action = max(action, self._choice("COM_OBL_RC_ACT"))
        elif intended.needs_position and not ok:
            action = max(action, Action.ALTITUDE if intended.base == _BY_HAND else Action.DESCEND)
        if intended.name in ("Land", "Return") and action is Action.RETURN and ok:
            return Action.NONE
        # landing needs less of a position than others: the real one landed for 0.2 s on its way
        # from Descend back to OFFBOARD (px4-gps-loss.tlog)
        if action in (Action.HOLD, Action.RETURN, Action.LAND) and not ok:
            return Action.DESCEND
        if action in (Action.HOLD, Action.RETURN) and not precise:
            return Action.LAND
        return Action.ALTITUDE if action is Action.POSITION and not precise else action

    def _select(self) -> None:
        """Which mode is flown now."""
        before, self.action = self.action, self._failsafe() if self.armed else Action.NONE
        if self.action > max(before, Action.WARN):
            self.say(2, "Failsafe activated\t")
        if self.action >= Action.DISARM:
            self.disarm("external command")
            return
        instead = self.action > Action.WARN
        self._change(self.modes[self.action.name.title()] if instead else self.intended)

    # --- modes and arming ---------------------------------------------------------------------

    def _change(self, mode: Mode) -> None:
        """Fly this from now on, if it is not flown already."""
        before, self.mode = self.mode, mode
        if mode is before:
            return
        self.route.stop()
        if mode.name == "Offboard":
            self.target = None
        elif mode.name == "Mission":
            self.seek(0 if self.route.complete else self.route.current)
        self.begin()

    def intend(self, name: str) -> None:
        """Want this mode from now on; if nothing forbids it, it is flown at once."""
        mode = self.intended = self.modes[name]
        self._incidents.clear()
        if name not in ("Land", "Return", "Takeoff"):
            self._after_disarming = mode
        if mode is self.mode:
            self.begin()
        self._select()

    def set_mode(self, name: str, asked: Place = NOWHERE, yaw_rad: float = _NAN) -> bool:
        """Request a mode, at a place.  On the ground, disarmed, every mode is accepted."""
        able = self.estimate.precise or not self.modes[name].needs_position
        if name == "Offboard":
            able = self.offboard_signal and self.estimate.precise
        if able or not self.armed:
            self.asked, self.asked_yaw_rad = asked, yaw_rad
            self.intend(name)
        return able or not self.armed

    def _set_mode_number(self, command: Command) -> Result:
        """p1 bit 0 says that p2 and p3 are PX4's own numbers; of other modes than AUTO p3 is 0."""
        flags, main, sub = command.parameters[:3]
        if not all(map(math.isfinite, (flags, main, sub))) or not int(flags) & 1:
            return Result.TEMPORARILY_REJECTED
        name = _NAMES.get(int(main) << 16 | (int(sub) << 24 if int(main) == 4 else 0))
        return self.done(name is not None and self.set_mode(name))

    def refusal(self) -> str | None:
        """Why it may not be armed now, in the mode that is flown; by hand it has no pilot."""
        mode, able = self.mode, self.estimate.position_ok and self.now_s >= self.firmware.prearm_s
        if mode.name == "Offboard":
            able = able and self.offboard_signal
        elif mode.name == "Mission":
            able = able and bool(self.plans[PlanKind.MISSION])
        return None if able and mode.base != _BY_HAND else "Resolve system health failures first"

    def on_armed(self) -> None:
        """The mode begins."""
        self.begin()

    def on_disarmed(self) -> None:
        """The mode returns to the one last commanded for flight."""
        self._disarmed_s = self.now_s
        self.landed = self.landed or self.touched_s is not None
        self._incidents.clear()
        self._ill.clear()
        self.intended, self.action = self._after_disarming, Action.NONE
        self._change(self.intended)

    def disarms_after_s(self) -> float | None:
        """COM_DISARM_LAND after landing, COM_DISARM_PRFLT after arming without take-off."""
        name = "COM_DISARM_PRFLT" if self.landed_s is None else "COM_DISARM_LAND"
        wait_s = self.parameters[name]
        return wait_s if wait_s > 0.0 else None

    # --- commands -----------------------------------------------------------------------------

    def _asked_by(self, command: Command) -> Place:
        """Where p5 to p7 are; a latitude and longitude of 0 are not given."""
        latitude_deg, longitude_deg, altitude_m = command.parameters[4:]
        known = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0  # NaN is not
        if not known or latitude_deg == longitude_deg == 0.0:
            latitude_deg = longitude_deg = _NAN
        altitude_m = altitude_m if abs(altitude_m) <= values.HIGHEST_M else _NAN
        if self.home is not None and altitude_m == altitude_m:
            home_m, frame = self.home.altitude_amsl_m, command.frame or 0
            height_m = values.height_amsl_m(frame, altitude_m, home_m, self.ground_m)
            altitude_m = altitude_m if height_m is None else height_m
        return Place(latitude_deg, longitude_deg, altitude_m)

    def asked_or(self, here: Place) -> Place:
        """What of a place was asked for, and here what was not."""
        height_m = self.asked.altitude_amsl_m
        place = self.asked if given(self.asked) else here
        return place.at(here.altitude_amsl_m if height_m != height_m else height_m)

    def _land_or_take_off(self, command: Command) -> Result:
        name = "Land" if command.number == _NAV_LAND else "Takeoff"
        return self.done(self.set_mode(name, self._asked_by(command)))

    @property
    def takeoff_altitude_m(self) -> float:
        """AMSL: NAV_TAKEOFF's, but never down, or MIS_TAKEOFF_ALT above home."""
        if math.isfinite(self.asked.altitude_amsl_m):
            return max(self.asked.altitude_amsl_m, self.estimate.altitude_amsl_m)
        return self.base.altitude_amsl_m + self.parameters["MIS_TAKEOFF_ALT"]

    def _reposition(self, command: Command) -> Result:
        """p2 bit 0 changes to Hold; a place outside of the fence is refused."""
        _, flags, _, yaw_rad = command.parameters[:4]
        asked = self._asked_by(command)
        # of setpoints none is checked
        if given(asked) and self._zones.forbid(self.frame, asked.at(0.0), union=True):
            return Result.DENIED
        if self.mode.name != "Hold" and not (math.isfinite(flags) and int(flags) & 1):
            return Result.UNSUPPORTED
        return self.done(self.set_mode("Hold", asked, yaw_rad))

    def _change_speed(self, command: Command) -> Result:
        """Accepted always, of effect in AUTO modes only (px4.md 3)."""
        speed_m_s = command.parameters[1]
        if math.isfinite(speed_m_s):
            self.speed_m_s = speed_m_s if speed_m_s > 0.0 else None
        return Result.ACCEPTED

    def _set_home(self, command: Command) -> Result:
        here = command.parameters[0] == 1.0
        if here and not self.estimate.position_ok:
            return Result.TEMPORARILY_REJECTED
        place = self.estimate.place if here else self._asked_by(command)
        return self.set_home(place) if all(map(math.isfinite, place)) else Result.DENIED

    # --- missions -----------------------------------------------------------------------------

    def begin_leg(self, speed_m_s: float | None) -> None:
        """Another leg of the mission, or none any more; the speed that was asked for before it."""
        self.speed_m_s = speed_m_s or self.speed_m_s
        if self.is_at(Does.RETURN):
            self.intend("Return")
        else:
            self.fly_leg()

    def _start_mission(self, command: Command) -> Result:
        """MISSION_START: AUTO:MISSION, and arm if need be."""
        first = command.parameters[0]
        if not self.plans[PlanKind.MISSION]:
            return Result.DENIED
        if math.isfinite(first) and first >= 1.0:
            self.jump(int(first))
        return self.arm() if self.set_mode("Mission") else Result.TEMPORARILY_REJECTED

    def on_plan(self, kind: PlanKind) -> Sequence[Reply]:
        """A mission is flown from its beginning."""
        if kind is PlanKind.MISSION:
            self.route.jumps.forget()
            self.route.current, self.route.complete = 0, False
            if self.mode.name == "Mission":
                self.seek(0)
        return ()

    # --- the rest of the protocol -------------------------------------------------------------

    def on_setpoint(self, setpoint: values.Setpoint) -> Sequence[Reply]:
        """Take a setpoint as a sign of life, and in OFFBOARD as what to fly."""
        if self.estimate.origin is None and setpoint.is_global:
            return ()
        target = read_by_px4(setpoint, self.vehicle.heading_rad)
        if target is not None:
            self._signal_s = self.now_s
            self.offboard_signal = True  # the arming checks run at once for it
            if self.mode.name == "Offboard":
                self.target = self._in_local_frame(target)
        return ()

    def _in_local_frame(self, target: Target) -> Target:
        if not target.is_global or not given(target.position):
            return target
        latitude_deg, longitude_deg, z_m = target.position
        origin_m, home_m = self.reference.altitude_amsl_m, self.base.altitude_amsl_m
        # the sign of the home's height is wrong in PX4 (px4.md 1, item 6), and so it is here
        up_m = {5: z_m - origin_m, 6: z_m - home_m + origin_m}.get(
            target.frame, z_m + self.ground_m - origin_m
        )
        north_m, east_m, _ = self.frame.ned_m(Place(latitude_deg, longitude_deg, 0.0))
        return target._replace(position=(north_m, east_m, -up_m))

    def status(self) -> values.Status:
        """The status for telemetry."""
        armed, mode, fails = self.armed, self.mode, self.armed and self.action > Action.WARN
        in_air = {"Takeoff": Landed.TAKEOFF, "Land": Landed.LANDING}.get(mode.name, Landed.IN_AIR)
        armable = self.refusal() is None
        state = State.STANDBY if armable else State.UNINIT
        if armed:
            state = State.CRITICAL if fails else State.ACTIVE
        return values.Status(
            mode=mode.number,
            base_mode=mode.base | (0x80 if armed else 0),
            system_status=state,
            landed_state=Landed.ON_GROUND if self.landed else in_air,
            prearm_ok=armable,
            waypoint=self.waypoint() if armed and mode.name in NAVIGATED else None,
            intended_mode=self.intended.number,
            mission_current=self.route.current,
            mission_state=self.mission_state(),
            mission_total=len(self.plans[PlanKind.MISSION]) or 65535,
            above_ground_m=self.height_m,
            failsafe=fails,
        )
