"""ArduPlane 4.7: its modes, take-off from a runway, and points to circle (ardupilot.md 7).

Whatever it flies to by itself is a point that it circles in the end, or passes in a mission.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, final

import numpy as np

from vehicle_sim.autopilot import values
from vehicle_sim.autopilot.ardupilot import EKF3, ArduPilot, firmware
from vehicle_sim.autopilot.core import HEARTBEAT, HOME_POSITION, Boot, Mode
from vehicle_sim.autopilot.earth import FlatEarth, way_m
from vehicle_sim.autopilot.estimator import State as Estimates
from vehicle_sim.autopilot.legs import RETURN, WAYPOINT, Does, Leg
from vehicle_sim.autopilot.plane_control import Circle, FixedWing, eas_to_tas
from vehicle_sim.autopilot.values import Command, Place, Reply, Result, Waypoint
from vehicle_sim.dynamics import GRAVITY_M_S2

_BY_HAND, _BY_ITSELF = 0x51, 0x59
"""base_mode: stabilised, with manual override; guided as well where it navigates."""
_GLIDES = {"MANUAL": 0, "STABILIZE": 2, "TRAINING": 3, "ACRO": 4, "FBWA": 5, "AUTOTUNE": 8}
"""The throttle is in a hand that is not there."""
_NAVIGATES = {"CIRCLE": 1, "AUTO": 10, "RTL": 11, "LOITER": 12, "TAKEOFF": 13, "GUIDED": 15}
FIRMWARE: Final = firmware(
    "arduplane",
    vehicle_type=1,
    capabilities=62319,
    # what a fresh link gets unasked
    rates_hz=dict.fromkeys((0, 1, 2, 24, 30, 32, 33, 42, 62, 74, 87, 147, 162, 168), 1.0)
    | {111: 0.1},
    # without the Q modes (17 to 23, 25): the airframe is no quadplane
    modes=(
        Mode("INITIALISING", 16, "glides", base=0x11),
        *(Mode(name, number, "glides", base=_BY_HAND) for name, number in _GLIDES.items()),
        Mode("FBWB", 6, "cruises", base=_BY_HAND),
        Mode("CRUISE", 7, "cruises", base=_BY_HAND),
        *(Mode(name, number, "navigates", base=_BY_ITSELF) for name, number in _NAVIGATES.items()),
    ),
    orders={17: "LOITER", 20: "RTL", 300: "AUTO"},
    pilot="FBWA",
    timing=replace(
        EKF3, stages=((0.0, 0x400), (11.1, 0x000), (12.3, 0x0A7)), origin_s=10.22, good_s=11.24
    ),
    ready_s=1.727,
    prearm_s=22.8,
    believes_landing_s=0.0,
    arms="Throttle armed",
    disarms="Throttle disarmed",
)

_DEMANDED_M_S = (0.0, 10.0, 20.0, 22.0, 25.0, 30.0, 300.0)
_HELD_M_S = (0.0, 10.17, 20.34, 22.70, 26.83, 33.0, 330.0)
"""What it flies at these demands, at sea level: 18 m/s demanded is flown at 18.9, 20 at 21, 22 at
23.5, 25 at 27.7 m/s, all at 600 m above the sea (ardupilot.md 7); thin air adds 3 %."""
_LIFT_OFF_SHARE: Final = 0.86  # of the cruising airspeed
_CLIMB_AIRSPEED: Final = 1.225  # at full throttle and nose up, over cruising airspeed
_AIMED_M_S: Final = 5.0  # ground speed at which TAKEOFF settles where it goes
_LEVEL_RAD, _LEVEL_M = math.radians(5.0), 20.0
"""Bank below this height of a take-off, at most (LEVEL_ROLL_LIMIT, TKOFF_LVL_ALT)."""
_REACHED_M: Final = 2.0  # a take-off is over so much below its height
_TURN_EFFICIENCY: Final = 0.745
"""Lateral acceleration over g tan(bank) of the recorded airframe, which slips in turns (measured:
0.745 +- 0.01 over 240 s); that is why its circles are wider than asked."""
_GLIDE_M_S: Final = 2.5
_DISARMS_S: Final = 20.0  # LAND_DISARMDELAY
_HEADING_GAIN: Final = math.radians(50.0)
"""Bank for each radian of course error: GUIDED_P 5000 hundredths of a degree."""
_NO_HEIGHT = "SIM: NaN height in {} stops the real autopilot"


@final
class ArduPlane(FixedWing, ArduPilot):
    """Modes, GUIDED's points and take-off."""

    gcs_failsafe = "FS_GCS_ENABL"
    # arduplane-guided-reposition.tlog, 26 to 35 s
    full_m_s2, drag_1_s = 14.5, 0.55
    opens_s = 1.4  # TKOFF_THR_DELAY, THR_SLEWRATE
    flying_m_s = lies_below_m_s = 2.5
    brakes_m_s2 = 3.0
    climbs_m_s = 9.9
    lands_m_s = 1.5  # wings level from the place of a landing on: no approach and no flare

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        self.plane.turn_efficiency = _TURN_EFFICIENCY
        self._start = self.estimate.place  # where it was told where to go
        self._arrived = False
        self._course: tuple[float, float] | None = None
        """GUIDED_CHANGE_HEADING, instead of the point: course and most bank, in radians."""
        self._asked_m_s: float | None = None  # airspeed, by a command
        self._demand_m_s = 22.0  # airspeed as a pitot tube measures it
        self.handlers |= {
            22: lambda _: Result.FAILED,  # there is the mode TAKEOFF for that
            178: self._change_speed,
            192: self._reposition,
            43000: self._change_speed,
            43002: self._change_heading,
        }

    # --- where to -----------------------------------------------------------------------------

    def begin(self) -> None:
        """What was told before is forgotten; without anything new it circles here."""
        position, p, self._asked_m_s, self.leg = self.estimate.place, self.parameters, None, None
        self.wanted_climb_m_s = None
        self.route.stop()
        self.circle(position)
        self.wanted_height_m = position.altitude_amsl_m
        if self.mode.name == "RTL":
            self.route.fly([Leg(Does.GO, self._over_home(), math.inf, RETURN)], self.now_s)
        elif self.mode.name == "TAKEOFF" and self.plane.stands:
            ahead_m = cmath.rect(p["TKOFF_DIST"], self.plane.heading_rad)
            place = FlatEarth(position).place(ahead_m.real, ahead_m.imag, -p["TKOFF_ALT"])
            climb = Leg(Does.CLIMB, place.at(place.altitude_amsl_m - _REACHED_M), command=RETURN)
            self.route.fly([climb, Leg(Does.GO, place, math.inf, RETURN)], self.now_s)
            self.circle(place)
            self.leg = climb  # it aims at the circle even while it climbs
        elif self.mode.name == "AUTO":
            self.seek(max(self.route.current, 1))

    def on_armed(self) -> None:
        """The mode begins."""
        self.begin()
        super().on_armed()

    def on_disarmed(self) -> None:
        """Nothing turns."""

    def circle(self, place: Place, radius_m: float = 0.0, *, left: bool = False) -> None:
        """About a place, at its height; wider where the air is thin."""
        usual_m, self._course = self.parameters["WP_LOITER_RAD"], None
        radius_m = radius_m if radius_m > 1.0 else max(abs(usual_m), 1.0)
        radius_m *= eas_to_tas(place.altitude_amsl_m) ** 2
        self.aim = Circle(place, -radius_m if left or usual_m < 0.0 else radius_m)
        self._start, self._arrived = self.estimate.place, False

    def _over_home(self) -> Place:
        """RTL_ALTITUDE above it."""
        place, above_m = self.estimate.place, self.parameters["RTL_ALTITUDE"]
        home = self.home or place
        return home.at(place.altitude_amsl_m if above_m < 0.0 else home.altitude_amsl_m + above_m)

    def begin_leg(self, speed_m_s: float | None) -> None:
        """Another item; it takes off straight ahead, waits at no way point, and circles home."""
        leg, place = self.route.leg, self.estimate.place
        self._start = place
        self._asked_m_s = speed_m_s or self._asked_m_s
        if leg is not None and leg.does is Does.CLIMB:
            self.route.leg = leg._replace(place=place.at(leg.place.altitude_amsl_m))
        elif leg is not None and leg.does is Does.RETURN:
            self.route.leg = Leg(Does.GO, self._over_home(), math.inf, RETURN)
        elif leg is not None and leg.command == WAYPOINT:
            self.route.leg = leg._replace(hold_s=0.0)
        self.fly_leg()

    def land_at(self, place: Place) -> None:
        """Straight on over the place, from where it sinks."""
        self.straight_to(place.at(self.estimate.altitude_amsl_m))

    def lands(self) -> bool:
        """Where AUTO does."""
        return self.is_at(Does.LAND)

    def on_failsafe(self, cause: str, action: int) -> None:
        """It returns; not from MANUAL for a fence, AUTO for GCS, nor a landing for power."""
        stays = {
            "GCS": self.landed or self.mode.name == "AUTO",
            "Battery": action not in (1, 2) or self.lands(),
            "Fence": self.mode.name == "MANUAL",
        }
        if not stays.get(cause, False):
            self.set_mode("RTL")
        if cause == "GCS":
            self.say(4, f"GCS Failsafe On: {self.mode.name}")

    # --- commands -----------------------------------------------------------------------------

    def _reposition(self, command: Command) -> Result:
        """DO_REPOSITION: a point to circle."""
        _, flags, radius_m, left, *at, height_m = command.parameters
        if command.frame is None:
            return Result.UNSUPPORTED
        if not math.isfinite(height_m):
            self.say(2, _NO_HEIGHT.format("DO_REPOSITION"))
            return Result.DENIED
        place = self.place_of(command)
        if place is None or at == [0.0, 0.0] or self.outside_fence(place):
            return Result.DENIED
        if self.mode.name != "GUIDED" and not (math.isfinite(flags) and int(flags) & 1):
            return Result.FAILED
        self.set_mode("GUIDED")
        is_left = math.isfinite(left) and left != 0.0
        self.circle(place, radius_m if radius_m < math.inf else 0.0, left=is_left)
        # until navigation has run again the height to be at is the present one
        self.wanted_height_m = self.estimate.altitude_amsl_m
        return Result.ACCEPTED

    def _change_speed(self, command: Command) -> Result:
        """DO_CHANGE_SPEED and GUIDED's own: an airspeed."""
        kind, speed_m_s = command.parameters[:2]
        if self.mode.name not in ("GUIDED", "AUTO"):
            return Result.FAILED
        least_m_s, most_m_s = (self.parameters[f"AIRSPEED_{end}"] for end in ("MIN", "MAX"))
        if kind != 0.0 or not least_m_s <= speed_m_s <= most_m_s:
            return Result.DENIED
        self._asked_m_s = speed_m_s
        return Result.ACCEPTED

    def _change_heading(self, command: Command) -> Result:
        """GUIDED_CHANGE_HEADING: a course over the ground, until there is a new point."""
        kind, course_deg, lateral_m_s2 = command.parameters[:3]
        if self.mode.name != "GUIDED":
            return Result.FAILED
        if kind != 0.0 or not (0.0 <= course_deg < 360.0 and 0.0 < lateral_m_s2 < math.inf):
            return Result.DENIED
        self._course = math.radians(course_deg), math.atan(lateral_m_s2 / GRAVITY_M_S2)
        return Result.ACCEPTED

    def on_setpoint(self, setpoint: values.Setpoint) -> Sequence[Reply]:
        """Only heights are taken, and only in GUIDED."""
        aim, home, z_m, height_m = self.aim, self.home, setpoint.position[2], None
        if self.mode.name != "GUIDED" or home is None or aim is None:
            return ()
        if setpoint.is_global and not setpoint.type_mask & 4:  # it has no terrain data either
            home_m = home.altitude_amsl_m
            height_m = values.height_amsl_m(setpoint.frame, z_m, home_m, home_m)
        elif not setpoint.is_global and setpoint.frame == 7:
            height_m = aim.place.altitude_amsl_m - z_m
        if height_m is not None and math.isfinite(height_m):
            self.aim = aim._replace(place=aim.place.at(height_m))
        elif height_m is not None:
            self.say(2, _NO_HEIGHT.format("a setpoint"))
        return self.taken()

    def disarms_after_s(self) -> float | None:
        """After a landing of a mission."""
        return _DISARMS_S if self.lands() else None

    # --- ten times a second -------------------------------------------------------------------

    def look(self) -> None:
        """Home is where the first fix was: plane does not wait for the EKF."""
        if self.home is not None:
            return
        if self.mode.name == "INITIALISING" and self.now_s >= FIRMWARE.ready_s:
            self.mode = self.modes["MANUAL"]
            self.send(HEARTBEAT)
        fix = self.fix
        if fix.usable:
            self.home = Place(fix.latitude_deg, fix.longitude_deg, fix.altitude_amsl_m)
            self.send(HOME_POSITION)

    def check(self) -> None:
        """Where to, how high and how fast; without a position wings level."""
        super().check()
        p, navigates = self.parameters, self.mode.flies == "navigates"
        if navigates and self.estimate.position_ok:
            self._navigate()
        else:
            self.bank_rad = 0.0
        if not navigates:
            self.wanted_climb_m_s = -_GLIDE_M_S if self.mode.flies == "glides" else None
        asked_m_s = self._asked_m_s or p["AIRSPEED_CRUISE" if navigates else "AIRSPEED_MIN"]
        self._demand_m_s = min(max(asked_m_s, p["AIRSPEED_MIN"]), p["AIRSPEED_MAX"])
        held_m_s = float(np.interp(self._demand_m_s, _DEMANDED_M_S, _HELD_M_S))
        cruise_m_s = held_m_s * eas_to_tas(self.estimate.altitude_amsl_m)
        climbs = self.is_at(Does.CLIMB) and not self.plane.stands
        self.wanted_airspeed_m_s = cruise_m_s * (_CLIMB_AIRSPEED if climbs else 1.0)
        self.rotates_m_s = _LIFT_OFF_SHARE * cruise_m_s

    def _navigate(self) -> None:
        """By itself: along its aim; a take-off begins where it starts to roll."""
        waits = self.plane.stands and abs(self.velocity) < _AIMED_M_S
        if waits and self.armed and self.mode.name == "TAKEOFF":
            self.begin()
        self.fly_legs()
        if self.mode.name == "AUTO" and self.route.leg is None and not self.plane.stands:
            self.set_mode("RTL")
        self.bank()
        assert self.aim is not None
        place, start = self.aim.place, self._start
        self.wanted_height_m = place.altitude_amsl_m
        if self.mode.name == "GUIDED" and not (self._arrived or self.landed):
            is_past = (self.off_m(place).conjugate() * way_m(start, place)).real > 0.0
            self._arrived = self.l1.circling or is_past
            if self._arrived:
                self.reached(0)
        climbed_m = self.estimate.altitude_amsl_m - start.altitude_amsl_m
        if self._course is not None:
            course_rad, most_rad = self._course
            error_rad = math.remainder(course_rad - cmath.phase(self.velocity), math.tau)
            self.bank_rad = min(max(_HEADING_GAIN * error_rad, -most_rad), most_rad)
        elif self.route.lands:
            self.bank_rad = 0.0
        elif self.is_at(Does.CLIMB) and climbed_m < _LEVEL_M:
            self.bank_rad = min(max(self.bank_rad, -_LEVEL_RAD), _LEVEL_RAD)

    def wants_up(self) -> bool:
        """A take-off; it does not begin without a position."""
        return super().wants_up() and (self.estimate.position_ok or not self.plane.stands)

    def climbs_out(self) -> bool:
        """Whether a take-off goes on."""
        return self.is_at(Does.CLIMB) and self.plane.throttle > 0.0

    # --- telling ------------------------------------------------------------------------------

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        p = self.parameters
        self.l1.period_s = max(p["NAVL1_PERIOD"], 1.0)
        self.heights.climb_most_m_s = max(p["TECS_CLMB_MAX"], 0.1)
        self.heights.sink_most_m_s = max(p["TECS_SINK_MAX"], 0.1)
        self.passes_m = p["WP_RADIUS"]
        self.bank_most_rad = math.radians(min(abs(p["ROLL_LIMIT_DEG"]), 80.0))

    def airspeed_m_s(self) -> float:
        """What the pitot tube measures: less than the true airspeed, as it is calibrated."""
        equivalent_m_s = self.plane.airspeed_m_s / eas_to_tas(self.estimate.altitude_amsl_m)
        return float(np.interp(equivalent_m_s, _HELD_M_S, _DEMANDED_M_S))

    def local_ned_m(self) -> values.Vector | None:
        """About home, by another estimator, until this one flies for the first time."""
        if self.estimate.state is Estimates.START and self.home is not None:
            return 0.0, 0.0, self.home.altitude_amsl_m - self.estimate.altitude_amsl_m
        return super().local_ned_m()

    def waypoint(self) -> Waypoint | None:
        """Where it goes; MANUAL says nothing."""
        aim = self.aim
        if aim is None or self.mode.name in ("MANUAL", "INITIALISING"):
            return None
        return Waypoint(
            place=aim.place,
            distance_m=abs(self.off_m(aim.place)),
            bearing_rad=self.l1.bearing_rad,
            altitude_error_m=self.wanted_height_m - self.estimate.altitude_amsl_m,
            cross_track_m=self.l1.cross_track_m,
            airspeed_error_m_s=self._demand_m_s - self.airspeed_m_s(),
        )
