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
from vehicle_sim.autopilot.estimator import Timing, state_flags
from vehicle_sim.autopilot.guards import Zones
from vehicle_sim.autopilot.legs import RETURN, Does, Leg
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
_BY_HAND, _BY_ITSELF, _BY_COMMAND = 0x51, 0x1D, 0x11
"""base_mode as recorded: 29 in AUTO, 17 in OFFBOARD."""
_AUTO: Final = {"Hold": 3, "Takeoff": 2, "Mission": 4, "Return": 5, "Land": 6}
_MANUAL: Final = {"Manual": 1, "Altitude": 2, "Position": 3, "Acro": 5, "Stabilized": 7}
"""The sub mode of those, the main mode of these."""
MODES: Final = (
    *(Mode(name, 4 << 16 | sub << 24, "fly_legs", base=_BY_ITSELF) for name, sub in _AUTO.items()),
    *(
        Mode(name, main << 16, "sink", needs_position=name == "Position", base=_BY_HAND)
        for name, main in _MANUAL.items()
    ),
    Mode("Offboard", 6 << 16, "fly_target", base=_BY_COMMAND),
    # a failsafe only, told as Land
    Mode("Descend", 4 << 16 | 6 << 24, "descend", needs_position=False, base=_BY_ITSELF),
)

_GOOD: Final = 0x37F
_TIMING: Final = Timing(
    # px4-gps-loss.tlog and px4.md 8
    stages=((0.0, 0x0E5),),
    flags=state_flags(good=_GOOD, glitch=_GOOD, yields=_GOOD, lost=0x365, stopped=0x065),
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
    streamed, rows = frozenset(rates_hz) | {231}, table("px4", parameters)
    return core.Firmware(
        family="px4",
        vehicle_type=vehicle_type,
        autopilot=12,
        capabilities=0xE8FF,
        software_version=0x01110040,
        custom_version=bytes((0, 0, 0, 178, 57, 165, 123, 187)),
        first_heartbeat_us=1_600_000,  # px4.md 3
        rates_hz=rates_hz,
        # without what other parts of PX4 send: SET_MESSAGE_INTERVAL fails as for unknown messages
        streamable=(streamed | _NOT_TOLD | {GPS_GLOBAL_ORIGIN, 77}) - {0, 42},
        requestable=streamed | {42, 46, GPS_GLOBAL_ORIGIN, 77, core.AUTOPILOT_VERSION},
        # in the alphabetic order that PX4 numbers them in, then the faults'
        table=(*sorted(rows, key=lambda row: row.name), *sim_parameters("px4")),
        modes=MODES,
        orders={20: "Return"},
        pilot="Position",
        missions="Mission",
        first_item=0,
        timing=_TIMING,
        frame=Projection,
        ids=("MAV_SYS_ID", "MAV_COMP_ID"),
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
    "Action", "NONE POSITION ALTITUDE STABILIZED HOLD RETURN LAND DESCEND DISARM", start=0
)
"""failsafe_action_t: the worse, the greater."""
_CHOICES: Final = {
    "COM_OBL_RC_ACT": "POSITION ALTITUDE STABILIZED RETURN LAND HOLD DISARM DISARM",
    "GF_ACTION": "NONE NONE HOLD RETURN DISARM LAND",
    "COM_LOW_BAT_ACT": "NONE NONE LAND RETURN",
    "NAV_DLL_ACT": "NONE HOLD RETURN LAND NONE DISARM DISARM",
}
"""What the values of these parameters ask for; another one asks for the first."""
_WELL: Final = (Action.NONE,) * 3
_STILL_S: Final = 2.0  # disarmed to the estimator's constant-position mode
_LOW_M: Final = 1.2
"""Below this, in the air, there is no height above ground: flags 0x33f in the logs."""
_STILL_FLAG, _HEIGHT_FLAG = 0x080, 0x040
NOWHERE: Final = Place(_NAN, _NAN, _NAN)


class Px4(core.Autopilot):
    """One vehicle's autopilot."""

    taken_off_s = 0.0  # at its height, until a take-off is over
    # How a kind of vehicle flies (px4copter.py, px4plane.py).
    restart: Callable[[], None]  # from what the vehicle does: another mode begins
    fly_leg: Callable[[], None]  # another one, or none any more
    stops_at: Callable[[], Place]  # where it holds, told nothing else
    way_home: Callable[[], list[Leg]]

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
        self._signal_s = -math.inf  # when a setpoint was seen
        self._breached = False  # the fence, when it last knew where it was
        self._zones = Zones(self.plans)
        self._ill = _WELL  # what ground station, battery and fence ask for now
        self._incident = Action.NONE
        """What they have brought about: it stays when they are well again, until another mode is
        commanded."""
        self._after_disarming = self.mode
        self._disarmed_s = -_STILL_S
        self.handlers |= {
            21: self._land_or_take_off,
            22: self._land_or_take_off,
            176: self._set_mode_number,
            178: self._change_speed,
            192: self._reposition,
            300: self._start_mission,
        }

    # --- each step ----------------------------------------------------------------------------

    def look(self) -> None:
        """In every step, before the checks."""
        if self.estimate.origin is not None:
            self.local_m = self.frame.ned_m(self.estimate)

    @property
    def offboard_signal(self) -> bool:
        """A setpoint was seen within COM_OF_LOSS_T."""
        return self.now_s - self._signal_s <= self.parameters["COM_OF_LOSS_T"]

    @property
    def base(self) -> Place:
        """Home, or what comes nearest to it."""
        return self.home or self.frame.origin

    def check(self) -> None:
        """Ten times a second: arming checks, incidents."""
        p = self.parameters
        self._check_estimate()
        if self.mode.name == "Takeoff" and self.route.leg is None:  # COM_TAKEOFF_ACT 0
            self.set_mode("Hold", self.asked.at(_NAN))  # never down
        if self.armed:
            left, lost_s = self.battery.remaining, self.now_s - self.station_s
            lost = p["COM_DL_LOSS_T"] < lost_s < math.inf
            battery = self._choice("COM_LOW_BAT_ACT", applies=left <= p["BAT_CRIT_THR"])
            if battery is Action.RETURN and left <= p["BAT_EMERGEN_THR"]:
                battery = Action.LAND
            station = self._choice("NAV_DLL_ACT", applies=lost)
            ill = (station, battery, self._choice("GF_ACTION", applies=self._breaches()))
            worse = (is_now for was, is_now in zip(self._ill, ill, strict=True) if is_now > was)
            self._ill, self._incident = ill, max((self._incident, *worse))
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
        silent_s = max(now_s - estimate.used_s - 0.2, 0.0)
        settled_m = 0.29 * min(now_s / 8.0, 1.0)
        estimate.horizontal_accuracy_m = settled_m + silent_s * (0.06 + 0.0335 * silent_s)
        if not estimate.aiding:
            estimate.velocity_variance = estimate.horizontal_variance = _NAN

    def _breaches(self) -> bool:
        """Whether it is outside of the fence, as far as it knows where it is."""
        p, place, home, before = self.parameters, self.estimate.place, self.base, self._breached
        if self.estimate.position_ok:
            away_m = math.dist(self.local_m[:2], self.frame.ned_m(home)[:2])
            above_m = place.altitude_amsl_m - home.altitude_amsl_m
            beyond = 0.0 < p["GF_MAX_HOR_DIST"] < away_m or 0.0 < p["GF_MAX_VER_DIST"] < above_m
            self._breached = beyond or self._zones.forbid(self.frame, place, union=True)
        if self._breached and not before:
            self.say(4, "Geofence: approaching or outside geofence\t")
        return self._breached

    def _choice(self, name: str, *, applies: bool = True) -> Action:
        """What the value of this parameter asks for."""
        choices, value = _CHOICES[name].split(), int(self.parameters[name])
        choice = choices[value if 0 <= value < len(choices) else 0]
        return Action[choice] if applies else Action.NONE

    def _failsafe(self) -> Action:
        """What is to be done instead of the wanted mode; NONE while that can be flown."""
        intended, ok, precise = self.intended, self.estimate.position_ok, self.estimate.precise
        action = self._incident
        if intended.name == "Offboard":
            lost = not (self.offboard_signal and precise)
            action = max(action, self._choice("COM_OBL_RC_ACT", applies=lost))
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
        if self.action > before:
            self.say(2, "Failsafe activated\t")
        if self.action is Action.DISARM:
            self.disarm("external command")
        else:
            self._change(self.modes.get(self.action.name.title(), self.intended))

    # --- modes and arming ---------------------------------------------------------------------

    def _change(self, mode: Mode) -> None:
        """Fly this from now on, if it is not flown already."""
        before, self.mode = self.mode, mode
        if mode is before:
            return
        self.route.stop()
        self.restart()
        if mode.name == "Offboard":
            self.target = None
        elif mode.name == "Mission":
            self.seek(0 if self.route.complete else self.route.current)
        self.begin()

    def begin(self) -> None:
        """Fly the mode from now on: the legs of all AUTO modes but the mission."""
        position, legs = self.estimate.place, list[Leg]()
        match self.mode.name:
            case "Takeoff":  # never down
                up_m = self.base.altitude_amsl_m + self.parameters["MIS_TAKEOFF_ALT"]
                place = self.asked_or(position.at(up_m))
                if place.altitude_amsl_m < position.altitude_amsl_m:
                    place = place.at(up_m if self.landed else position.altitude_amsl_m)
                legs = [Leg(Does.CLIMB, place, self.taken_off_s, RETURN)]
            case "Hold":
                place = self.asked_or(self.stops_at())
                legs = [Leg(Does.GO, place, math.inf, RETURN, yaw_rad=self.asked_yaw_rad)]
            case "Land":
                legs = [Leg(Does.LAND, self.asked_or(self.stops_at()), command=RETURN)]
            case "Return":
                legs = self.way_home()
            case _:
                return
        self.route.fly(legs, self.now_s)
        self.fly_leg()

    on_armed = begin

    def set_mode(self, name: str, asked: Place = NOWHERE, yaw_rad: float = _NAN) -> bool:
        """Want this mode, at a place; if nothing forbids it, it is flown at once.

        On the ground, disarmed, every one is accepted.
        """
        mode = self.modes[name]
        able = self.estimate.precise or not mode.needs_position
        if self.armed and not (able and (name != "Offboard" or self.offboard_signal)):
            return False
        self.intended, self.asked, self.asked_yaw_rad = mode, asked, yaw_rad
        self._incident = Action.NONE
        if name not in ("Land", "Return", "Takeoff"):
            self._after_disarming = mode
        if mode is self.mode:
            self.begin()
        self._select()
        return True

    def _set_mode_number(self, command: Command) -> Result:
        """p1 bit 0 says that p2 and p3 are PX4's own numbers; of other modes than AUTO p3 is 0."""
        flags, main, sub = command.parameters[:3]
        if not all(map(math.isfinite, (flags, main, sub))) or not int(flags) & 1:
            return Result.TEMPORARILY_REJECTED
        number = int(main) << 16 | (int(sub) << 24 if int(main) == 4 else 0)
        name = next((mode.name for mode in MODES if mode.number == number), None)
        return self.done(name is not None and self.set_mode(name))

    def refusal(self) -> str | None:
        """Why it may not be armed now, in the mode that is flown; by hand it has no pilot."""
        has = {"Offboard": self.offboard_signal, "Mission": bool(self.plans[PlanKind.MISSION])}
        able = has.get(self.mode.name, self.mode.base != _BY_HAND) and self.estimate.position_ok
        able = able and self.now_s >= self.firmware.prearm_s
        return None if able else "Resolve system health failures first"

    def on_disarmed(self) -> None:
        """The mode returns to the one last commanded for flight."""
        self._disarmed_s = self.now_s
        self.landed = self.landed or self.touched_s is not None
        self._ill, self._incident = _WELL, Action.NONE
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
        frame, home_m = command.frame or 0, self.base.altitude_amsl_m
        height_m = values.height_amsl_m(frame, altitude_m, home_m, self.ground_m)
        return Place(latitude_deg, longitude_deg, altitude_m if height_m is None else height_m)

    def asked_or(self, otherwise: Place) -> Place:
        """What of a place was asked for, and of `otherwise` what was not."""
        height_m = self.asked.altitude_amsl_m
        place = self.asked if given(self.asked) else otherwise
        return place.at(otherwise.altitude_amsl_m if height_m != height_m else height_m)

    def _land_or_take_off(self, command: Command) -> Result:
        name = {21: "Land", 22: "Takeoff"}[command.number]
        return self.done(self.set_mode(name, self._asked_by(command)))

    def _reposition(self, command: Command) -> Result:
        """p2 bit 0 changes to Hold; a place outside of the fence is refused."""
        _, flags, _, yaw_rad = command.parameters[:4]
        asked = self._asked_by(command)
        # of setpoints none is checked
        if given(asked) and self._zones.forbid(self.frame, asked.at(0.0), union=True):
            return Result.DENIED
        if self.mode.name != "Hold" and not (math.isfinite(flags) and int(flags) & 1):
            return Result.UNSUPPORTED
        yaw_rad = yaw_rad if math.isfinite(yaw_rad) else _NAN
        return self.done(self.set_mode("Hold", asked, yaw_rad))

    def _change_speed(self, command: Command) -> Result:
        """Accepted always, of effect in AUTO modes only (px4.md 3)."""
        speed_m_s = command.parameters[1]
        if math.isfinite(speed_m_s):
            self.speed_m_s = speed_m_s if speed_m_s > 0.0 else None
        return Result.ACCEPTED

    # --- missions -----------------------------------------------------------------------------

    def begin_leg(self, speed_m_s: float | None) -> None:
        """Another leg of the mission, or none any more; the speed that was asked for before it."""
        self.speed_m_s = speed_m_s or self.speed_m_s
        if self.is_at(Does.RETURN):
            self.set_mode("Return")
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
            self.route.rewind()
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
            if self.mode.name == "Offboard":
                self.target = self._in_local_frame(target)
        return ()

    def _in_local_frame(self, target: Target) -> Target:
        if not target.is_global or not given(target.position):
            return target
        latitude_deg, longitude_deg, z_m = target.position
        origin_m, home_m = self.frame.origin.altitude_amsl_m, self.base.altitude_amsl_m
        # the sign of the home's height is wrong in PX4 (px4.md 1, item 6), and so it is here
        zero_m = {5: -origin_m, 6: origin_m - home_m}.get(target.frame, self.ground_m - origin_m)
        north_m, east_m, _ = self.frame.ned_m(Place(latitude_deg, longitude_deg, 0.0))
        return target._replace(position=(north_m, east_m, -z_m - zero_m))

    def status(self) -> values.Status:
        """The status for telemetry."""
        armed, mode, fails = self.armed, self.mode, self.armed and self.action > Action.NONE
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
            waypoint=self.waypoint() if armed and mode.base == _BY_ITSELF else None,
            intended_mode=self.intended.number,
        )
