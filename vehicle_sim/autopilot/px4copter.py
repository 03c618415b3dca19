"""PX4 1.17 flying a multicopter: OFFBOARD without look-ahead, and AUTO modes (px4.md 3 to 8)."""

import math
from typing import Final, final

from vehicle_sim.autopilot.copter_control import bounded
from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.legs import Does
from vehicle_sim.autopilot.px4 import MANUAL, MODES, NAVIGATED, RATES_HZ, Px4, firmware
from vehicle_sim.autopilot.px4_control import NONE, Control, Point, State, given
from vehicle_sim.autopilot.setpoints import NOTHING, Target, is_flyable
from vehicle_sim.autopilot.values import Place, TargetEcho, Waypoint
from vehicle_sim.dynamics.copter import Copter

FIRMWARE: Final = firmware("px4copter", vehicle_type=2, rates_hz=RATES_HZ)

_NAN: Final = math.nan
_STOPS: Final = State(velocity=0j, sink=0.0)
_RAMP_FROM_M_S: Final = 2.47
"""Downward speed limit that the take-off ramp begins with: z of POSITION_TARGET in the log."""
_DETECTED_S: Final = 0.85
"""Spool-up to "takeoff detected": 1.8 to 2.0 s after arming in the logs, COM_SPOOLUP_TIME 1 s."""
_HEAVY_M_S2: Final = 1.5
"""What the integral pushes down with when the ramp begins."""
_LIES_S: Final = 1.1
"""Contact to idling: 54.6 to 55.75 s of px4-offboard-short.tlog."""
_ARRIVED_M: Final = 0.5
_WANTS_UP: Final = 0.1
"""Metres, m/s or m/s2 of a demand that count as one to climb."""
_NEAR_M: Final = 2.0
"""Of its goal: nearer, the nose does not turn to it."""
_RESPONSE_S: Final = 0.1
"""Of the attitude: 12 m/s and then "position here" overshoots by 10 m (px4.md 4)."""
_TAKEN_OFF_S: Final = 2.2
"""At its height, until a take-off is over: 7.8 s after arming at the default height (px4.md 3)."""
_SLOW_M_S: Final = 0.3
_STANDS_M_S: Final = 0.05
_IDLE: Final = TargetEcho(
    position_ned_m=NOTHING,
    velocity_ned_m_s=NOTHING,
    acceleration_ned_m_s2=(0.0, 0.0, 100.0),
    yaw_rad=0.0,
    type_mask=63,
)
"""POSITION_TARGET_LOCAL_NED while the motors idle, as recorded."""


@final
class Px4Copter(Px4):
    """A quadcopter of PX4's SIH simulator: 1 kg, drag SIH_KDV."""

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        assert isinstance(boot.vehicle, Copter)
        self.copter = boot.vehicle
        self._control, self._point = Control(self.parameters), Point()
        self._ways = {mode.name: getattr(self, mode.flies) for mode in MODES}
        self._goal, self._goal_down = NONE, _NAN
        """Of the AUTO modes, in the local frame; NaN: still braking."""
        self._began_in, self._began, self._began_down = "", 0j, 0.0
        """Where the mode began, or where its braking ends."""
        self._ramp_s: float | None = None
        """When the take-off ramp began; None: on the ground or done with it."""
        self._flying = False
        """The position controller runs."""
        self._wanted = State()
        self._order = (0j, 0.0)
        self._stage = 0
        """Of a return: 0 climbs, 1 flies home, 2 descends and lands."""
        self._up_s: float | None = None
        """When a take-off has come to its height."""
        self._yaw_rad, self._aim_yaw_rad = self.copter.heading_rad, _NAN
        self._turn_rad_s = 0.0
        self._judged: Target | None = None
        self._offboard = _STOPS

    def read_parameters(self) -> None:
        """They are read live."""
        p, copter = self.parameters, self.copter
        self._control.read(p)
        self._point.limit(p, manual=self.mode.name in MANUAL)
        copter.drag_1_m, copter.response_s = 0.0, _RESPONSE_S
        copter.drag_1_s = p["SIH_KDV"] / max(p["SIH_MASS"], 0.1)
        copter.hover_throttle = p["MPC_THR_HOVER"]

    @property
    def _flown(self) -> State:
        """Where it believes to be, and what it does."""
        e, copter = self.estimate, self.copter
        velocity = complex(e.velocity_north_m_s, e.velocity_east_m_s)
        push = complex(copter.acceleration_north_m_s2, copter.acceleration_east_m_s2)
        return State(self._here, self.local_m[2], velocity, -e.velocity_up_m_s, push)

    @property
    def _here(self) -> complex:
        return complex(*self.local_m[:2])

    def _level(self, place: Place) -> complex:
        """A place in the local frame."""
        return complex(*self.frame.ned_m(place)[:2])

    def _down(self, altitude_amsl_m: float) -> float:
        """A height in the local frame."""
        return self.reference.altitude_amsl_m - altitude_amsl_m

    # --- modes --------------------------------------------------------------------------------

    def begin(self) -> None:
        """Start the smooth motion of the AUTO modes from what the vehicle does."""
        p, name, flown = self.parameters, self.mode.name, self._flown
        self.read_parameters()
        if name != self._began_in or not self._flying:
            self._point.start(flown)
        self._began_in = name
        self._goal, self._goal_down, self._stage = NONE, _NAN, 0
        self._began, self._began_down = flown.place, flown.down
        self._yaw_rad, self._aim_yaw_rad = self.copter.heading_rad, _NAN
        if name == "Takeoff":
            self._goal, self._goal_down = flown.place, self._down(self.takeoff_altitude_m)
        elif name == "Hold":
            # where braking will end: the navigator holds there (preproject_stop_point)
            braking, jerk = max(p["MPC_ACC_HOR"], 0.5), max(p["MPC_JERK_AUTO"], 0.5)
            seconds = abs(flown.velocity) / (2.0 * braking) + braking / jerk
            self._began = self._goal = flown.place + flown.velocity * seconds
            self._goal_down = flown.down
            if self.asked is not None:
                altitude_m, self._aim_yaw_rad = self.asked[2:]
                self._goal = self._asked_place if given(self._asked_place) else flown.place
                self._goal_down = flown.down if altitude_m != altitude_m else self._down(altitude_m)
        elif name == "Land" and self.asked is not None:
            self._goal = self._asked_place
        elif name == "Return":
            height_m = self.base.altitude_amsl_m + self._return_height_m()
            self._goal, self._goal_down = flown.place, min(flown.down, self._down(height_m))
        elif name == "Mission":
            self.fly_leg()

    @property
    def _asked_place(self) -> complex:
        """NaN: none was asked for."""
        assert self.asked is not None
        return self._level(Place(*self.asked[:2], 0.0))

    def _return_height_m(self) -> float:
        """Above home: RTL_RETURN_ALT, less within the cone about it."""
        p, away_m = self.parameters, abs(self._here - self._level(self.base))
        height_m = p["RTL_RETURN_ALT"]
        if away_m < p["RTL_MIN_DIST"]:
            return min(height_m, p["RTL_DESCEND_ALT"])
        if p["RTL_CONE_ANG"] > 0.0:
            cone_rad = math.radians(min(p["RTL_CONE_ANG"], 89.0))
            return min(height_m, max(away_m / math.tan(cone_rad), 10.0))
        return height_m

    def fly_leg(self) -> None:
        """Another leg of the mission, or none any more."""
        leg = self.route.leg
        self._goal, self._goal_down = NONE, _NAN
        if leg is None:
            return
        self._goal, self._goal_down = self._level(leg.place), self._down(leg.place.altitude_amsl_m)
        if leg.does is Does.LAND:
            self._goal_down = self._point.at.down
        elif leg.does is Does.CLIMB and self.landed:
            self._goal = self._here
        self._aim_yaw_rad = leg.yaw_rad

    def on_disarmed(self) -> None:
        """The motors stand."""
        self._flying, self._ramp_s = False, None
        super().on_disarmed()

    # --- on the ground ------------------------------------------------------------------------

    def lifts_off(self) -> bool:
        """Whether the thrust carries it, once the take-off ramp has begun."""
        return self._flying and self._order[1] < 0.0

    def lies(self) -> bool:
        """Whether nothing wants up."""
        return self._ramp_s is None

    def stand(self) -> None:
        """It stands, even if the motors turn."""
        self.touch_down()

    def touch_down(self) -> None:
        """It comes to rest."""
        self.copter.stand(self.ground_m)
        if self._ramp_s is None:
            self._control.forget_wind()
            self._flying = self._flying and not self.landed

    def _starts(self) -> bool:
        """Whether the take-off ramp begins: motors spun up and a climb demanded."""
        wanted = self._wanted
        if self.now_s - self.armed_s < self.parameters["COM_SPOOLUP_TIME"]:
            return False
        climbs = wanted.down < self.local_m[2] - _WANTS_UP or wanted.sink < -_WANTS_UP
        climbs = climbs or wanted.push_down < -_WANTS_UP
        if not climbs or self.mode.name not in ("Takeoff", "Offboard", "Mission"):
            return False
        self._ramp_s, self._flying = self.now_s, True
        self._control.reset(_HEAVY_M_S2)
        self._point.start(self._flown)
        return True

    def _most_up_m_s(self) -> float:
        """MPC_Z_VEL_MAX_UP, in the take-off ramp less, negative at first."""
        most = self._control.fastest_up_m_s
        if self._ramp_s is None:
            return most
        since_s = self.now_s - self._ramp_s
        if since_s >= _DETECTED_S:
            self.take_to_the_air()
        ramp_s = max(self.parameters["MPC_TKO_RAMP_T"], 0.1)
        if since_s >= ramp_s:
            self._ramp_s = None
            return most
        return (most + _RAMP_FROM_M_S) * since_s / ramp_s - _RAMP_FROM_M_S

    # --- one step -----------------------------------------------------------------------------

    def steer(self) -> None:
        """The mode says what it wants, the position controller what that takes."""
        self._wanted = self._ways[self.mode.name]()
        if not self.armed or not (self._flying or self._starts()):
            return
        self._order = self._control.run(self._wanted, self._flown, self._most_up_m_s(), self.step_s)
        self._turn()

    def move(self) -> None:
        """Thrust."""
        level, down = self._order
        self.copter.advance(level.real, level.imag, -down, self.step_s)

    def fly_target(self) -> State:
        """OFFBOARD: the setpoint goes straight to the controller; what it cannot fly stops it."""
        target = self.target
        if target is None:
            return _STOPS
        if target is not self._judged:
            self._judged, self._offboard = target, _STOPS
            if is_flyable(target):
                (n, e, d), (v_n, v_e, v_d), (a_n, a_e, a_d) = target[:3]
                self._offboard = State(
                    complex(n, e), d, complex(v_n, v_e), v_d, complex(a_n, a_e), a_d
                )
        return self._offboard

    def descend(self) -> State:
        """Without a position or a pilot: level, and down."""
        return State(sink=self.parameters["MPC_LAND_SPEED"])

    def sink(self) -> State:
        """By hand: a pilot's sticks are centred; without one it comes down."""
        if not self.pilot_present:
            return self.descend()
        self._point.towards_velocity(0j, 0.0, self.step_s)
        return self._point.at

    # --- AUTO modes: they move the point that the controller follows --------------------------

    def _waits(self) -> bool:
        """At the beginning of the take-off ramp the point stays where the vehicle is."""
        if self._ramp_s is None or self._most_up_m_s() > 0.0:
            return False
        self._point.start(self._flown._replace(velocity=0j, sink=0.0))
        return True

    @property
    def _cruise_m_s(self) -> float:
        p = self.parameters
        return min(self.speed_m_s or p["MPC_XY_CRUISE"], p["MPC_XY_VEL_MAX"])

    def hold(self) -> State:
        """To the goal; without one, brake, and stay where that ends."""
        p, point = self.parameters, self._point
        if self._waits():
            return point.at
        if not given(self._goal) and point.stands and abs(point.at.sink) < _STANDS_M_S:
            self._goal, self._goal_down = self._began, self._began_down
        climbs = p["MPC_TKO_SPEED" if self.mode.name == "Takeoff" else "MPC_Z_V_AUTO_UP"]
        speeds = (self._cruise_m_s, climbs, p["MPC_Z_V_AUTO_DN"])
        point.towards_place(self._goal, self._goal_down, speeds, self.step_s)
        return point.at

    def climb(self) -> State:
        """Takeoff; then Hold (COM_TAKEOFF_ACT 0), once it has stood at its height for a moment."""
        at = self.hold()
        is_up = self.local_m[2] - self._goal_down < self.parameters["NAV_MC_ALT_RAD"]
        if self.landed or not is_up or abs(at.sink) >= _SLOW_M_S:
            self._up_s = None
        elif self._up_s is None:
            self._up_s = self.now_s
        elif self.now_s - self._up_s >= _TAKEN_OFF_S:
            self.asked = None  # it holds where it is
            self.intend("Hold")
        return at

    def land(self) -> State:
        """Down to the ground, slower the nearer it is."""
        p, point = self.parameters, self._point
        if self._waits():
            return point.at
        if not given(self._goal) and point.stands:
            self._goal = point.at.place
        height_m, slow = self.height_m, p["MPC_LAND_SPEED"]
        upper_m, lower_m = p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"]
        share = bounded((height_m - lower_m) / max(upper_m - lower_m, 0.1), 0.0, 1.0)
        sink_m_s = slow + (p["MPC_Z_V_AUTO_DN"] - slow) * share
        if height_m < p["MPC_LAND_ALT3"]:
            sink_m_s = min(slow, p["MPC_LAND_CRWL"])
        point.towards_place(self._goal, _NAN, (self._cruise_m_s, 0.0, 0.0), self.step_s, sink_m_s)
        return point.at

    def fly_back(self) -> State:
        """Return: up, home, and land from there."""
        if self._stage == 0 and abs(self._goal_down - self.local_m[2]) < _ARRIVED_M:
            self._stage, self._goal = 1, self._level(self.base)
        elif self._stage == 1 and abs(self._goal - self._here) < _ARRIVED_M:
            self._stage = 2
        return self.land() if self._stage == 2 else self.hold()

    def fly_mission(self) -> State:
        """Leg by leg."""
        leg, p = self.route.leg, self.parameters
        if leg is None:
            return self.hold()
        away_m = abs(self._goal - self._here)
        if leg.does is Does.LAND:
            if away_m < _ARRIVED_M and self.route.arrived_s is None:
                self.arrived(leg)
            return self.hold() if self.route.arrived_s is None else self.land()
        at = self.hold()
        near_m = leg.acceptance_m if leg.acceptance_m == leg.acceptance_m else p["NAV_ACC_RAD"]
        off_m = abs(self._goal_down - self.local_m[2])
        if away_m < near_m and off_m < p["NAV_MC_ALT_RAD"]:
            self.arrived(leg)
        return at

    def _turn(self) -> None:
        """Turn the nose: to the setpoint's yaw, or along the way."""
        p, copter, name, target = self.parameters, self.copter, self.mode.name, self.target
        fastest_deg_s, gain_1_s = p["MPC_YAWRAUTO_MAX"], p["MC_YAW_P"]
        if name == "Offboard":
            fastest_deg_s = p["MC_YAWRATE_MAX"]
            if target is not None and target.yaw_rad == target.yaw_rad:
                self._yaw_rad = target.yaw_rad
            elif target is not None and target.yaw_rate_rad_s == target.yaw_rate_rad_s:
                self._yaw_rad = copter.heading_rad + target.yaw_rate_rad_s / gain_1_s
        elif name in NAVIGATED and name != "Land":
            way = self._aim[0] - self._here
            if self._aim_yaw_rad == self._aim_yaw_rad:
                self._yaw_rad = self._aim_yaw_rad
            elif abs(way) > _NEAR_M:
                self._yaw_rad = math.atan2(way.imag, way.real)
        most = math.radians(fastest_deg_s)
        off_rad = math.remainder(self._yaw_rad - copter.heading_rad, math.tau)
        self._turn_rad_s = bounded(gain_1_s * off_rad, -most, most)
        copter.heading_rad = math.remainder(
            copter.heading_rad + self._turn_rad_s * self.step_s, math.tau
        )

    # --- to tell ------------------------------------------------------------------------------

    def target_echo(self) -> TargetEcho:
        """What the controller steers for: its own velocity and acceleration, not those sent."""
        control, wanted = self._control, self._wanted
        lies = self.touched_s is not None and self.now_s - self.touched_s > _LIES_S
        if lies or not self._flying or (self.landed and self._ramp_s is None):
            return _IDLE._replace(yaw_rad=self.copter.heading_rad)
        position = (wanted.place.real, wanted.place.imag, wanted.down)
        velocity = (control.velocity.real, control.velocity.imag, control.sink)
        mask = sum(1 << bit for bit, v in enumerate((*position, *velocity)) if v != v)
        return TargetEcho(
            position_ned_m=position,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=(control.asked.real, control.asked.imag, control.asked_down),
            yaw_rad=self._yaw_rad,
            yaw_rate_rad_s=0.0 if self.mode.name == "Offboard" else self._turn_rad_s,
            type_mask=mask,
        )

    @property
    def _aim(self) -> tuple[complex, float]:
        """The navigator's place: the goal, or where the mode began."""
        lands = self.mode.name == "Land"
        goal = self._began if lands or not given(self._goal) else self._goal
        down = self._goal_down
        return goal, self._began_down if lands or down != down else down

    def waypoint(self) -> Waypoint:
        """In AUTO modes."""
        goal, down = self._aim
        place = self.frame.place(goal.real, goal.imag, down)
        return Waypoint(place=place, distance_m=abs(goal - self._here))
