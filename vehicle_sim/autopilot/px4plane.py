"""PX4 1.17 flying a fixed wing: OFFBOARD and AUTO modes along circles and lines (px4.md 10).

OFFBOARD takes from SET_POSITION_TARGET what FixedWingModeManager takes: a position alone is flown
at, straight, and circled tightly when there; a position with a velocity is a point of a path and
its direction there; an acceleration with them bends that path, to the wrong side; without a
position nothing is steered and the last commands stay.  The speed is always FW_AIRSPD_TRIM.

The law is that of both planes (plane_control.py), the modes and speeds are PX4's.  The recorded
aeroplane sank to the ground after its take-off (px4-fixedwing-offboard.tlog, 25 to 150 s), and
takes most of a minute to find the last of its throttle.  This one does neither.
"""

import cmath
import math
from typing import Final, NamedTuple, final

from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.legs import Does, Leg
from vehicle_sim.autopilot.plane_control import Circle, FixedWing, Runway, Way, eas_to_tas
from vehicle_sim.autopilot.px4 import RATES_HZ, Px4, firmware
from vehicle_sim.autopilot.setpoints import LOCAL_NED, NOTHING, Target, given
from vehicle_sim.autopilot.values import Place, Setpoint, Waypoint
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import PlaneLimits

FIRMWARE: Final = firmware("px4plane", vehicle_type=1, rates_hz=RATES_HZ | {231: 10.0})
"""WIND_COV as well."""
SIH_AIRPLANE: Final = PlaneLimits(
    airspeed_min_m_s=5.0,
    airspeed_max_m_s=13.95,
    bank_max_rad=math.radians(60.0),
    roll_rate_rad_s=math.radians(60.0),
    climb_max_m_s=2.9,
    sink_max_m_s=5.0,
    acceleration_m_s2=4.0,
)
"""PX4's simulated aeroplane: 13.9 m/s at full throttle, climbs 2.5 to 3.0 m/s (the log)."""

# Times and speeds are those of px4-fixedwing-offboard.tlog: armed at 8.08 s, 2.9 m/s a second
# later, 9.2 m/s and off the ground after two, 50 m high after 22; in the landing contact at 436.0,
# 0.9 m/s and "landing detected" at 438.7 s after boot.  A landing ends without a flare.
_CLIMB_OUT_M_S: Final = 2.63  # climb rate at FW_TKO_PITCH_MIN 10 degrees and full throttle
_LIFTS_OFF_AT: Final = 1.1
"""Share of the take-off airspeed at which it leaves the ground: 11.3 m/s (RunwayTakeoff.cpp)."""
_LANDS_FASTER_M_S: Final = 0.5  # flown 10.8 m/s through the air where FW_AIRSPD_MIN is 10.3
_SLOPE_RAD: Final = math.radians(5.0)  # FW_LND_ANG
_SLOPE_FLOWN: Final = 0.98
"""Share of the sink of FW_LND_ANG that is flown: 0.85 m/s in the mean of the recorded landing."""
_SINKS_FASTER_1_S: Final = 0.15
"""Sink for each m/s of airspeed too much: 1.3 m/s at first, 0.87 when it is slow."""
_STEER_EVERY: Final = 4
"""Steps: the guidance runs at 25 Hz (the real one at 50, which nothing measured tells apart)."""
_GLIDE_M_S: Final = 1.6  # sink without throttle
_DESCEND_M_S: Final = 0.5
"""Failsafe without a position (FixedWingModeManager::control_auto_descend)."""
_CLEARED_M: Final = 10.0
"""A take-off climbs on by this much beyond its height (kClearanceAltitudeBuffer)."""
_TRADED_M: Final = 15.0
"""Of height for airspeed that it lacks, at most: told 15 m/s, which the simulated one does not
reach, it stands 2 m low (TECS)."""
_ON_CIRCLE_M: Final = 15.0
_ECHO_MASK: Final = 3576


@final
class Line(NamedTuple):
    """Through a place in a direction (of unit length), or bent there (positive: to the right)."""

    place: Place
    way: complex
    curvature_1_m: float = 0.0


@final
class Px4Plane(FixedWing, Px4):
    """The aeroplane of PX4's SIH simulator, or one with other limits."""

    runway = Runway(
        full_m_s2=6.4,
        power=1.0,
        drag_1_s=0.0,
        waits_s=0.0,
        opens_s=1.12,  # RWTO_RAMP_TIME
        flying_m_s=6.6,  # the land detector believes in a take-off, still on the wheels
        landed_m_s=3.2,  # from here on it counts its 1.8 s: 0.9 m/s when it is done
        brakes_m_s2=0.05,
        # so that it stands when and where the recorded one does, whose flare brakes it from 10.8
        # to 6.8 m/s before contact (then 1.33 s)
        rolls_out_s=0.8,
    )

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        self.l1.upright = True
        self.l1.period_s, self.l1.damping = 10.0, 0.7  # NPFG_PERIOD, NPFG_DAMPING
        self._aim: Circle | Way | Line | None = None  # none: the bank stays
        self._goal: Place | None = None  # the place flown to; the middle of a circle
        self._nearest = self.estimate.place, 0j  # of circle or line: a place and how far from it
        self._sink_m_s: float | None = None  # it lands: on a slope
        self._seen: Target | None = None  # the setpoint that it flies by
        self._began_s = 0.0  # when the mode did
        self._steps = 0

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        p = self.parameters
        self.bank_most_rad = math.radians(p["FW_R_LIM"])
        self.heights.climb_most_m_s = p["FW_T_CLMB_R_SP"]
        self.heights.sink_most_m_s = p["FW_T_SINK_R_SP"]
        if self._sink_m_s is None:
            self.wanted_airspeed_m_s = self._cruise_m_s

    def _true(self, equivalent_m_s: float) -> float:
        return equivalent_m_s * eas_to_tas(self.estimate.altitude_amsl_m)

    @property
    def _cruise_m_s(self) -> float:
        """True airspeed: FW_AIRSPD_TRIM, or DO_CHANGE_SPEED's in the modes that know it."""
        p, wanted_m_s = self.parameters, self.parameters["FW_AIRSPD_TRIM"]
        if self.mode.name in ("Hold", "Mission", "Return"):
            wanted_m_s = self.speed_m_s or wanted_m_s
        least_m_s = p["FW_AIRSPD_MIN"]
        return self._true(min(max(wanted_m_s, least_m_s), max(p["FW_AIRSPD_MAX"], least_m_s)))

    # --- where to -----------------------------------------------------------------------------

    def _fly(self, aim: Circle | Way | Line, goal: Place) -> None:
        """Along this, at the goal's height."""
        self._aim, self._goal = aim, goal
        self.wanted_climb_m_s = self._sink_m_s = None

    def _circle(self, place: Place) -> None:
        """About a place, at its height; with a negative radius to the left."""
        radius_m = self.parameters["NAV_LOITER_RAD"]
        radius_m = radius_m if abs(radius_m) > 1.0 else math.copysign(1.0, radius_m)
        self._fly(Circle(place, radius_m), place)

    def _ahead(self, altitude_amsl_m: float) -> None:
        """Straight on where the nose points."""
        here = self.estimate.place.at(altitude_amsl_m)
        self._fly(Line(here, cmath.rect(1.0, self.plane.heading_rad)), here)

    def _descend_about(self, place: Place) -> None:
        """Down in a circle.  NAV_LAND's own place is ignored, as recorded."""
        slow_m_s = self.parameters["FW_AIRSPD_MIN"]
        self._circle(place)
        self.wanted_airspeed_m_s = self._true(slow_m_s) + _LANDS_FASTER_M_S
        self._sink_m_s = slow_m_s * _SLOPE_FLOWN * math.sin(_SLOPE_RAD)

    def begin(self) -> None:
        """What the mode makes it fly; in the air, and for a take-off on the ground."""
        here = self.estimate.place
        self._began_s, self._seen = self.now_s, None
        if self.mode.flies == "fly_target":
            return  # the last commands stay until a setpoint comes
        self.wanted_airspeed_m_s = self._cruise_m_s
        match self.mode.flies:
            case "climb":
                self._ahead(self.takeoff_altitude_m)
                self._goal = self.asked_or(here.at(self.takeoff_altitude_m))
            case "hold":
                self._circle(self.asked_or(here))
            case "fly_back":
                height_m = self.base.altitude_amsl_m + self.parameters["RTL_RETURN_ALT"]
                self._circle(self.base.at(max(height_m, here.altitude_amsl_m)))
            case "land":
                self._descend_about(here)
            case "fly_mission":
                self.fly_leg()
            case "descend":
                self._aim, self._sink_m_s, self.wanted_climb_m_s = None, None, 0.0
                self.bank_rad = math.radians(self.parameters["NAV_GPSF_R"])
            case _:
                self._ahead(here.altitude_amsl_m)

    def fly_leg(self) -> None:
        """Straight to the leg's place, or about it."""
        leg, here = self.route.leg, self.estimate.place
        if leg is None:
            self._circle(here)
        elif leg.does is Does.CLIMB:
            self._ahead(leg.place.altitude_amsl_m)
            self.wanted_climb_m_s = _CLIMB_OUT_M_S
        elif leg.does is Does.LAND:
            self._descend_about(leg.place)
        elif leg.hold_s:
            self._circle(leg.place)
        else:
            self._fly(Way(here, leg.place), leg.place)

    # --- in the air ---------------------------------------------------------------------------

    def steer(self) -> None:
        """Where to and how high, in every fourth step."""
        self._steps += 1
        if self._steps % _STEER_EVERY or self.plane.stands:
            return
        flies = self.mode.flies
        if flies == "fly_target" and self.target is not self._seen:
            self._take(self.target)
        elif flies == "climb":
            self._climb_out()
        elif flies == "fly_mission":
            self.follow_route()
        elif flies == "fly_back":
            self._return()
        elif flies == "descend":
            late = self.now_s - self._began_s > self.parameters["NAV_GPSF_LT"]
            self.wanted_climb_m_s = -_DESCEND_M_S if late else 0.0
        if self._sink_m_s is not None:
            excess_m_s = max(self.plane.airspeed_m_s - self.wanted_airspeed_m_s, 0.0)
            self.wanted_climb_m_s = -self._sink_m_s - _SINKS_FASTER_1_S * excess_m_s
        if self._goal is not None:
            energy = self.plane.airspeed_m_s**2 - self.wanted_airspeed_m_s**2
            more_m = min(max(energy / (2.0 * GRAVITY_M_S2), -_TRADED_M), _TRADED_M)
            self.wanted_height_m = self._goal.altitude_amsl_m + more_m
        self._bank()

    def _bank(self) -> None:
        """For what it aims at."""
        aim = self._aim
        if isinstance(aim, Line):
            off_m = self.off_m(aim.place)
            self._nearest = aim.place, (off_m.conjugate() * aim.way).real * aim.way
            self.bank_along(off_m, aim.way, aim.curvature_1_m)
        elif isinstance(aim, Way) and self.mode.flies == "fly_target":
            self.bank_for(aim._replace(start=self.estimate.place))  # straight there, from anywhere
        elif isinstance(aim, Way):
            self.bank_for(aim)
        elif aim is not None:
            off_m, radius_m = self.off_m(aim.centre), aim.radius_m
            out = off_m if abs(off_m) > 0.1 else self.velocity
            out /= abs(out)
            nearest_m, way = abs(radius_m) * out, math.copysign(1.0, radius_m) * 1j * out
            self._nearest = aim.centre, nearest_m
            self.bank_along(off_m - nearest_m, way, 1.0 / radius_m)

    def _take(self, target: Target | None) -> None:
        """A setpoint of OFFBOARD (px4.md 10)."""
        self._seen = target
        if target is None:
            return
        (north_m, east_m, down_m), (v_n, v_e, v_d) = target.position, target.velocity
        if not (north_m == north_m and east_m == east_m):
            self._aim = None
            return
        place = self.frame.place(north_m, east_m, down_m if down_m == down_m else 0.0)
        speed_m_s = math.hypot(v_n, v_e)
        aim: Way | Line = Way(self.estimate.place, place)
        if speed_m_s > 1e-6:  # not NaN
            aim = Line(place, complex(v_n, v_e) / speed_m_s, _bend(target))
        self._fly(aim, place)
        self.wanted_airspeed_m_s = self._cruise_m_s
        if down_m != down_m:
            self.wanted_climb_m_s = 0.0 if v_d == v_d else -_GLIDE_M_S

    def _climb_out(self) -> None:
        """Up to the take-off's height, then Hold; for good if it was not told where to."""
        goal_m, here = self.takeoff_altitude_m, self.estimate.place
        self.wanted_climb_m_s, self.wanted_airspeed_m_s = _CLIMB_OUT_M_S, self._cruise_m_s
        if here.altitude_amsl_m >= goal_m:
            goal = self._goal or here
            self._goal, self.wanted_climb_m_s = goal.at(goal_m + _CLEARED_M), None
            if given(self.asked):
                self.intend("Hold")

    def _return(self) -> None:
        """Circling at home: down to RTL_DESCEND_ALT."""
        aim = self._aim
        assert isinstance(aim, Circle)
        off_m = abs(self.off_m(aim.centre)) - abs(aim.radius_m)
        if abs(off_m) <= _ON_CIRCLE_M:
            above_m = self.parameters["RTL_DESCEND_ALT"]
            self._goal = self.base.at(self.base.altitude_amsl_m + above_m)

    def is_there(self, leg: Leg) -> bool:
        """Where PX4 switches to the next one: 31 m before its end at 13.9 m/s."""
        aim, away_m = self._aim, abs(self.off_m(leg.place))
        if leg.does is Does.LAND:
            return False
        if leg.does is Does.CLIMB:
            return self.estimate.altitude_amsl_m >= leg.place.altitude_amsl_m
        if isinstance(aim, Circle):
            return abs(away_m - abs(aim.radius_m)) < _ON_CIRCLE_M
        near_m = self.l1.length_m(abs(self.velocity))
        return away_m < (leg.acceptance_m if leg.acceptance_m > near_m else near_m)

    # --- on its wheels ------------------------------------------------------------------------

    def wants_up(self) -> bool:
        """Take-off, by mode or by a mission that begins with one."""
        return self.armed and (self.mode.flies == "climb" or self.is_at(Does.CLIMB))

    def lifts_off(self) -> bool:
        """Fast enough on the runway: straight up from here on."""
        fast_m_s = _LIFTS_OFF_AT * self._true(self.parameters["FW_AIRSPD_MIN"])
        fast = self.wants_up() and self.plane.airspeed_m_s >= fast_m_s
        if fast:
            self.bank_rad, self.wanted_climb_m_s = 0.0, _CLIMB_OUT_M_S
        return fast

    # --- to tell ------------------------------------------------------------------------------

    def target_echo(self) -> Setpoint | None:
        """The nearest point of a circle, as PX4 publishes it; nothing while it follows a path."""
        flies, waypoint, origin_m = self.mode.flies, self.waypoint(), self.reference.altitude_amsl_m
        follows = self._seen is None or isinstance(self._aim, Line)
        if flies in ("sink", "descend") or (flies == "fly_target" and follows):
            return None
        place = (0.0, 0.0, origin_m)
        if self.armed and waypoint is not None:
            of, off_m = self._nearest
            nearest = FlatEarth(of).place(off_m.real, off_m.imag, 0.0)
            place = self.frame.ned_m(nearest.at(waypoint.place.altitude_amsl_m))
        return Setpoint(False, LOCAL_NED, _ECHO_MASK, place, NOTHING, NOTHING, math.nan, math.nan)

    def waypoint(self) -> Waypoint | None:
        """The place flown to, or the middle of a circle; of height 0 in a landing (recorded)."""
        goal, lands = self._goal, self._sink_m_s is not None
        return goal and Waypoint(place=goal.at(0.0) if lands else goal)


def _bend(target: Target) -> float:
    """Curvature that an acceleration asks for, 1/m, with the sign that PX4 gives it: the wrong one.

    FixedWingModeManager.cpp:2074 against :2641-2644 (px4.md 1, item 7).
    """
    (v_n, v_e, _), (a_n, a_e, a_d) = target.velocity, target.acceleration
    if math.isnan(a_n + a_e + a_d):
        return 0.0
    return -(v_n * a_e - v_e * a_n) / math.hypot(v_n, v_e) ** 3
