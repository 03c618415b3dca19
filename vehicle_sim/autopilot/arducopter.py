"""ArduCopter 4.7 as measured: GUIDED, take-off, landing, returning, AUTO, failsafes.

Source: ardupilot.md 2 to 5 and the recorded flights; submodes and their changes as mode_guided.cpp.
"""

import enum
import math
from collections.abc import Sequence
from typing import ClassVar, Final

from vehicle_sim.autopilot import values
from vehicle_sim.autopilot.ardupilot import EKF3, ArduPilot, firmware
from vehicle_sim.autopilot.copter_control import STILL, Order, PositionControl, Tuning, rate_for
from vehicle_sim.autopilot.core import Boot, Mode
from vehicle_sim.autopilot.earth import FlatEarth, way_m
from vehicle_sim.autopilot.legs import RETURN, Does, Leg, back
from vehicle_sim.autopilot.setpoints import LOCAL_NED, Stop, Target, given, read_by_arducopter
from vehicle_sim.autopilot.values import Command, Place, Reply, Result
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.geodesy import around, metres_per_degree
from vehicle_sim.plans import PlanKind

_HOLDS, _BY_HAND = 0x59, 0x51
"""base_mode: custom mode, manual input, stabilised; and "guided" while it holds a position."""
FIRMWARE: Final = firmware(
    "arducopter",
    vehicle_type=2,
    capabilities=64495,
    rates_hz={0: 1.0, 111: 0.1},
    modes=(
        Mode("STABILIZE", 0, "sink", needs_position=False, base=_BY_HAND),
        Mode("ACRO", 1, "sink", needs_position=False, base=_BY_HAND),
        Mode("ALT_HOLD", 2, "sink", needs_position=False, base=_BY_HAND),
        Mode("AUTO", 3, "fly_legs", armable=False, base=_HOLDS),
        Mode("GUIDED", 4, "fly_target", base=_HOLDS),
        Mode("LOITER", 5, "sink", base=_HOLDS),
        Mode("RTL", 6, "fly_legs", armable=False, base=_BY_HAND),
        Mode("CIRCLE", 7, "sink", armable=False, base=_HOLDS),
        Mode("LAND", 9, "land", needs_position=False, armable=False, base=_BY_HAND),
        Mode("POSHOLD", 16, "sink", base=_HOLDS),
        Mode("BRAKE", 17, "brake", armable=False, base=_HOLDS),
    ),
    orders={17: "LOITER", 20: "RTL", 21: "LAND"},
    pilot="LOITER",
    timing=EKF3,
    ready_s=2.45,
    prearm_s=23.3,
    believes_landing_s=1.57,
    arms="Arming motors",
    disarms="Disarming motors",
)

_GLITCHING: Final = 0x8000  # flag of the estimator: GPS is refused, or was until a moment ago
_FAILSAFES: Final = {
    ("GCS", 5): "LAND",
    ("Fence", 2): "LAND",
    ("Fence", 4): "BRAKE",
    ("Battery", 1): "LAND",
    ("Battery", 4): "LAND",
    ("Battery", 5): "DISARM",
}
"""What FS_GCS_ENABLE, FENCE_ACTION and BATT_FS_LOW_ACT ask for: these modes, else RTL."""
_EKF_CHECKS: Final = 10  # in a row, ten a second, before the failsafe acts
_LIFTS_AFTER_ARMING_S, _LIFTS_AFTER_COMMAND_S = 3.43, 1.45
"""Spooling up: from arming and from the take-off's command to leaving the ground."""
_REACHED_M, _REACHED_S = 0.3, 0.7  # the take-off is over so long after coming so near to its height
_DISARMS_S: Final = 0.505  # from believing that it has landed to disarming
_FAILSAFE_PAUSE_S: Final = 4.0  # LAND_WITH_DELAY_MS: a failsafe's landing waits before it goes down
_RETURN_STAGE_S: Final = 1.55
"""The least that each of climbing and going home takes (stream-faults, 286.2 to 294.7 s)."""
_CLIMBED_M, _OVER_LANDING_M = 2.0, 1.0
"""From its height, and from over the place, a return goes home and a mission lands."""
_BRAKE_M_S2: Final = 7.5
_SINK_M_S, _LAND_LOW_M = 2.5, 10.0
"""PILOT_SPEED_UP; and LAND_ALT_LOW, below which a landing is slow."""
_SLEW_RAD_S: Final = math.radians(60.0)  # ATC_SLEW_YAW
_TURN_1_S: Final = 4.5  # ATC_ANG_YAW_P
_MOVING_SHARE: Final = 0.05  # of WPNAV_SPEED: slower, the way has no direction


Kind = enum.Enum("Kind", "TAKEOFF POSITION PATH VELOCITY PUSH")
"""What GUIDED steers for, its submodes: a path is a position that moves, a push an acceleration
alone; zero velocity is what every setpoint that is not liked leads to."""
_ECHO_MASKS: Final = dict(zip(Kind, (0xDF8, 0xDF8, 0xC00, 0xC07, 0xC3F), strict=True))
"""type_mask of POSITION_TARGET_LOCAL_NED."""


class ArduCopter(ArduPilot):
    """Its modes, on the position controller."""

    gcs_failsafe = "FS_GCS_ENABLE"
    nose_follows_motion: ClassVar[bool] = False
    """Ahead is where it flies, and not where the controller wants to fly."""

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        assert isinstance(boot.vehicle, Copter)
        self.copter = boot.vehicle
        self.control = PositionControl(self.estimate)
        self._target: Place | None = None
        """Place of the newest setpoint, as it has run on since; its velocity and acceleration are
        in `_moves` and `_feed`."""
        self._heard_s = 0.0
        """When that came."""
        self._lands_with_position = True
        self._pauses_until_s = 0.0
        self._ekf_failures = 0
        self._was_glitching = False
        self.read_parameters()
        self._stop_target()
        self.handlers |= {
            22: self._take_off,
            115: self._turn,
            178: self._change_speed,
            192: self._reposition,
            300: self._start_mission,
        }

    def read_parameters(self) -> None:
        """They are read live; the speeds of a submode when it begins."""
        p, limits = self.parameters, self.copter.limits
        lean_rad = math.radians(min(max(p["ANGLE_MAX"] / 100.0, 10.0), 85.0))

        def metres(name: str, most: float = math.inf) -> float:
            return min(max(p[name], 10.0) / 100.0, most)

        climbs = limits.speed_vertical_m_s
        self.tuning = self.control.tuning = Tuning(
            speeds_m_s=(
                metres("WPNAV_SPEED"),
                metres("WPNAV_SPEED_UP", climbs),
                metres("WPNAV_SPEED_DN", climbs),
            ),
            acceleration_m_s2=metres("WPNAV_ACCEL", limits.acceleration_m_s2),
            acceleration_up_m_s2=metres("WPNAV_ACCEL_Z", limits.acceleration_vertical_m_s2),
            jerk_m_s3=max(p["PSC_JERK_XY"], 1.0),
            lean_m_s2=min(GRAVITY_M_S2 * math.tan(lean_rad), limits.acceleration_m_s2),
        )
        self._timeout_s = max(p["GUID_TIMEOUT"], 0.1)

    # --- modes --------------------------------------------------------------------------------

    def can_fly_in(self, name: str) -> bool:
        """Checks are only made in flight, as the real one does."""
        lost = self.modes[name].needs_position and not self.estimate.position_ok
        no_mission = name == "AUTO" and len(self.plans[PlanKind.MISSION]) < 2
        nowhere = name == "RTL" and self.home is None
        return not (self.armed and (lost or no_mission or nowhere))

    def begin(self) -> None:
        """Fly the mode from now on."""
        self._stop_target()
        self.route.stop()
        self._lands_with_position = self.estimate.position_ok
        if self.mode.name == "RTL":
            self._begin_return()
        elif self.mode.name == "AUTO" and not self.jump(self.route.current):
            self.jump(0)

    def _stop_target(self) -> None:
        """No take-off, no yaw, zero velocity: mode_guided.init."""
        self._end_takeoff()
        self._yaw_rad = self._yaw_rate_rad_s = math.nan
        """Where the nose is told to point to, or how fast to turn; NaN: along the way."""
        self._restart(Kind.VELOCITY)

    def _end_takeoff(self) -> None:
        """In GUIDED; the mission's is a leg of it."""
        if self.mode.name == "GUIDED":
            self.route.stop()

    on_disarmed = _end_takeoff

    def _restart(self, kind: Kind) -> None:
        """Another submode: from what the vehicle does now, with the parameters' speeds."""
        self.kind, self._target = kind, None
        self._moves, self._feed = STILL, STILL
        self._speeds_m_s = self.tuning.speeds_m_s
        self.control.start()

    def lands(self) -> bool:
        """In LAND, at the end of RTL, and where AUTO lands."""
        return self.mode.name == "LAND" or self.route.lands

    # --- failsafes ----------------------------------------------------------------------------

    def check(self) -> None:
        """Ten times a second: it cannot fly without a position."""
        super().check()
        estimate, glitches = self.estimate, bool(self.estimate.flags & _GLITCHING)
        if glitches is not self._was_glitching:
            self._was_glitching = glitches
            self.say(2, "GPS Glitch or Compass error" if glitches else "Glitch cleared")
        is_bad = self.armed and estimate.origin is not None and not estimate.position_ok
        failures = self._ekf_failures + 1 if is_bad else self._ekf_failures - 1
        self._ekf_failures = min(max(failures, 0), _EKF_CHECKS)
        if self._ekf_failures == _EKF_CHECKS and not self.failsafe:
            self.say(2, "EKF variance")
            self.failsafe = True
            needy = self.mode.needs_position or self.mode.name == "LAND"
            if needy and self.parameters["FS_EKF_ACTION"]:
                self._land_later()
                self._lands_with_position = False
                self.say(2, "EKF Failsafe: changed to LAND Mode")
        elif self._ekf_failures == 0 and self.failsafe:
            self.failsafe = False
            self.say(2, "EKF Failsafe Cleared")

    def on_failsafe(self, cause: str, action: int) -> None:
        """Disarm on the ground, else as _FAILSAFES says; land if that cannot be."""
        if cause != "Fence":
            self.say(4, f"{cause} Failsafe")
        mode = _FAILSAFES.get((cause, action), "RTL")
        if self.landed or mode == "DISARM":
            self.disarm()
        elif mode == "LAND" or not self.set_mode(mode):
            self._land_later()

    def _land_later(self) -> None:
        self.set_mode("LAND")
        self._pauses_until_s = self.now_s + _FAILSAFE_PAUSE_S

    # --- commands -----------------------------------------------------------------------------

    def _take_off(self, command: Command) -> Result:
        """Straight up, in GUIDED."""
        if command.frame not in (None, 3):  # GLOBAL_RELATIVE_ALT
            return Result.DENIED
        ready = self.armed and self.landed and self.mode.name == "GUIDED"
        if not (ready and self.estimate.position_ok) or self.home is None or self.climbs_out():
            return Result.FAILED
        altitude_m = self.home.altitude_amsl_m + command.parameters[6]
        if not self.estimate.altitude_amsl_m < altitude_m < math.inf:
            return Result.FAILED
        self._restart(Kind.TAKEOFF)
        self._target = self.estimate.place.at(altitude_m)
        self.route.fly([Leg(Does.CLIMB, self._target, _REACHED_S, 0)], self.now_s)
        return Result.ACCEPTED

    def _turn(self, command: Command) -> Result:
        """CONDITION_YAW."""
        angle_deg, _, direction, relative = command.parameters[:4]
        if not 0.0 <= angle_deg <= 360.0 or relative not in (0.0, 1.0):
            return Result.FAILED
        self._yaw_rad = math.radians(angle_deg)
        if relative == 1.0:
            self._yaw_rad = self.copter.heading_rad + math.copysign(self._yaw_rad, direction)
        return Result.ACCEPTED

    def _change_speed(self, command: Command) -> Result:
        """Level, up (type 2) or down (3); of the present submode only.

        Beginning another one reads the parameters again.
        """
        kind, speed_m_s = command.parameters[:2]
        if not 0.0 < speed_m_s < math.inf:
            return Result.FAILED
        level, up, down = self._speeds_m_s
        of_kind = {2.0: (level, speed_m_s, down), 3.0: (level, up, speed_m_s)}
        self._speeds_m_s = of_kind.get(kind, (speed_m_s, up, down))
        return Result.ACCEPTED

    def _reposition(self, command: Command) -> Result:
        """COMMAND_INT only; p2 bit 0 changes to GUIDED first."""
        if command.frame is None:
            return Result.UNSUPPORTED
        flags, place = command.parameters[1], self.place_of(command)
        changes = math.isfinite(flags) and bool(int(flags) & 1)
        if (self.mode.name != "GUIDED" and not changes) or place is None:
            return Result.DENIED
        return self.done(self.set_mode("GUIDED") and self.take(Target(), place))

    def _start_mission(self, _: Command) -> Result:
        return self.done(self.set_mode("AUTO")) if self.armed else Result.FAILED

    # --- setpoints ----------------------------------------------------------------------------

    def on_setpoint(self, setpoint: values.Setpoint) -> Sequence[Reply]:
        """Steer for this from now on; outside GUIDED it is not even read."""
        if self.mode.name != "GUIDED" or self.home is None:
            return ()
        target = read_by_arducopter(setpoint, self.copter.heading_rad)
        if isinstance(target, Stop):
            self._stop_target()
            if target.text:
                self.say(2, target.text)
            return self.taken()
        (x, y, z), place = target.position, None
        if target.is_global and given(target.position):
            height_m = values.height_amsl_m(target.frame, z, self.home.altitude_amsl_m)
            assert height_m is not None
            place = Place(x, y, height_m)
        elif given(target.position):
            about = self.frame if target.frame == LOCAL_NED else FlatEarth(self.estimate.place)
            place = about.place(x, y, z)
        self.take(target, place)
        return ()

    def take(self, target: Target, place: Place | None) -> bool:
        """Steer for it, unless it lies where the fence forbids: that is dropped in silence."""
        if place is not None and self.outside_fence(place):
            return False
        self._end_takeoff()
        moves = given(target.velocity)
        if place is None:
            kind = Kind.VELOCITY if moves else Kind.PUSH
        else:
            kind = Kind.PATH if moves else Kind.POSITION
        if kind is not self.kind:
            self._restart(kind)
        self._target, self._heard_s = place, self.now_s
        self._moves, self._feed = _order(target.velocity), _order(target.acceleration)
        self._yaw_rad, self._yaw_rate_rad_s = target.yaw_rad, target.yaw_rate_rad_s
        return True

    def steer(self) -> None:
        """The target of GUIDED goes on with its velocity, until GUID_TIMEOUT; on the ground too."""
        if self.mode.name != "GUIDED" or self.kind in (Kind.TAKEOFF, Kind.POSITION):
            return
        if self.now_s - self._heard_s > self._timeout_s:
            self._moves, self._feed = STILL, STILL
            self.kind = Kind.VELOCITY if self.kind is Kind.PUSH else self.kind
            return
        (velocity, climb_m_s), (feed, feed_up), dt_s = self._moves, self._feed, self.step_s
        if self._target is not None:
            latitude_deg, longitude_deg, altitude_m = self._target
            half = 0.5 * dt_s * dt_s
            step = velocity * dt_s + feed * half
            north_m, east_m = metres_per_degree(latitude_deg)
            self._target = Place(
                latitude_deg + step.real / north_m,
                around(longitude_deg + step.imag / east_m),
                altitude_m + (climb_m_s * dt_s + feed_up * half),
            )
        if self.kind is not Kind.PUSH:
            self._moves = velocity + feed * dt_s, climb_m_s + feed_up * dt_s

    # --- on the ground ------------------------------------------------------------------------

    def climbs_out(self) -> bool:
        """Whether a take-off goes on."""
        leg = self.route.leg
        return leg is not None and leg.does is Does.CLIMB and leg.command != RETURN

    def wants_up(self) -> bool:
        """Until it has come to the height that it was told."""
        return self.climbs_out() and self.route.arrived_s is None

    def lifts_off(self) -> bool:
        """When a take-off has spooled up."""
        lifts = self.climbs_out() and self.now_s - self.armed_s >= _LIFTS_AFTER_ARMING_S
        lifts = lifts and self.now_s - self.route.began_s >= _LIFTS_AFTER_COMMAND_S
        if lifts:
            self.take_to_the_air()
            self.control.rest()
        return lifts

    def touch_down(self) -> None:
        """Come to rest on the terrain, or in it."""
        self.copter.stand(self.ground_m)
        self.estimate.follow()
        self._stop_target()

    def disarms_after_s(self) -> float | None:
        """Soon after a landing, or after DISARM_DELAY."""
        if self.lands() and self.landed_s is not None:
            return _DISARMS_S
        return self.parameters["DISARM_DELAY"] or None

    # --- flying -------------------------------------------------------------------------------

    def move(self) -> None:
        """Thrust, and turn the nose: ahead, but in RTL (WP_YAW_BEHAVIOR 2)."""
        copter, (level, up) = self.copter, getattr(self, self.mode.flies)()
        copter.advance(level.real, level.imag, up, self.step_s)
        wanted_rad, rate = self._yaw_rad, self._yaw_rate_rad_s
        if wanted_rad != wanted_rad and rate != rate and self.mode.name in ("GUIDED", "AUTO"):
            way = copter.velocity_m_s if self.nose_follows_motion else self.control.velocity
            if abs(way) >= _MOVING_SHARE * self.tuning.speeds_m_s[0]:
                wanted_rad = math.atan2(way.imag, way.real)
        if wanted_rad == wanted_rad:
            rate = _TURN_1_S * math.remainder(wanted_rad - copter.heading_rad, math.tau)
            rate = min(max(rate, -_SLEW_RAD_S), _SLEW_RAD_S)
        if rate == rate:
            copter.heading_rad = (copter.heading_rad + rate * self.step_s) % math.tau

    def _hold(self, climb_m_s: float, *, level: bool = False) -> Order:
        """To a standstill, climbing at this rate; without a position only the lean goes."""
        if level:
            return self.control.level(climb_m_s, self.step_s)
        return self.control.fly((0j, climb_m_s), STILL, self.step_s)

    def fly_target(self) -> Order:
        """GUIDED."""
        if self.route.leg is not None:
            return self.fly_legs()  # a take-off
        if not self.estimate.aiding:
            return self._hold(0.0, level=True)
        return self.control.fly(
            None if self.kind is Kind.PUSH else self._moves,
            self._feed,
            self.step_s,
            self._target,
            self._speeds_m_s,
            paced=self.kind in (Kind.TAKEOFF, Kind.POSITION),
        )

    def brake(self) -> Order:
        """BRAKE."""
        speed = abs(self.estimate.velocity_m_s)
        if speed < 0.5:
            return self._hold(0.0)
        most = min(_BRAKE_M_S2, self.copter.limits.acceleration_m_s2, 4.0 * speed)
        asked = self.estimate.velocity_m_s * (self.copter.drag_1_s - most / speed)
        self.control.follow(asked)
        return asked, self.control.climb(0.0, self.step_s)

    def sink(self) -> Order:
        """The modes that a pilot holds it in: the stick is at its lower end."""
        return self._hold(-_SINK_M_S, level=not self.mode.needs_position)

    def land(self) -> Order:
        """Down at WPNAV_SPEED_DN, the last metres at LAND_SPEED."""
        p, tuning = self.parameters, self.tuning
        slow = max(p["LAND_SPEED"], 20.0) / 100.0
        rate = rate_for(_LAND_LOW_M - self.height_m, 1.0, tuning.acceleration_up_m_s2, self.step_s)
        rate = min(max(rate, -max(tuning.speeds_m_s[2], slow)), -slow)
        if self.now_s < self._pauses_until_s:
            rate = 0.0
        self._lands_with_position &= self.estimate.aiding
        return self._hold(rate, level=not self._lands_with_position)

    # --- legs ---------------------------------------------------------------------------------

    def _begin_return(self) -> None:
        """Home, first up to RTL_ALT."""
        p, place = self.parameters, self.estimate.place
        home = self.home or place
        height_m = max(place.altitude_amsl_m, home.altitude_amsl_m + p["RTL_ALT"] / 100.0)
        self.route.fly(back(place, home, height_m, p["RTL_LOIT_TIME"] / 1000.0), self.now_s)

    def begin_leg(self, speed_m_s: float | None) -> None:
        """Another item of the mission, or none any more."""
        leg = self.route.leg
        if speed_m_s is not None:
            self._speeds_m_s = (speed_m_s, *self._speeds_m_s[1:])
        self.control.start_climb()
        if leg is None:
            self._restart(Kind.VELOCITY)
        elif leg.does is Does.RETURN:
            self._begin_return()
        elif leg.does is Does.CLIMB:
            self.route.leg = leg._replace(hold_s=_REACHED_S)

    def fly_legs(self) -> Order:
        """AUTO, RTL, a take-off: a place after the other."""
        leg = self.route.leg
        if leg is None or not self.estimate.aiding:
            return self._hold(0.0, level=leg is not None)
        if self.route.lands:
            return self.land()
        speeds_m_s = self._speeds_m_s
        order = self.control.fly(STILL, STILL, self.step_s, leg.place, speeds_m_s, paced=True)
        self.follow_route()
        return order

    def is_there(self, leg: Leg) -> bool:
        """Near enough, and not too soon."""
        position, place, returns = self.estimate.place, leg.place, leg.command == RETURN
        rise_m, away_m = (
            place.altitude_amsl_m - position.altitude_amsl_m,
            abs(way_m(position, place)),
        )
        if leg.does is Does.LAND:
            return away_m < _OVER_LANDING_M
        there = math.hypot(away_m, rise_m) < self.parameters["WPNAV_RADIUS"] / 100.0
        if leg.does is Does.CLIMB:
            there = abs(rise_m) < _CLIMBED_M if returns else rise_m < _REACHED_M
        soon = returns and not leg.hold_s and self.now_s - self.route.began_s < _RETURN_STAGE_S
        return there and not soon

    # --- telling ------------------------------------------------------------------------------

    def base_mode(self) -> int:
        """Whether it holds a position depends on more than the mode."""
        name = self.mode.name
        holds = (name == "LAND" and self._lands_with_position) or (name == "RTL" and self.armed)
        return _HOLDS if holds or self.now_s < self.firmware.ready_s else self.mode.base

    def target_echo(self) -> values.Setpoint | None:
        """What GUIDED steers for; in other modes nothing is sent."""
        if self.mode.name != "GUIDED" or self.estimate.origin is None:
            return None
        position = (0.0, 0.0, 0.0)
        if self._target is not None and self.kind is not Kind.TAKEOFF:  # its height is not told
            position = self.frame.ned_m(self._target)
        (velocity, climb_m_s), (feed, feed_up) = self._moves, self._feed
        return values.Setpoint(
            is_global=False,
            frame=LOCAL_NED,
            type_mask=_ECHO_MASKS[self.kind],
            position=position,
            velocity_ned_m_s=(velocity.real, velocity.imag, -climb_m_s),
            acceleration_ned_m_s2=(feed.real, feed.imag, -feed_up),
            yaw_rad=0.0,
        )

    def waypoint(self) -> values.Waypoint | None:
        """While it flies to a place that does not move."""
        leg, position, place = self.route.leg, self.estimate.place, None
        if self.mode.name == "GUIDED":
            place = self._target if self.kind is Kind.POSITION else None
        elif leg is not None and (leg.does, leg.command) != (Does.LAND, RETURN):
            place = leg.place
        if place is None:
            return None
        way = way_m(position, place)
        return values.Waypoint(
            place=place,
            distance_m=abs(way),
            bearing_rad=math.atan2(way.imag, way.real) % math.tau,
            altitude_error_m=place.altitude_amsl_m - position.altitude_amsl_m,
        )


def _order(vector: tuple[float, float, float]) -> Order:
    """Of a setpoint's velocity or acceleration; none, where it is not given."""
    north, east, down = vector if given(vector) else (0.0, 0.0, 0.0)
    return complex(north, east), -down
