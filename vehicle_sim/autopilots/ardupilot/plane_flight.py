"""ArduPlane in motion: on the runway, taking off, in each mode, landing, touching the ground.

Navigation is run ten times a second, attitude and height at every step.
"""

import enum
import math
from typing import final

from vehicle_sim.autopilots import Landed, Place, Waypoint
from vehicle_sim.autopilots.ardupilot.autopilot import HEARTBEAT, ArduPilot
from vehicle_sim.autopilots.ardupilot.flat_earth import distance_m, offset
from vehicle_sim.autopilots.ardupilot.plane_mission import Guided, Mission
from vehicle_sim.autopilots.ardupilot.plane_navigation import (
    GLIDES,
    LOITERS,
    NAVIGATION_S,
    SLOW,
    HeightControl,
    Mode,
    Navigation,
    indicated_airspeed_m_s,
    true_airspeed_m_s,
)
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.parameters import Parameters

# --- ArduPlane's take-off from a runway: arduplane-guided-reposition.tlog, 26 to 35 s

FULL_THRUST_M_S2, DRAG_1_S = 14.5, 0.55
"""Acceleration on the runway at full throttle, and what it loses with each metre a second."""
LIFT_OFF_SHARE = 0.86
"""Of the cruising airspeed."""
FLYING_M_S = 2.5
"""Ground speed that counts as flying."""
AIMED_M_S = 5.0
"""Ground speed at which TAKEOFF settles where it goes."""
CLIMB_AIRSPEED = 1.225
"""At full throttle and nose up, over cruising airspeed."""
CLIMB_M_S = 9.9
ROLL_LEVEL_TO_FREE = 3.0
"""Wings are held level below TKOFF_LVL_ALT; above so many times that the bank is free."""


class Stage(enum.Enum):
    """Where a take-off is."""

    IDLE = enum.auto()
    WAITING = enum.auto()
    RUNNING = enum.auto()
    CLIMBING = enum.auto()


@final
class Takeoff:
    """One take-off after another."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.stage = Stage.IDLE
        self._since_s = 0.0
        self._throttle = 0.0

    def abandon(self) -> None:
        """Abandon the take-off."""
        self.stage = Stage.IDLE

    @property
    def suppressed(self) -> bool:
        """The motor is not yet allowed to run."""
        return self.stage in (Stage.IDLE, Stage.WAITING)

    def run(self, plane: Plane, cruise_m_s: float, dt_s: float) -> bool:
        """One step on the runway; True when it lifts off."""
        parameters = self._parameters
        if self.stage is Stage.IDLE:
            self.stage, self._since_s = Stage.WAITING, 0.0
        self._since_s += dt_s
        if self.stage is Stage.WAITING:
            if self._since_s < parameters["TKOFF_THR_DELAY"] * 0.1:
                plane.roll_on_ground(-3.0, dt_s)
                return False
            self.stage, self._throttle = Stage.RUNNING, 0.0
        slew = parameters["THR_SLEWRATE"] * 0.01 or 100.0
        self._throttle = min(self._throttle + slew * dt_s, parameters["THR_MAX"] * 0.01)
        thrust = FULL_THRUST_M_S2 * self._throttle**1.5
        plane.roll_on_ground(thrust - DRAG_1_S * plane.airspeed_m_s, dt_s)
        plane.throttle = self._throttle
        lift_off = max(parameters["TKOFF_ROTATE_SPD"], LIFT_OFF_SHARE * cruise_m_s)
        if plane.airspeed_m_s >= lift_off:
            self.stage = Stage.CLIMBING
            return True
        return False

    def bank_limit_rad(self, climbed_m: float) -> float:
        """How far it may bank at this height above the runway."""
        parameters = self._parameters
        low_m = max(parameters["TKOFF_LVL_ALT"], 0.0)
        free_m = min(low_m * ROLL_LEVEL_TO_FREE, parameters["TKOFF_ALT"])
        share = 1.0 if free_m <= low_m else (climbed_m - low_m) / (free_m - low_m)
        level, free = parameters["LEVEL_ROLL_LIMIT"], parameters["ROLL_LIMIT_DEG"]
        return math.radians(level + min(max(share, 0.0), 1.0) * (free - level))


TURN_EFFICIENCY = 0.745
"""Lateral acceleration over g tan(bank) of the recorded airframe, which slips in turns (measured:
0.745 +- 0.01 over 240 s); that is why its circles are wider than asked."""
SLOWING_M_S2 = 2.2
"""How fast it loses speed with the throttle slewing down."""
EXCESS_CLIMB = 0.9
"""After a take-off the excess of speed is turned into height: climb for each m/s of it."""
GLIDE_M_S = 2.5
LANDING_SINK_M_S = 1.5
"""Wings level from the place of a landing on: no approach and no flare."""
READY_US = 1_727_000
"""Since boot, until it leaves INITIALISING."""
BRAKING_M_S2 = -3.0


@final
class Flight:
    """What the plane does now, and the numbers that it does it by."""

    def __init__(self, host: ArduPilot, plane: Plane) -> None:
        self._host = host
        self._plane = plane
        plane.turn_efficiency = TURN_EFFICIENCY
        parameters = host.parameters
        self.navigation = Navigation(host.estimate, plane, parameters)
        self.takeoff = Takeoff(parameters)
        self.guided = Guided(parameters)
        self.mission = Mission(host, plane, self.navigation, self.guided)
        self.heights = HeightControl(climb_max_m_s=5.0, sink_max_m_s=5.0)
        self.flying = False
        self.crashed = False
        self.ever_aided = False
        self.mission_over = False
        self._bank_rad = 0.0
        self._bank_most_rad = 1.0
        self._speed_m_s = 0.0
        """True airspeed to hold now; it follows the demand as fast as the throttle can."""
        self._demand_m_s = 22.0
        self._start: Place | None = None
        """TAKEOFF has settled where it goes."""
        self._settling = False
        """Climbing on with the speed that is left from a take-off."""
        self._still_us = 0
        self.read_parameters()

    def read_parameters(self) -> None:
        """Some parameter has changed."""
        parameters = self._host.parameters
        self.navigation.read_parameters()
        self.heights.climb_max_m_s = max(parameters["TECS_CLMB_MAX"], 0.1)
        self.heights.sink_max_m_s = max(parameters["TECS_SINK_MAX"], 0.1)
        self._bank_most_rad = math.radians(min(abs(parameters["ROLL_LIMIT_DEG"]), 80.0))

    # --- modes and what GUIDED is told ----------------------------------------------------------

    def enter(self, mode: Mode) -> None:
        """Begin to fly in this mode; what GUIDED was told is forgotten."""
        self.guided.forget()
        self.mission.stop()
        navigation, here = self.navigation, self._host.estimate.place
        navigation.l1.forget()
        if not self._host.landed and self.takeoff.stage is Stage.CLIMBING:
            self._end_climb()
        if self._host.landed:
            self.takeoff.abandon()
        self._start = here
        if mode is Mode.RTL:
            navigation.return_home(self._host.home)
            return
        if mode is Mode.AUTO:
            self.mission_over = False
            self.mission.begin()
            return
        if mode is Mode.TAKEOFF and not self._host.landed:
            self._climb_on()
            return
        navigation.start(here, here)
        navigation.active_radius_m = 0.0
        navigation.target_amsl_m = here.altitude_amsl_m

    def _climb_on(self) -> None:
        """TAKEOFF in the air: to its height, ahead, then circle."""
        navigation, here = self.navigation, self._host.estimate.place
        parameters, home = self._host.parameters, self._host.home
        above_m = here.altitude_amsl_m - (home.altitude_amsl_m if home else 0.0)
        missing_m = parameters["TKOFF_ALT"] - above_m
        navigation.active_radius_m = 0.0
        if missing_m <= 0.0:
            navigation.start(here, here)
            return
        self._aim_ahead(missing_m)

    def _aim_ahead(self, up_m: float) -> None:
        """To the point TKOFF_DIST ahead and so much higher."""
        here, course = self._host.estimate.place, self.navigation.course_rad
        away_m = self._host.parameters["TKOFF_DIST"]
        ahead = offset(here, away_m * math.cos(course), away_m * math.sin(course), up_m)
        self.navigation.start(here, ahead)

    def reposition(self, place: Place, radius_m: float | None, *, counter_clockwise: bool) -> None:
        """DO_REPOSITION: without a radius the one before is kept."""
        navigation, here = self.navigation, self._host.estimate.place
        self.guided.holds_heading = False
        navigation.start(here, place, counter_clockwise=counter_clockwise)
        navigation.slope(descend_only=True)
        if radius_m is not None:
            navigation.active_radius_m = min(float(int(radius_m)), 65535.0)
        # until navigation has run again the height to be at is the present one
        navigation.target_amsl_m = here.altitude_amsl_m

    # --- ten times a second -----------------------------------------------------------------------

    def navigate(self) -> None:
        """Where to, how high, how fast, and how to bank for it."""
        host, navigation = self._host, self.navigation
        if host.ekf.aiding:
            self.ever_aided = True
        self._update_flying()
        self._demand()
        if not host.ekf.position_ok:
            self._bank_rad = 0.0
            return
        navigation.measure()
        self._bank_rad = self._wanted_bank()
        if host.mode in LOITERS or host.mode in (Mode.AUTO, Mode.TAKEOFF):
            navigation.update_altitude()

    def _wanted_bank(self) -> float:
        host, mode = self._host, self._host.mode
        if mode == Mode.AUTO:
            return self._auto()
        if mode == Mode.CIRCLE:
            return self._bank_most_rad / 3.0
        if mode == Mode.TAKEOFF:
            return self._take_off()
        if mode not in LOITERS:
            return 0.0
        navigation = self.navigation
        if navigation.next is None:
            return 0.0
        if mode == Mode.GUIDED and self.guided.holds_heading:
            return self._bank_rad  # attitude follows the heading at each step
        bank = navigation.circle(navigation.active_radius_m)
        if not navigation.arrived and (navigation.l1.circling or navigation.along > 1.0):
            navigation.arrived = True
            if mode == Mode.GUIDED and self.flying:
                host.reached(0)
        return bank

    def _take_off(self) -> float:
        """TAKEOFF: to its point ahead, then circle it."""
        navigation, host, plane = self.navigation, self._host, self._plane
        parameters = host.parameters
        here = self._host.estimate.place
        stage = self.takeoff.stage
        if host.landed and host.armed:
            speed = math.hypot(plane.velocity_north_m_s, plane.velocity_east_m_s)
            if self._start is not None and stage is not Stage.RUNNING:
                self._start = here
            if navigation.next is None or speed < AIMED_M_S or navigation.distance_m < 1.0:
                self._start = here
                self._aim_ahead(parameters["TKOFF_ALT"])
        bank = navigation.circle(0.0)
        if stage is not Stage.CLIMBING or self._start is None:
            return bank
        climbed_m = here.altitude_amsl_m - self._start.altitude_amsl_m
        to_go_m = parameters["TKOFF_ALT"] - climbed_m
        if to_go_m <= 2.0 or distance_m(self._start, here) >= parameters["TKOFF_DIST"]:
            self._end_climb()
            host.took_off()
        limit = self.takeoff.bank_limit_rad(climbed_m)
        return min(max(bank, -limit), limit)

    def _auto(self) -> float:
        """AUTO: the mission; without one it returns."""
        host, mission = self._host, self.mission
        if host.landed and not mission.takes_off:
            return 0.0
        bank = mission.bank_rad()
        if not mission.runs and host.armed and not host.landed:
            self.mission_over = True
            host.set_mode(Mode.RTL)
            return 0.0
        if self.takeoff.stage is Stage.CLIMBING:
            if not mission.takes_off:
                self._end_climb()
                host.took_off()
            elif self._start is not None:
                climbed_m = self._host.estimate.place.altitude_amsl_m - self._start.altitude_amsl_m
                limit = self.takeoff.bank_limit_rad(climbed_m)
                bank = min(max(bank, -limit), limit)
        return 0.0 if self._sinks else bank

    def _end_climb(self) -> None:
        """From take-off to normal flight."""
        self.takeoff.abandon()
        self.heights.begin(self._host.estimate.altitude_amsl_m)
        self._settling = True

    def _demand(self) -> None:
        """Airspeed to hold."""
        host = self._host
        parameters, mode = host.parameters, host.mode
        wanted = parameters["AIRSPEED_CRUISE"]
        if mode in SLOW or mode in GLIDES:
            wanted = parameters["AIRSPEED_MIN"]
        elif mode in (Mode.GUIDED, Mode.AUTO):
            guided = self.guided.airspeed_m_s(self._demand_m_s, NAVIGATION_S)
            wanted = guided or self.guided.cruise_m_s or wanted
        self._demand_m_s = min(max(wanted, parameters["AIRSPEED_MIN"]), parameters["AIRSPEED_MAX"])

    def _update_flying(self) -> None:
        """What counts as flying: fast enough with the motor on, or in the air."""
        host = self._host
        if not host.landed:
            self.flying = True
        elif self.flying or self.takeoff.stage is Stage.RUNNING:
            e = host.estimate
            speed = math.hypot(e.velocity_north_m_s, e.velocity_east_m_s)
            self.flying = host.armed and speed >= FLYING_M_S

    # --- at every step ----------------------------------------------------------------------------

    def step(self, dt_s: float, ground_amsl_m: float) -> None:
        """Control and move the plane, by the estimate."""
        host, plane = self._host, self._plane
        if host.mode == Mode.INITIALISING and host.now_us >= READY_US:
            host.mode = Mode.MANUAL
            host.send(HEARTBEAT)
        if host.landed:
            self._on_ground(dt_s, ground_amsl_m)
            return
        height_m = host.estimate.altitude_amsl_m
        bank, guided = self._bank_rad, self.guided
        if guided.holds_heading:
            bank = guided.bank_rad(
                self.navigation.course_rad if guided.of_course else plane.heading_rad, dt_s
            )
        most = self._bank_most_rad
        bank = -most if bank < -most else most if bank > most else bank
        mode = host.mode
        if plane.broken:
            plane.fall(dt_s)
        elif not host.armed or mode in GLIDES:
            self.heights.begin(height_m)
            speed = true_airspeed_m_s(self._demand_m_s, height_m)
            plane.advance(0.0 if mode in GLIDES else bank, -GLIDE_M_S, speed, dt_s)
            plane.throttle = 0.0
            self._speed_m_s = plane.airspeed_m_s
        elif self.takeoff.stage is Stage.CLIMBING:
            self._speed_m_s = self._cruise_m_s() * CLIMB_AIRSPEED
            plane.advance(bank, CLIMB_M_S, self._speed_m_s, dt_s)
            plane.throttle = 1.0
        elif self._sinks:
            plane.advance(0.0, -LANDING_SINK_M_S, self._cruise_m_s(), dt_s)
            plane.throttle = 0.0
        else:
            self._cruise(bank, height_m, dt_s)
        if plane.altitude_amsl_m <= ground_amsl_m:
            self._touch_down(ground_amsl_m)

    @property
    def _sinks(self) -> bool:
        """Beyond the place where the mission lands."""
        lands = self._host.mode == Mode.AUTO and self.mission.lands
        return lands and self.navigation.along >= 1.0

    def _cruise_m_s(self) -> float:
        """True airspeed for the one that is wanted."""
        return true_airspeed_m_s(self._demand_m_s, self._host.estimate.altitude_amsl_m)

    def _cruise(self, bank: float, height_m: float, dt_s: float) -> None:
        plane = self._plane
        wanted = true_airspeed_m_s(self._demand_m_s, height_m)
        self._speed_m_s = max(wanted, self._speed_m_s - SLOWING_M_S2 * dt_s)
        climb = self.heights.climb_m_s(self.navigation.target_amsl_m, height_m, dt_s)
        if self._settling:
            excess = plane.airspeed_m_s - wanted - 1.0
            if excess > 0.0:
                climb = max(climb, EXCESS_CLIMB * excess)
            else:
                self._settling = False
        plane.advance(bank, climb, self._speed_m_s, dt_s)

    # --- on the ground ----------------------------------------------------------------------------

    def _on_ground(self, dt_s: float, ground_amsl_m: float) -> None:
        host, plane = self._host, self._plane
        plane.altitude_amsl_m = ground_amsl_m
        taking_off = host.mode == Mode.TAKEOFF or (
            host.mode == Mode.AUTO and self.mission.takes_off
        )
        if host.armed and taking_off and host.ekf.position_ok:
            if self.takeoff.suppressed:
                self._start = self._host.estimate.place
            if self.takeoff.run(plane, self._cruise_m_s(), dt_s):
                host.landed = False
                self._speed_m_s = plane.airspeed_m_s
            return
        if not self.takeoff.suppressed:
            self.takeoff.abandon()
        if plane.velocity_north_m_s == 0.0 and plane.velocity_east_m_s == 0.0:
            plane.throttle = 0.0
            self._wait_to_disarm()
            return
        plane.roll_on_ground(BRAKING_M_S2, dt_s)
        plane.throttle = 0.0
        self._still_us = host.now_us

    def _wait_to_disarm(self) -> None:
        """Some time after a landing."""
        host = self._host
        if not host.armed or not self._sinks:
            return
        delay_us = host.parameters["LAND_DISARMDELAY"] * 1e6
        if delay_us > 0.0 and host.now_us - self._still_us >= delay_us:
            host.disarm()

    def _touch_down(self, ground_amsl_m: float) -> None:
        """Wheels or nose on the ground."""
        self._plane.touch_down(ground_amsl_m)
        self._host.landed = True
        self.takeoff.abandon()
        self._still_us = self._host.now_us

    @property
    def indicated_m_s(self) -> float:
        """What the pitot tube measures: less than the true airspeed, as it is calibrated."""
        altitude_m = self._host.estimate.altitude_amsl_m
        return indicated_airspeed_m_s(self._plane.airspeed_m_s, altitude_m)

    def waypoint(self) -> Waypoint | None:
        """Where it goes: POSITION_TARGET_GLOBAL_INT and NAV_CONTROLLER_OUTPUT."""
        return self.navigation.waypoint(self._demand_m_s - self.indicated_m_s)

    def landed_state(self) -> Landed:
        """What EXTENDED_SYS_STATE says."""
        if not self.flying:
            return Landed.ON_GROUND
        if self.takeoff.stage in (Stage.RUNNING, Stage.CLIMBING):
            return Landed.TAKEOFF
        landing = self._host.mode == Mode.AUTO and self.mission.lands
        return Landed.LANDING if landing else Landed.IN_AIR
