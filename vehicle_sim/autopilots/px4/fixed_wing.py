"""PX4 flying a fixed wing: what each mode makes it fly (px4.md 10).

OFFBOARD takes from SET_POSITION_TARGET what FixedWingModeManager takes: a position alone is flown
at, straight, and circled tightly when there; a position with a velocity is a point of a path and
its direction there; an acceleration with them bends that path, to the wrong side; without a
position nothing is steered and the last commands stay.  The speed is always FW_AIRSPD_TRIM.

The recorded aeroplane sank to the ground after its take-off (px4-fixedwing-offboard.tlog, 25 to
150 s).  This one does not.
"""

import cmath
import math
from typing import Final, final

from vehicle_sim.autopilots import TargetEcho, Waypoint
from vehicle_sim.autopilots.px4 import mission
from vehicle_sim.autopilots.px4.autopilot import RATES_HZ, Px4, profile
from vehicle_sim.autopilots.px4.commands import HANDLERS
from vehicle_sim.autopilots.px4.course import Course, Limits, size, true_airspeed_m_s
from vehicle_sim.autopilots.px4.modes import MANUAL_MODES, Mode
from vehicle_sim.autopilots.px4.setpoints import NOTHING, Target
from vehicle_sim.dynamics.plane import Plane, PlaneLimits

# --- A fixed wing of PX4 on its wheels, and in the seconds before and after (px4.md 10) -----------
# Times, speeds and events are those of px4-fixedwing-offboard.tlog: armed at 8.08 s, 2.9 m/s a
# second later, 9.2 m/s and off the ground after two, 50 m high after 22; in the landing contact at
# 436.0, 0.9 m/s and "landing detected" at 438.7 s after boot.  A landing ends without a flare.

TAKEOFF_SEEN_M_S: Final = 6.6
"""The land detector believes in a take-off from here on, still on the wheels."""
CLIMB_OUT_M_S: Final = 2.63
"""Climb rate at FW_TKO_PITCH_MIN 10 degrees and full throttle."""
LIFTS_OFF_AT: Final = 1.1
"""Share of the take-off airspeed at which it leaves the ground: 11.3 m/s (RunwayTakeoff.cpp)."""
LANDING_SEEN_M_S: Final = 3.2
"""From here on the landing detector counts its 1.8 s: 0.9 m/s when it is done."""
LANDS_FASTER_M_S: Final = 0.5
"""Flown 10.8 m/s through the air where FW_AIRSPD_MIN is 10.3."""
SLOPE_FLOWN: Final = 0.98
"""Share of the sink of FW_LND_ANG that is flown: 0.85 m/s in the mean of the recorded landing."""
SINKS_FASTER_1_S: Final = 0.15
"""Sink for each m/s of airspeed too much: 1.3 m/s at first, 0.87 when it is slow."""
_ROLL_OUT_S: Final = 0.8
"""Time constant of the speed on the wheels without throttle, so that it stands when and where the
recorded one does, whose flare brakes it from 10.8 to 6.8 m/s before contact (then 1.33 s)."""
_FULL_M_S2: Final = 6.4
_RAMP_M_S3: Final = 5.7
"""Acceleration while RWTO_RAMP_TIME (2 s) opens the throttle."""


def take_off_m_s2(since_s: float, ramp_s: float) -> float:
    """Acceleration on the runway so long after arming."""
    return min(_RAMP_M_S3 * 2.0 / max(ramp_s, 0.1) * since_s, _FULL_M_S2)


def roll_out_m_s2(ground_speed_m_s: float) -> float:
    """Deceleration on the wheels (negative)."""
    return -max(ground_speed_m_s / _ROLL_OUT_S, 0.05)


def bank_near_ground_rad(height_m: float, wing_height_m: float, wing_span_m: float) -> float:
    """The bank that keeps the wing tips off the ground (getMaxRollAngleNearGround)."""
    return min(max(2.0 * (height_m - wing_height_m) / wing_span_m, 0.0), 0.5 * math.pi)


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

_AEROPLANE: Final = 1
_NAN: Final = math.nan
_STEER_EVERY = 2
"""Steps: the guidance runs at 50 Hz."""
_GLIDE_M_S = 1.6
"""Sink without throttle."""
_DESCEND_M_S = 0.5
"""Failsafe without a position (FixedWingModeManager::control_auto_descend)."""
_CLEARED_M = 10.0
"""A take-off climbs on by this much beyond its height (kClearanceAltitudeBuffer)."""
_ECHO_MASK = 3576


@final
class Px4FixedWing(Px4):
    """The aeroplane of PX4's SIH simulator, or one with other limits."""

    vehicle: Plane
    HANDLERS = HANDLERS
    TABLES = ("px4/common", "px4/fixed_wing")
    profile = profile(vehicle_type=_AEROPLANE, rates_hz=RATES_HZ | {231: 10.0})
    """WIND_COV as well, and ORBIT_EXECUTION_STATUS while it circles."""
    measures_airspeed = True

    def _set_up(self) -> None:
        self.course = Course(self.vehicle, Limits.of(self.parameters))
        self._version = self.parameters.version
        self._wheels = True
        """Stands or rolls on the ground."""
        self._steps = 0
        self._seen: Target | None = None
        """The setpoint that the course was made of."""
        self._leg: mission.Leg | None = None
        self._leg_aimed = False
        self._began_us = 0
        """When the mode began."""
        self._follows_path = False
        """OFFBOARD with position and velocity, which is not echoed."""

    # --- modes --------------------------------------------------------------------------------

    def _begin(self, mode: Mode, before: Mode) -> None:
        """What the mode makes it fly; in the air, and for a take-off on the ground."""
        self._began_us = self.now_us
        self._seen = None
        self._follows_path = False
        self._leg_aimed, self._leg = False, None
        course = self.course
        if mode is Mode.OFFBOARD:
            return  # the last commands stay until a setpoint comes
        course.airspeed_m_s = self.cruise_m_s(mode)
        if mode is Mode.TAKEOFF:
            self._start_climb(self._takeoff_altitude_m())
        elif mode is Mode.LOITER:
            self.start_hold(before)
        elif mode is Mode.RTL:
            self.start_return()
        elif mode is Mode.LAND:
            self.start_landing(self._here_m)
        elif mode in MANUAL_MODES:
            course.straight(self.local_m, self.vehicle.heading_rad)
            course.hold_altitude(self.estimate.altitude_amsl_m)
        elif mode is Mode.DESCEND:
            course.circle_blindly(math.radians(self.parameters["NAV_GPSF_R"]))
            course.climb(0.0)

    @property
    def _here_m(self) -> complex:
        """In the local frame: north + east j, as all places in the plane."""
        return complex(self.local_m[0], self.local_m[1])

    def _local_m(self, latitude_deg: float, longitude_deg: float) -> complex:
        return complex(*self.projection.to_local(latitude_deg, longitude_deg))

    def cruise_m_s(self, mode: Mode) -> float:
        """True airspeed: FW_AIRSPD_TRIM, or DO_CHANGE_SPEED's in the modes that know it."""
        parameters = self.parameters
        wanted = parameters["FW_AIRSPD_TRIM"]
        if self.speed_m_s is not None and mode in (Mode.LOITER, Mode.MISSION, Mode.RTL):
            wanted = self.speed_m_s
        least, most = parameters["FW_AIRSPD_MIN"], parameters["FW_AIRSPD_MAX"]
        return self._true(min(max(wanted, least), max(most, least)))

    def _true(self, equivalent_m_s: float) -> float:
        return true_airspeed_m_s(equivalent_m_s, self.estimate.altitude_amsl_m)

    def _start_climb(self, altitude_amsl_m: float) -> None:
        """Straight on where the nose points, and up; from the ground after the roll."""
        course = self.course
        course.straight(self.local_m, self.vehicle.heading_rad)
        course.hold_altitude(altitude_amsl_m)
        course.airspeed_m_s = self._takeoff_airspeed_m_s()

    def _takeoff_airspeed_m_s(self) -> float:
        chosen = self.parameters["FW_TKO_AIRSPD"]
        return self._true(chosen if chosen > 0.0 else self.parameters["FW_AIRSPD_MIN"])

    def start_hold(self, before: Mode) -> None:
        """A circle: about DO_REPOSITION's place, the take-off's, or here at this height."""
        centre_m = self._here_m
        altitude_m = self.estimate.altitude_amsl_m
        place: tuple[float, float, float] | None = None
        if self.reposition is not None:
            place = self.reposition[:3]
        elif before is Mode.TAKEOFF and self.takeoff_place is not None:
            place = self.takeoff_place
        if place is not None:
            latitude_deg, longitude_deg, wanted_m = place
            if math.isfinite(latitude_deg) and math.isfinite(longitude_deg):
                centre_m = self._local_m(latitude_deg, longitude_deg)
            altitude_m = wanted_m if math.isfinite(wanted_m) else altitude_m
        self.course.loiter(centre_m, self.loiter_radius_m)
        self.course.hold_altitude(altitude_m)

    @property
    def loiter_radius_m(self) -> float:
        """NAV_LOITER_RAD; a negative one turns left."""
        radius_m = self.parameters["NAV_LOITER_RAD"]
        return radius_m if abs(radius_m) > 1.0 else math.copysign(1.0, radius_m)

    def start_return(self) -> None:
        """Home, at RTL_RETURN_ALT or above; there it circles."""
        home = self.home or self._reference
        centre_m = self._local_m(home.latitude_deg, home.longitude_deg)
        height_m = home.altitude_amsl_m + self.parameters["RTL_RETURN_ALT"]
        self.course.loiter(centre_m, self.loiter_radius_m)
        self.course.hold_altitude(max(height_m, self.estimate.altitude_amsl_m))

    def start_landing(self, centre_m: complex) -> None:
        """Down in a circle.  NAV_LAND's own place is ignored, as recorded."""
        course = self.course
        course.airspeed_m_s = self._true(self._landing_airspeed_m_s()) + LANDS_FASTER_M_S
        course.loiter(centre_m, self.loiter_radius_m)
        self._glide()

    def _landing_airspeed_m_s(self) -> float:
        """Equivalent airspeed."""
        chosen = self.parameters["FW_LND_AIRSPD"]
        return chosen if chosen > 0.0 else self.parameters["FW_AIRSPD_MIN"]

    # --- one step -----------------------------------------------------------------------------

    def _fly(self, dt_s: float) -> None:
        if self.parameters.version != self._version:
            self._version = self.parameters.version
            self.course.limits = Limits.of(self.parameters)
            if self.course.circling:
                self.course.radius_m = self.loiter_radius_m
            if self.mode is not Mode.LAND and self.mode is not Mode.TAKEOFF:
                self.course.airspeed_m_s = self.cruise_m_s(self.mode)
        if self._wheels:
            self._roll(dt_s)
            return
        plane, course = self.vehicle, self.course
        if not self.armed:
            plane.fall(dt_s)
        else:
            self._steps += 1
            if self._steps % _STEER_EVERY == 0:
                self._steer(_STEER_EVERY * dt_s)
            plane.advance(course.bank_rad, course.climb_m_s, course.commanded_m_s, dt_s)
            plane.throttle = course.throttle
        if plane.altitude_amsl_m < self.ground_amsl_m:
            self._wheels = True
            plane.touch_down(self.ground_amsl_m)

    def _steer(self, dt_s: float) -> None:
        """Commands for the next steps, fifty times a second."""
        mode, course = self.mode, self.course
        if mode is Mode.OFFBOARD:
            if self.target is not self._seen and self.target is not None:
                self._take(self.target)
        elif mode is Mode.TAKEOFF:
            self._climb_out()
        elif mode is Mode.MISSION:
            self._follow_mission()
        elif mode is Mode.LAND:
            self._glide()
        elif mode is Mode.RTL:
            self.return_home()
        elif mode is Mode.DESCEND and self._since_s > self.parameters["NAV_GPSF_LT"]:
            course.climb(-_DESCEND_M_S)
        course.bank_most_rad = math.pi
        if mode in (Mode.TAKEOFF, Mode.LAND):
            height_m = self.estimate.altitude_amsl_m - self.ground_amsl_m
            parameters = self.parameters
            course.bank_most_rad = bank_near_ground_rad(
                height_m, parameters["FW_WING_HEIGHT"], parameters["FW_WING_SPAN"]
            )
        course.steer(self.local_m, self.estimate, dt_s)

    @property
    def _since_s(self) -> float:
        return (self.now_us - self._began_us) * 1e-6

    def _take(self, target: Target) -> None:
        """A setpoint of OFFBOARD (px4.md 10)."""
        course = self.course
        self._seen = target
        north_m, east_m, down_m = target.position_m
        v_n, v_e, v_d = target.velocity_m_s
        place = north_m == north_m and east_m == east_m
        moves = v_n == v_n and v_e == v_e
        if not place:
            course.stay()
            self._follows_path = False
            return
        self._follows_path = moves
        if moves:
            course.follow(complex(north_m, east_m), complex(v_n, v_e), _bend(target))
        else:
            course.aim_at(complex(north_m, east_m), self.loiter_radius_m)
        course.airspeed_m_s = self.cruise_m_s(Mode.OFFBOARD)
        if down_m == down_m:
            course.hold_altitude(self._reference.altitude_amsl_m - down_m)
        elif v_d == v_d:
            course.climb(0.0)
        else:
            course.climb(-_GLIDE_M_S)

    def _climb_out(self) -> None:
        """Up to the take-off's height, then Hold; for good if it was not told where to."""
        course, goal_m = self.course, self._takeoff_altitude_m()
        if self.estimate.altitude_amsl_m < goal_m:
            course.climb_out(CLIMB_OUT_M_S)
            course.airspeed_m_s = self.cruise_m_s(Mode.TAKEOFF)
            return
        course.hold_altitude(goal_m + _CLEARED_M)
        place = self.takeoff_place
        if place is not None and math.isfinite(place[0]) and math.isfinite(place[1]):
            self.finish_takeoff()

    def return_home(self) -> None:
        """Circling at home: down to RTL_DESCEND_ALT, and land after RTL_LAND_DELAY if not < 0."""
        course, parameters = self.course, self.parameters
        if course.landing or not course.on_circle(self.local_m):
            if course.landing:
                self._glide()
            return
        home = self.home or self._reference
        height_m = home.altitude_amsl_m + parameters["RTL_DESCEND_ALT"]
        course.hold_altitude(height_m)
        low = abs(self.estimate.altitude_amsl_m - height_m) < parameters["NAV_FW_ALT_RAD"]
        delay_s = parameters["RTL_LAND_DELAY"]
        if low and delay_s >= 0.0 and self._since_s > delay_s:
            self.start_landing(self._local_m(home.latitude_deg, home.longitude_deg))
            course.landing = True

    def _glide(self) -> None:
        """Down the slope of FW_LND_ANG, steeper while it is too fast."""
        glide = SLOPE_FLOWN * math.sin(math.radians(self.parameters["FW_LND_ANG"]))
        too_fast_m_s = max(self.vehicle.airspeed_m_s - self.course.airspeed_m_s, 0.0)
        sink_m_s = self._landing_airspeed_m_s() * glide + SINKS_FASTER_1_S * too_fast_m_s
        self.course.climb(-sink_m_s)

    # --- missions -----------------------------------------------------------------------------

    def _follow_mission(self) -> None:
        """Fly on along the leg; tell the mission when it is done."""
        leg = self._aim_leg()
        if leg is None:
            return
        if leg.command == mission.TAKEOFF:
            if self.estimate.altitude_amsl_m >= leg.altitude_amsl_m:
                self.mission.arrived()
        elif leg.command == mission.LAND:
            self._glide()
        elif self._has_arrived(leg):
            self.mission.arrived()

    def _aim_leg(self) -> mission.Leg | None:
        """The leg of now, with the course set to it."""
        leg = self.mission.leg
        if leg is not self._leg or not self._leg_aimed:
            before, self._leg, self._leg_aimed = self._leg, leg, True
            self._set_course(leg, before)
        return leg

    def _set_course(self, leg: mission.Leg | None, before: mission.Leg | None) -> None:
        """Along the line from the last waypoint, or about the leg's place."""
        course = self.course
        course.airspeed_m_s = self.cruise_m_s(Mode.MISSION)
        if leg is None:
            self.start_hold(Mode.MISSION)
            return
        place_m = self._local_m(leg.latitude_deg, leg.longitude_deg)
        from_m = self._here_m
        if leg.command == mission.TAKEOFF:
            way_rad = self.vehicle.heading_rad
            if size(place_m - from_m) > 1.0:
                way_rad = cmath.phase(place_m - from_m)
            course.straight(self.local_m, way_rad)
            course.climb_out(CLIMB_OUT_M_S)
        elif leg.command == mission.LAND:
            self.start_landing(place_m)
        elif leg.command == mission.WAYPOINT and leg.hold_s == 0.0:
            if before is not None and before.command == mission.WAYPOINT:
                from_m = self._local_m(before.latitude_deg, before.longitude_deg)
            course.fly_leg(from_m, place_m, self.loiter_radius_m)
            course.hold_altitude(leg.altitude_amsl_m)
        else:
            course.loiter(place_m, self.loiter_radius_m)
            course.hold_altitude(leg.altitude_amsl_m)

    def _has_arrived(self, leg: mission.Leg) -> bool:
        """Near enough in distance and height, or on the circle."""
        course, estimate = self.course, self.estimate
        off_m = abs(estimate.altitude_amsl_m - leg.altitude_amsl_m)
        if not off_m < self.parameters["NAV_FW_ALT_RAD"]:
            return False
        if not course.circling:
            near_m = course.switch_m(estimate)
            if leg.acceptance_m > near_m:
                near_m = leg.acceptance_m
            return course.distance_m(self.local_m) < near_m
        return course.on_circle(self.local_m)

    # --- on the wheels ------------------------------------------------------------------------

    def _roll(self, dt_s: float) -> None:
        """On the runway: up to speed, or to a halt."""
        plane = self.vehicle
        plane.altitude_amsl_m = self.ground_amsl_m
        speed_m_s = math.hypot(plane.velocity_north_m_s, plane.velocity_east_m_s)
        if self.armed and self._wants_up():
            since_s = (self.now_us - max(self._armed_us, self._began_us)) * 1e-6
            ramp_s = self.parameters["RWTO_RAMP_TIME"]
            plane.roll_on_ground(take_off_m_s2(since_s, ramp_s), dt_s)
            plane.throttle = min(since_s / max(ramp_s, 0.1), 1.0)
            self._run_up(plane.airspeed_m_s)
            return
        plane.throttle = 0.0
        if speed_m_s > 0.0:
            plane.roll_on_ground(roll_out_m_s2(speed_m_s), dt_s)
        if self.armed:
            self._contact(pressed=speed_m_s < LANDING_SEEN_M_S)
        elif speed_m_s == 0.0:
            self.landed = True

    def _wants_up(self) -> bool:
        """Take-off, by mode or by a mission that begins with one."""
        if self.mode is Mode.TAKEOFF:
            return True
        if self.mode is not Mode.MISSION:
            return False
        leg = self._aim_leg()
        return leg is not None and leg.command == mission.TAKEOFF

    def _run_up(self, airspeed_m_s: float) -> None:
        """Leave the ground at its airspeed."""
        if airspeed_m_s >= TAKEOFF_SEEN_M_S:
            self._took_off()
        if airspeed_m_s >= LIFTS_OFF_AT * self._takeoff_airspeed_m_s():
            self._took_off()
            self._wheels = False
            self.course.start(airspeed_m_s)

    # --- to tell ------------------------------------------------------------------------------

    def target_echo(self) -> TargetEcho | None:
        """The nearest point of the path, as PX4 publishes it; nothing while it follows one."""
        mode = self.mode
        if mode in MANUAL_MODES or mode is Mode.DESCEND:
            return None
        if mode is Mode.OFFBOARD and (self._follows_path or self._seen is None):
            return None
        course = self.course
        nearest_m, altitude_m = 0j, 0.0
        if self.armed:
            nearest_m = course.nearest_m
            altitude_m = course.told_altitude_m
        down_m = self._reference.altitude_amsl_m - altitude_m
        return TargetEcho(
            position_ned_m=(nearest_m.real, nearest_m.imag, down_m),
            velocity_ned_m_s=NOTHING,
            acceleration_ned_m_s2=NOTHING,
            yaw_rad=_NAN,
            yaw_rate_rad_s=_NAN,
            type_mask=_ECHO_MASK,
        )

    def _waypoint(self) -> Waypoint | None:
        """The place flown to; the middle of a circle."""
        if not self.armed:
            return None
        course = self.course
        goal_m = course.centre_m
        altitude_m = course.told_altitude_m
        place = self.takeoff_place
        if self.mode is Mode.TAKEOFF and place is not None and math.isfinite(place[0]):
            goal_m = self._local_m(place[0], place[1])
        way_m = goal_m - self._here_m
        return Waypoint(
            place=self.projection.place(goal_m.real, goal_m.imag, altitude_m),
            distance_m=size(way_m),
            bearing_rad=cmath.phase(way_m),
            radius_m=course.radius_m if course.circling else 0.0,
        )


def _bend(target: Target) -> float:
    """Curvature that an acceleration asks for, 1/m, with the sign that PX4 gives it: the wrong one.

    FixedWingModeManager.cpp:2074 against :2641-2644 (px4.md 1, item 7).
    """
    v_n, v_e, _ = target.velocity_m_s
    a_n, a_e, a_d = target.acceleration_m_s2
    speed_squared = v_n * v_n + v_e * v_e
    if not (a_n == a_n and a_e == a_e and a_d == a_d) or speed_squared < 1e-6:
        return 0.0
    return -(v_n * a_e - v_e * a_n) / (speed_squared * math.sqrt(speed_squared))
