"""ArduPlane 4.7: its modes, take-off from a runway, and points to circle (ardupilot.md 7).

Whatever it flies to by itself is a point that it circles in the end, or passes in a mission.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, final

from vehicle_sim.autopilot.ardupilot import EKF3, ArduPilot, profile
from vehicle_sim.autopilot.copter_control import bounded
from vehicle_sim.autopilot.core import (
    GPS_GLOBAL_ORIGIN,
    HEARTBEAT,
    HOME_POSITION,
    Boot,
    Firmware,
    Mode,
)
from vehicle_sim.autopilot.earth import FlatEarth, Vector, way_m
from vehicle_sim.autopilot.estimator import State as Estimates
from vehicle_sim.autopilot.legs import WAYPOINT, Does, Leg
from vehicle_sim.autopilot.plane_control import (
    Circle,
    PlaneControl,
    Way,
    eas_to_tas,
    indicated_airspeed_m_s,
    true_airspeed_m_s,
)
from vehicle_sim.autopilot.values import (
    Command,
    Place,
    Reply,
    Result,
    Setpoint,
    Waypoint,
    height_amsl_m,
)
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.faults import SIM_PARAMETERS
from vehicle_sim.parameters import table
from vehicle_sim.sensors.gps import Fix

_BY_HAND, _BY_ITSELF = 0x51, 0x59
"""base_mode: stabilised, with manual override; guided as well where it navigates."""
_GLIDES = {"MANUAL": 0, "STABILIZE": 2, "TRAINING": 3, "ACRO": 4, "FBWA": 5, "AUTOTUNE": 8}
"""The throttle is in a hand that is not there."""
_CIRCLES = {"CIRCLE": 1, "LOITER": 12, "GUIDED": 15, "THERMAL": 24, "AUTOLAND": 26}
_MODES: Final = (
    Mode("INITIALISING", 16, "glides", base=0x11),
    *(Mode(name, number, "glides", base=_BY_HAND) for name, number in _GLIDES.items()),
    Mode("FBWB", 6, "cruises", base=_BY_HAND),
    Mode("CRUISE", 7, "cruises", base=_BY_HAND),
    *(Mode(name, number, "circles", base=_BY_ITSELF) for name, number in _CIRCLES.items()),
    Mode("RTL", 11, "returns", base=_BY_ITSELF),
    Mode("TAKEOFF", 13, "takes off", base=_BY_ITSELF),
    Mode("AUTO", 10, "flies a mission", base=_BY_ITSELF),
)
"""The Q modes (17 to 23, 25) are refused: the airframe is no quadplane."""
_RATES_HZ: Final = dict.fromkeys((0, 1, 2, 24, 30, 32, 33, 42, 62, 74, 87, 147, 162, 168), 1.0) | {
    111: 0.1
}
"""What a fresh link gets unasked."""
FIRMWARE: Final = Firmware(
    profile=profile(vehicle_type=1, capabilities=62319, rates_hz=_RATES_HZ),
    table=(*table("ardupilot", "arduplane"), *SIM_PARAMETERS),
    modes=_MODES,
    holds="LOITER",
    returns="RTL",
    pilot="FBWA",
    missions="AUTO",
    first_item=1,
    timing=replace(
        EKF3, stages=((0.0, 0x400), (11.1, 0x000), (12.3, 0x0A7)), origin_s=10.22, good_s=11.24
    ),
    frame=FlatEarth,
    ready_s=1.727,
    prearm_s=22.8,
    believes_landing_s=0.0,
    refused=Result.FAILED,
    arms="Throttle armed",
    disarms="Throttle disarmed",
    cannot_arm="Arm: {}",
    crashes="Crash detected",
)

# Its take-off from a runway: arduplane-guided-reposition.tlog, 26 to 35 s.
_FULL_THRUST_M_S2, _DRAG_1_S = 14.5, 0.55
"""Acceleration on the runway at full throttle, and what it loses with each metre a second."""
_THROTTLE_S: Final = 0.2
"""From arming to opening the throttle (TKOFF_THR_DELAY), which takes a second (THR_SLEWRATE)."""
_LIFT_OFF_SHARE: Final = 0.86
"""Of the cruising airspeed."""
_FLYING_M_S: Final = 2.5
"""Ground speed that counts as flying."""
_AIMED_M_S: Final = 5.0
"""Ground speed at which TAKEOFF settles where it goes."""
_CLIMB_AIRSPEED: Final = 1.225
"""At full throttle and nose up, over cruising airspeed."""
_CLIMB_M_S: Final = 9.9
_LEVEL_RAD, _LEVEL_M, _FREE_M = math.radians(5.0), 10.0, 30.0
"""Bank below this height, at most (LEVEL_ROLL_LIMIT, TKOFF_LVL_ALT); above the other it is free."""
_REACHED_M: Final = 2.0
"""A take-off is over so much below its height."""

_TURN_EFFICIENCY: Final = 0.745
"""Lateral acceleration over g tan(bank) of the recorded airframe, which slips in turns (measured:
0.745 +- 0.01 over 240 s); that is why its circles are wider than asked."""
_SLOWING_M_S2: Final = 2.2
"""How fast it loses speed with the throttle slewing down."""
_GLIDE_M_S: Final = 2.5
_LANDING_SINK_M_S: Final = 1.5
"""Wings level from the place of a landing on: no approach and no flare."""
_BRAKING_M_S2: Final = -3.0
_HEADING_GAIN: Final = math.radians(50.0)
"""Bank for each radian of course error: GUIDED_P 5000 hundredths of a degree."""
_RUNWAY_AHEAD_M: Final = 1000.0
"""A mission's take-off climbs straight on at a point so far ahead."""
_NO_HEIGHT = "SIM: NaN height in {} stops the real autopilot"


@final
class ArduPlane(ArduPilot):
    """Modes, GUIDED's points, take-off and the runway."""

    GCS_FAILSAFE = ("FS_GCS_ENABL", "FS_LONG_TIMEOUT")

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        assert isinstance(boot.vehicle, Plane)
        self._plane = boot.vehicle
        self._plane.turn_efficiency = _TURN_EFFICIENCY
        self._control = PlaneControl(self._plane, self.estimate)
        self._control.slowing_m_s2 = _SLOWING_M_S2
        self._start = self._place = self.estimate.place
        """Where it goes, and where from."""
        self._straight = False
        """Along the way between the two, and not to circle at once."""
        self._radius_m, self._left = 0.0, False
        """Asked for, 0: WP_LOITER_RAD; counter-clockwise."""
        self._arrived = False
        self._course: tuple[float, float] | None = None
        """GUIDED_CHANGE_HEADING, instead of the point: course and most bank, in radians."""
        self._cruise_m_s: float | None = None
        """Of DO_CHANGE_SPEED; the next, of GUIDED_CHANGE_SPEED, counts more."""
        self._guided_m_s: float | None = None
        self._demand_m_s = 22.0
        """Airspeed as a pitot tube measures it."""
        self._throttle = 0.0
        """On the runway."""
        self._roll_s = 0.0
        """Since when it is to take off."""
        self._climbing = False
        """After lifting off, at full throttle."""
        self.handlers |= {
            22: lambda _: Result.FAILED,  # there is the mode TAKEOFF for that
            178: self._do_change_speed,
            192: self._do_reposition,
            300: self._do_start_mission,
            43000: self._change_guided_speed,
            43002: self._change_heading,
        }

    # --- where to -----------------------------------------------------------------------------

    def begin(self, before: Mode) -> None:
        """What was told before is forgotten; without anything new it circles here."""
        del before
        here = self.estimate.place
        self._cruise_m_s = self._guided_m_s = self._course = None
        self.route.stop()
        if self._climbing:
            self._end_climb()
        self._go(here)
        self._control.height_amsl_m = here.altitude_amsl_m
        if self.mode.flies == "returns":
            self._return()
        elif self.mode.flies == "flies a mission":
            self.seek(max(self.route.current, 1))

    def _go(
        self, place: Place, *, straight: bool = False, radius_m: float = 0.0, left: bool = False
    ) -> None:
        """To this point, at its height: along the way if that goes down (or is straight) enough."""
        # a leg leads on from the last waypoint
        self._start = self._place if straight and self._straight else self.estimate.place
        self._place = place
        self._straight, self._radius_m, self._left, self._arrived = straight, radius_m, left, False

    def _aim_ahead(self, away_m: float, up_m: float) -> None:
        """To the point so far ahead and so much higher."""
        velocity = self._control.velocity
        way = velocity / abs(velocity) * away_m
        self._go(FlatEarth(self.estimate.place).place(way.real, way.imag, -up_m))

    def _return(self) -> None:
        """Home, RTL_ALTITUDE above it."""
        home, above_m = self.home, self.parameters["RTL_ALTITUDE"]
        if home is not None:
            here_m = self.estimate.altitude_amsl_m
            self._go(home.at(here_m if above_m < 0.0 else home.altitude_amsl_m + above_m))

    def cannot_fly_in(self, name: str) -> str | None:
        """Plane refuses only the mode that nobody may choose."""
        return "cannot be chosen" if name == "INITIALISING" else None

    def begin_leg(self, speed_m_s: float | None) -> None:
        """Another item."""
        leg, here_m = self.route.leg, self.estimate.altitude_amsl_m
        self._cruise_m_s = speed_m_s or self._cruise_m_s
        if leg is None:
            return
        if leg.does is Does.RETURN:
            self._return()
        elif leg.does is Does.CLIMB:
            self._aim_ahead(_RUNWAY_AHEAD_M, leg.place.altitude_amsl_m - here_m)
        elif leg.does is Does.LAND:
            self._go(leg.place.at(here_m), straight=True)
        else:
            self._go(leg.place, straight=leg.command == WAYPOINT)

    def _follow_mission(self) -> None:
        """Ten times a second: on to the next item when this one is done; home after the last."""
        leg = self.route.leg
        if leg is not None and self._is_done(leg):
            self.reached(self.route.current)
            self.seek(self.route.current + 1)
        if self.route.leg is None and not self._plane.stands:
            self.set_mode("RTL")

    def _is_done(self, leg: Leg) -> bool:
        if leg.does is Does.CLIMB:
            return self.estimate.altitude_amsl_m >= leg.place.altitude_amsl_m
        if leg.does is not Does.GO:
            return False
        if not self._straight:
            circles = self._arrived and self._control.l1.circling
            return circles and self.route.has_waited(self.now_s, leg.hold_s)
        near_m = self._control.l1.length_m(abs(self._control.velocity))
        near_m = min(self.parameters["WP_RADIUS"], near_m)
        near_m = leg.acceptance_m if leg.acceptance_m == leg.acceptance_m else near_m
        return abs(self._control.off_m(self._place)) <= near_m or self._along() >= 1.0

    @property
    def _takes_off(self) -> bool:
        """By mode or by the mission's item."""
        leg = self.route.leg
        return self.mode.flies == "takes off" or (leg is not None and leg.does is Does.CLIMB)

    @property
    def lands(self) -> bool:
        """Where AUTO does."""
        leg = self.route.leg
        return leg is not None and leg.does is Does.LAND

    def on_failsafe(self, cause: str, action: int) -> None:
        """It returns, but for FS_LONG_ACTN 0 in AUTO, BATT_FS_*_ACT 2 in a landing, and MANUAL."""
        returns = self.mode.name != "MANUAL"
        if cause == "GCS":
            goes_on = self.parameters["FS_LONG_ACTN"] == 0.0 and self.mode.name == "AUTO"
            returns = not (self.landed or goes_on)
        elif cause == "Battery":
            returns = action in (1, 2) and not self.lands
        if returns:
            self.set_mode("RTL")
        if cause == "GCS":
            self.say(4, f"GCS Failsafe On: {self.mode.name}")

    # --- commands -----------------------------------------------------------------------------

    def _do_reposition(self, command: Command) -> Result:
        """DO_REPOSITION: a point to circle; without a radius the one before is kept."""
        p = command.parameters
        if command.frame is None:
            return Result.UNSUPPORTED
        if not math.isfinite(p[6]):
            self.say(2, _NO_HEIGHT.format("DO_REPOSITION"))
            return Result.DENIED
        place = self.place_of(command)
        if isinstance(place, Result) or p[4] == p[5] == 0.0 or self.outside_fence(place):
            return Result.DENIED
        switches = math.isfinite(p[1]) and int(p[1]) & 1
        if self.mode.name != "GUIDED" and not switches:
            return Result.FAILED
        self.set_mode("GUIDED")
        radius_m = min(float(int(p[2])), 65535.0) if 0.0 < p[2] < math.inf else self._radius_m
        self._go(place, radius_m=radius_m, left=math.isfinite(p[3]) and p[3] != 0.0)
        self._course = None
        # until navigation has run again the height to be at is the present one
        self._control.height_amsl_m = self.estimate.altitude_amsl_m
        return Result.ACCEPTED

    def _do_start_mission(self, command: Command) -> Result:
        if command.parameters[0] != 0.0 or command.parameters[1] != 0.0:
            return Result.DENIED
        return self.to_mode("AUTO")(command)

    def _do_change_speed(self, command: Command) -> Result:
        """DO_CHANGE_SPEED; of speeds over the ground it takes no notice."""
        kind, speed_m_s = command.parameters[:2]
        known = kind == 1.0 or self._may_fly(kind, speed_m_s)
        if self.mode.name not in ("GUIDED", "AUTO") or not known:
            return Result.FAILED
        self._cruise_m_s = speed_m_s if kind == 0.0 else self._cruise_m_s
        return Result.ACCEPTED

    def _change_guided_speed(self, command: Command) -> Result:
        """GUIDED_CHANGE_SPEED."""
        kind, speed_m_s = command.parameters[:2]
        if self.mode.name != "GUIDED":
            return Result.FAILED
        if not self._may_fly(kind, speed_m_s):
            return Result.DENIED
        self._guided_m_s = speed_m_s
        return Result.ACCEPTED

    def _may_fly(self, kind: float, speed_m_s: float) -> bool:
        """Whether it is an airspeed, and within the limits."""
        p = self.parameters
        return kind == 0.0 and p["AIRSPEED_MIN"] <= speed_m_s <= p["AIRSPEED_MAX"]

    def _change_heading(self, command: Command) -> Result:
        """GUIDED_CHANGE_HEADING: a course over the ground, until there is a new point."""
        kind, course_deg, lateral_m_s2 = command.parameters[:3]
        if self.mode.name != "GUIDED":
            return Result.FAILED
        if kind != 0.0 or not (0.0 <= course_deg < 360.0 and 0.0 < lateral_m_s2 < math.inf):
            return Result.DENIED
        self._course = math.radians(course_deg), math.atan(lateral_m_s2 / GRAVITY_M_S2)
        return Result.ACCEPTED

    def on_setpoint(self, setpoint: Setpoint) -> Sequence[Reply]:
        """Only heights are taken, and only in GUIDED."""
        z_m, home = setpoint.position[2], self.home
        if self.mode.name != "GUIDED" or home is None:
            return ()
        height_m: float | None = None
        if setpoint.is_global and not setpoint.type_mask & 4:  # it has no terrain data either
            home_m = home.altitude_amsl_m
            height_m = height_amsl_m(setpoint.frame, z_m, home_m, home_m)
        elif not setpoint.is_global and setpoint.frame == 7:
            height_m = self._place.altitude_amsl_m - z_m
        if height_m is None or not math.isfinite(height_m):
            if height_m is not None:
                self.say(2, _NO_HEIGHT.format("a setpoint"))
            return self.taken()
        self._place = self._place.at(height_m)
        return ()

    def on_disarmed(self) -> None:
        """A take-off is abandoned."""
        super().on_disarmed()
        self._climbing = False

    def disarms_after_s(self) -> float | None:
        """After a landing of a mission."""
        wait_s: float = self.parameters["LAND_DISARMDELAY"]
        return wait_s if self.lands and wait_s > 0.0 else None

    # --- ten times a second -------------------------------------------------------------------

    def look(self, fix: Fix) -> None:
        """Home is where the first fix was: plane does not wait for the EKF."""
        if self.home is not None:
            return
        if self.mode.name == "INITIALISING" and self.now_s >= FIRMWARE.ready_s:
            self.mode = self.modes["MANUAL"]
            self.send(HEARTBEAT)
        if fix.usable:
            self.home = Place(fix.latitude_deg, fix.longitude_deg, fix.altitude_amsl_m)
            self.send(HOME_POSITION)

    def on_origin(self, origin: Place) -> None:
        """It is told, and home again."""
        del origin
        self.send(GPS_GLOBAL_ORIGIN, HOME_POSITION)

    def check(self) -> None:
        """How fast and how high, where to, and how to bank for it."""
        super().check()
        self._choose_speed()
        if not self.estimator.ok or self.mode.flies in ("glides", "cruises"):
            self._control.bank_rad = 0.0
        else:
            self._navigate()

    def _choose_speed(self) -> None:
        """Airspeed, and the climb where that is no matter of height."""
        p, control, flies = self.parameters, self._control, self.mode.flies
        usual_m_s = p["AIRSPEED_MIN" if flies in ("glides", "cruises") else "AIRSPEED_CRUISE"]
        least_m_s, most_m_s = p["AIRSPEED_MIN"], p["AIRSPEED_MAX"]
        asked_m_s = self._guided_m_s or self._cruise_m_s or usual_m_s
        self._demand_m_s = bounded(asked_m_s, least_m_s, most_m_s)
        altitude_m = self.estimate.altitude_amsl_m
        control.airspeed_m_s = true_airspeed_m_s(self._demand_m_s, altitude_m)
        control.climb_m_s = None
        if flies == "glides":
            control.climb_m_s = -_GLIDE_M_S
        elif self._climbing:
            control.airspeed_m_s *= _CLIMB_AIRSPEED
            control.climb_m_s = _CLIMB_M_S
        elif self.lands and self._along() >= 1.0:
            control.climb_m_s = -_LANDING_SINK_M_S

    def _navigate(self) -> None:
        """By itself: to its point, along the way or around it."""
        p, control = self.parameters, self._control
        if self.mode.flies == "takes off" and self._plane.stands and self.armed:
            if abs(control.velocity) < _AIMED_M_S:
                self._aim_ahead(p["TKOFF_DIST"], p["TKOFF_ALT"])
        elif self.mode.flies == "flies a mission":
            self._follow_mission()
        circle = Circle(self._place, self._circle_m())
        control.steer(Way(self._start, self._place) if self._straight else circle)
        along = self._along()
        if not self._arrived and not self._straight and (control.l1.circling or along > 1.0):
            self._arrived = True
            if self.mode.name == "GUIDED" and not self.landed:
                self.reached(0)
        control.height_amsl_m = self._place.altitude_amsl_m
        if self._course is not None:
            course_rad, most_rad = self._course
            error_rad = math.remainder(course_rad - cmath.phase(control.velocity), math.tau)
            control.bank_rad = bounded(_HEADING_GAIN * error_rad, -most_rad, most_rad)
        if self._climbing:
            self._watch_climb()
        elif control.climb_m_s is not None:
            control.bank_rad = 0.0  # it lands

    def _along(self) -> float:
        """Share of the way from where it came from to where it goes; may be over 1."""
        leg_m = way_m(self._place, self._start)
        square = abs(leg_m) ** 2
        off_m = self._control.off_m(self._start)
        return 1.0 if square < 1e-3 else -(off_m.conjugate() * leg_m).real / square

    def _circle_m(self) -> float:
        """Radius to fly, left negative: wider where the air is thin."""
        usual_m = self.parameters["WP_LOITER_RAD"]
        asked_m = self._radius_m if self._radius_m > 1.0 else max(abs(usual_m), 1.0)
        radius_m = asked_m * eas_to_tas(self.estimate.altitude_amsl_m) ** 2
        return -radius_m if self._left or usual_m < 0.0 else radius_m

    def _watch_climb(self) -> None:
        """Level near the ground; over at its height, or far enough away."""
        control, p = self._control, self.parameters
        climbed_m = self.estimate.altitude_amsl_m - self._start.altitude_amsl_m
        share = bounded((climbed_m - _LEVEL_M) / (_FREE_M - _LEVEL_M), 0.0, 1.0)
        most_rad = _LEVEL_RAD + share * (control.bank_most_rad - _LEVEL_RAD)
        control.bank_rad = bounded(control.bank_rad, -most_rad, most_rad)
        over = not self._takes_off
        if self.mode.flies == "takes off":
            away_m = abs(control.off_m(self._start))
            over = climbed_m >= p["TKOFF_ALT"] - _REACHED_M or away_m >= p["TKOFF_DIST"]
        if over:
            self._end_climb()
            self.took_off()

    def _end_climb(self) -> None:
        self._climbing = False
        self._choose_speed()

    # --- in each step -------------------------------------------------------------------------

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        p, control = self.parameters, self._control
        control.l1.period_s = max(p["NAVL1_PERIOD"], 1.0)
        control.l1.damping = max(p["NAVL1_DAMPING"], 0.1)
        control.heights.climb_most_m_s = max(p["TECS_CLMB_MAX"], 0.1)
        control.heights.sink_most_m_s = max(p["TECS_SINK_MAX"], 0.1)
        control.bank_most_rad = math.radians(min(abs(p["ROLL_LIMIT_DEG"]), 80.0))

    def move(self, dt_s: float) -> None:
        """In the air."""
        self._control.advance(dt_s)

    def lifts_off(self) -> bool:
        """Fast enough on the runway."""
        lift_off_m_s = _LIFT_OFF_SHARE * self._control.airspeed_m_s
        self._climbing = self._throttle > 0.0 and self._plane.airspeed_m_s >= lift_off_m_s
        if self._climbing:
            self._throttle = 0.0
            self._choose_speed()
        return self._climbing

    def stand(self, dt_s: float) -> None:
        """On the runway: to a halt, or up to speed."""
        plane = self._plane
        plane.altitude_amsl_m = self.ground_m
        if not (self._takes_off and self.armed and self.estimator.ok):
            self._roll_s = self.now_s
        self._throttle = bounded(self.now_s - self._roll_s - _THROTTLE_S, 0.0, 1.0)
        acceleration = _BRAKING_M_S2
        if self._throttle > 0.0:
            acceleration = _FULL_THRUST_M_S2 * self._throttle**1.5 - _DRAG_1_S * plane.airspeed_m_s
            if self._rolls:
                self.take_to_the_air()
        plane.roll_on_ground(acceleration, dt_s)
        plane.throttle = self._throttle

    def touch_down(self) -> None:
        """Wheels or nose on the ground."""
        self._plane.touch_down(self.ground_m)
        self._climbing = False

    @property
    def _rolls(self) -> bool:
        """So fast that it counts as flying."""
        return abs(self._control.velocity) >= _FLYING_M_S

    def lies(self) -> bool:
        """Whether what touches the ground may be taken to have landed."""
        return not (self.armed and self._rolls)

    # --- telling ------------------------------------------------------------------------------

    @property
    def climbs_out(self) -> bool:
        """Whether a take-off goes on."""
        return self._climbing or self._throttle > 0.0

    def airspeed_m_s(self) -> float:
        """What the pitot tube measures: less than the true airspeed, as it is calibrated."""
        altitude_m = self.estimate.altitude_amsl_m
        return indicated_airspeed_m_s(self._plane.airspeed_m_s, altitude_m)

    def local_ned_m(self) -> Vector | None:
        """About home, by another estimator, until this one flies for the first time."""
        if self.estimator.state is Estimates.START and self.home is not None:
            return 0.0, 0.0, self.home.altitude_amsl_m - self.estimate.altitude_amsl_m
        return super().local_ned_m()

    def waypoint(self) -> Waypoint | None:
        """Where it goes; MANUAL says nothing."""
        if self.mode.name in ("MANUAL", "INITIALISING"):
            return None
        control = self._control
        return Waypoint(
            place=self._place,
            distance_m=abs(control.off_m(self._place)),
            bearing_rad=control.l1.bearing_rad,
            altitude_error_m=control.height_amsl_m - self.estimate.altitude_amsl_m,
            cross_track_m=control.l1.cross_track_m,
            airspeed_error_m_s=self._demand_m_s - self.airspeed_m_s(),
        )
