"""PX4 1.17 flying a fixed wing: OFFBOARD and AUTO modes along circles and lines (px4.md 10).

OFFBOARD takes from SET_POSITION_TARGET what FixedWingModeManager takes: a position alone is flown
at, straight, and circled tightly when there; a position with a velocity is a point of a path and
its direction there; an acceleration with them bends that path, to the wrong side; without a
position nothing is steered and the last commands stay.  The speed is always FW_AIRSPD_TRIM.

The law is that of both planes (plane_control.py), the modes and speeds are PX4's.  The recorded
aeroplane sank to the ground after its take-off (px4-fixedwing-offboard.tlog, 25 to 150 s), and
takes most of a minute to find the last of its throttle.  This one does neither.
"""

import math
from typing import Final, final

from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.legs import RETURN, Does, Leg
from vehicle_sim.autopilot.plane_control import Circle, FixedWing, Line, eas_to_tas
from vehicle_sim.autopilot.px4 import RATES_HZ, Px4, firmware
from vehicle_sim.autopilot.setpoints import LOCAL_NED, NOTHING, given
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
_LIFTS_OFF_AT: Final = 1.1
"""Share of the take-off airspeed at which it leaves the ground: 11.3 m/s (RunwayTakeoff.cpp)."""
_LANDS_FASTER_M_S: Final = 0.5  # flown 10.8 m/s through the air where FW_AIRSPD_MIN is 10.3
_GLIDE_M_S: Final = 1.6  # sink without throttle
_DESCEND_M_S: Final = 0.5
"""Failsafe without a position (FixedWingModeManager::control_auto_descend)."""
_TRADED_M: Final = 15.0
"""Of height for airspeed that it lacks, at most: told 15 m/s, which the simulated one does not
reach, it stands 2 m low (TECS)."""
_ECHO_MASK: Final = 3576


@final
class Px4Plane(FixedWing, Px4):
    """The aeroplane of PX4's SIH simulator, or one with other limits."""

    full_m_s2, drag_1_s = 6.4, 0.0
    opens_s = 1.12  # RWTO_RAMP_TIME
    flying_m_s = 6.6  # the land detector believes in a take-off, still on the wheels
    lies_below_m_s = 3.2  # from here on it counts its 1.8 s: 0.9 m/s when it is done
    brakes_m_s2 = 8.4  # as long as the recorded one, which flares to 6.8 m/s before contact
    climbs_m_s = 2.63  # at FW_TKO_PITCH_MIN 10 degrees and full throttle
    lands_m_s = 0.87

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        self.l1.period_s, self.l1.damping = 10.0, 0.7  # NPFG_PERIOD, NPFG_DAMPING
        self._began_s = 0.0  # when the mode did

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        p = self.parameters
        self.bank_most_rad = math.radians(p["FW_R_LIM"])
        self.heights.climb_most_m_s = p["FW_T_CLMB_R_SP"]
        self.heights.sink_most_m_s = p["FW_T_SINK_R_SP"]

    def _true(self, equivalent_m_s: float) -> float:
        return equivalent_m_s * eas_to_tas(self.estimate.altitude_amsl_m)

    @property
    def _cruise_m_s(self) -> float:
        """True airspeed: FW_AIRSPD_TRIM, or DO_CHANGE_SPEED's in AUTO modes."""
        p, wanted_m_s = self.parameters, self.parameters["FW_AIRSPD_TRIM"]
        if self.mode.flies == "fly_legs":
            wanted_m_s = self.speed_m_s or wanted_m_s
        return self._true(min(max(wanted_m_s, p["FW_AIRSPD_MIN"]), p["FW_AIRSPD_MAX"]))

    # --- where to -----------------------------------------------------------------------------

    def circle(self, place: Place) -> None:
        """About a place, at its height; with a negative radius to the left."""
        radius_m = self.parameters["NAV_LOITER_RAD"]
        self.aim = Circle(place, math.copysign(max(abs(radius_m), 1.0), radius_m))

    def land_at(self, place: Place) -> None:
        """Down in a circle; NAV_LAND's own place is ignored, as recorded."""
        self.circle(self.estimate.place if self.mode.name == "Land" else place)

    def stops_at(self) -> Place:
        """It circles here."""
        return self.estimate.place

    def way_home(self) -> list[Leg]:
        """High, then lower about home."""
        p, home, here_m = self.parameters, self.base, self.estimate.altitude_amsl_m
        high = home.at(max(home.altitude_amsl_m + p["RTL_RETURN_ALT"], here_m))
        low = home.at(home.altitude_amsl_m + p["RTL_DESCEND_ALT"])
        return [Leg(Does.GO, high, 0.0, RETURN), Leg(Does.GO, low, math.inf, RETURN)]

    def restart(self) -> None:
        """Another mode; in OFFBOARD the last commands stay until a setpoint comes."""
        self._began_s, self.leg = self.now_s, None

    # --- in the air ---------------------------------------------------------------------------

    def check(self) -> None:
        """Where to and how high, ten times a second (the real one fifty times)."""
        super().check()
        if not self.armed:
            return
        getattr(self, self.mode.flies)()
        if self.aim is not None:
            energy = self.plane.airspeed_m_s**2 - self.wanted_airspeed_m_s**2
            more_m = min(max(energy / (2.0 * GRAVITY_M_S2), -_TRADED_M), _TRADED_M)
            self.wanted_height_m = self.aim.place.altitude_amsl_m + more_m
        self.bank()

    def _nearest(self) -> tuple[complex, complex, float]:
        """Point of the aim, from its place, that is nearest, the way there, and how it bends."""
        aim = self.aim
        assert aim is not None
        off_m = self.off_m(aim.place)
        if isinstance(aim, Line):
            return (off_m.conjugate() * aim.way).real * aim.way, aim.way, aim.curvature_1_m
        out = off_m if abs(off_m) > 0.1 else self.velocity
        out /= abs(out)
        way = math.copysign(1.0, aim.radius_m) * 1j * out
        return abs(aim.radius_m) * out, way, 1.0 / aim.radius_m

    def lateral_m_s2(self, aim: Circle | Line) -> float:
        """NPFG's, near enough: onto what is nearest, and bent as that is."""
        nearest_m, way, curvature_1_m = self._nearest()
        lateral = self.l1.line(self.off_m(aim.place) - nearest_m, way, self.velocity)
        return lateral + abs(self.velocity) ** 2 * curvature_1_m

    def fly_legs(self) -> None:
        """AUTO modes."""
        super().fly_legs()
        slow_m_s = self._true(self.parameters["FW_AIRSPD_MIN"])
        self.rotates_m_s = _LIFTS_OFF_AT * slow_m_s
        lands_m_s = slow_m_s + _LANDS_FASTER_M_S
        self.wanted_airspeed_m_s = lands_m_s if self.route.lands else self._cruise_m_s

    def is_there(self, leg: Leg) -> bool:
        """A take-off that was not told where to is for good."""
        endless = self.mode.name == "Takeoff" and not given(self.asked)
        return not endless and super().is_there(leg)

    def fly_target(self) -> None:
        """A new setpoint of OFFBOARD (px4.md 10)."""
        target, self.target = self.target, None  # each is taken once
        if target is None:
            return
        (north_m, east_m, down_m), (v_n, v_e, v_d) = target[:2]
        if not (north_m == north_m and east_m == east_m):
            self.aim = None
            return
        place = self.frame.place(north_m, east_m, down_m if down_m == down_m else 0.0)
        velocity, push = complex(v_n, v_e), complex(*target.acceleration[:2])
        self.straight_to(place)
        if (speed_m_s := abs(velocity)) > 1e-6:  # not NaN
            # bent to the wrong side, as PX4 does: FixedWingModeManager.cpp:2074, :2641-2644
            bend_1_m = (velocity * push.conjugate()).imag / speed_m_s**3
            bend_1_m = bend_1_m if bend_1_m == bend_1_m else 0.0
            self.aim = Line(place, velocity / speed_m_s, bend_1_m)
        self.wanted_airspeed_m_s, self.wanted_climb_m_s = self._cruise_m_s, None
        if down_m != down_m:
            self.wanted_climb_m_s = 0.0 if v_d == v_d else -_GLIDE_M_S

    def descend(self) -> None:
        """Without a position: banked, and after a while down."""
        p = self.parameters
        is_late = self.now_s - self._began_s > p["NAV_GPSF_LT"]
        self.aim, self.bank_rad = None, math.radians(p["NAV_GPSF_R"])
        self.wanted_climb_m_s = -_DESCEND_M_S if is_late else 0.0

    def sink(self) -> None:
        """By hand, without a pilot: straight on, wings level."""
        self.aim, self.bank_rad, self.wanted_climb_m_s = None, 0.0, 0.0

    # --- to tell ------------------------------------------------------------------------------

    def target_echo(self) -> Setpoint | None:
        """The nearest point of circle or leg; nothing in OFFBOARD, while that follows a path."""
        waypoint, place = self.waypoint(), (0.0, 0.0, self.frame.origin.altitude_amsl_m)
        if self.mode.flies != "fly_legs" and not isinstance(self.aim, Circle):
            return None
        if self.armed and waypoint is not None:
            nearest_m, earth = self._nearest()[0], FlatEarth(waypoint.place)
            place = self.frame.ned_m(earth.place(nearest_m.real, nearest_m.imag, 0.0))
        return Setpoint(False, LOCAL_NED, _ECHO_MASK, place, NOTHING, NOTHING, math.nan, math.nan)

    def waypoint(self) -> Waypoint | None:
        """The place flown to, or the middle of a circle; of height 0 in a landing (recorded)."""
        aim = self.aim
        return aim and Waypoint(place=aim.place.at(0.0) if self.route.lands else aim.place)
