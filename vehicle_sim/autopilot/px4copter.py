"""PX4 1.17 flying a multicopter: OFFBOARD without look-ahead, and AUTO modes (px4.md 3 to 8)."""

import math
from typing import Final, final

from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.legs import RETURN, Does, Leg, back
from vehicle_sim.autopilot.px4 import RATES_HZ, Px4, firmware
from vehicle_sim.autopilot.px4_control import HOVER_THROTTLE, Control, Point, State
from vehicle_sim.autopilot.setpoints import LOCAL_NED, NOTHING, Target, is_flyable
from vehicle_sim.autopilot.values import Place, Setpoint, Waypoint
from vehicle_sim.dynamics.copter import Copter

FIRMWARE: Final = firmware("px4copter", vehicle_type=2, rates_hz=RATES_HZ)

_STOPS: Final = State(velocity=0j, sink=0.0)
_SPOOLS_UP_S, _RAMP_S = 1.0, 3.0
"""COM_SPOOLUP_TIME, MPC_TKO_RAMP_T."""
_NEAR_HOME_M: Final = 10.0  # RTL_MIN_DIST
_TURN_1_S, _SLEW_RAD_S = 2.8, (math.radians(60.0), math.radians(200.0))
"""MC_YAW_P; MPC_YAWRAUTO_MAX, and in OFFBOARD MC_YAWRATE_MAX."""
_RAMP_FROM_M_S: Final = 2.47
"""Downward speed limit that the take-off ramp begins with: z of POSITION_TARGET in the log."""
_DETECTED_S: Final = 0.85
"""Spool-up to "takeoff detected": 1.8 to 2.0 s after arming in the logs, COM_SPOOLUP_TIME 1 s."""
_HEAVY_M_S2: Final = 1.5  # what the integral pushes down with when the ramp begins
_LIES_S: Final = 1.1  # contact to idling: 54.6 to 55.75 s of px4-offboard-short.tlog
_ARRIVED_M: Final = 0.5
_WANTS_UP: Final = 0.1  # metres, m/s or m/s2 of a demand that count as one to climb
_SLOWS_AT_M, _SLOW_AT_M, _CRAWLS_AT_M, _CRAWL_M_S = 10.0, 5.0, 1.0, 0.3
"""MPC_LAND_ALT1, _ALT2, _ALT3 and MPC_LAND_CRWL."""
_NEAR_M: Final = 2.0  # of its goal: nearer, the nose does not turn to it
_RESPONSE_S: Final = 0.1
"""Of the attitude: 12 m/s and then "position here" overshoots by 10 m (px4.md 4)."""
_IDLE: Final = Setpoint(False, LOCAL_NED, 63, NOTHING, NOTHING, (0.0, 0.0, 100.0), 0.0)
"""POSITION_TARGET_LOCAL_NED while the motors idle, as recorded."""


@final
class Px4Copter(Px4):
    """A quadcopter of PX4's SIH simulator: 1 kg, drag SIH_KDV."""

    taken_off_s = 3.0  # 7.8 s after arming at the default height (px4.md 3)

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        assert isinstance(boot.vehicle, Copter)
        self.copter = boot.vehicle
        self._control, self._point = Control(), Point()
        self._goal, self._goal_down = 0j, 0.0  # where the leg ends, in the local frame
        self._leg: Leg | None = None
        self._ramp_s: float | None = None
        """When the take-off ramp began; None: on the ground or done with it."""
        self._flying = False  # the position controller runs
        self._wanted = State()
        self._order = (0j, 0.0)
        self._yaw_rad, self._turn_rad_s = self.copter.heading_rad, 0.0
        self._judged: Target | None = None
        self._offboard = _STOPS

    def read_parameters(self) -> None:
        """They are read live."""
        p, copter = self.parameters, self.copter
        self._control.read(p)
        self._point.read(p)
        copter.drag_1_m, copter.response_s, copter.drag_1_s = 0.0, _RESPONSE_S, p["SIH_KDV"]
        copter.hover_throttle = HOVER_THROTTLE

    @property
    def _flown(self) -> State:
        """Where it believes to be, and what it does."""
        e, copter = self.estimate, self.copter
        north_m, east_m, down_m = self.local_m
        place = complex(north_m, east_m)
        return State(place, down_m, e.velocity_m_s, -e.velocity_up_m_s, copter.acceleration_m_s2)

    @property
    def _position(self) -> complex:
        return complex(*self.local_m[:2])

    def _local(self, place: Place) -> tuple[complex, float]:
        """A place in the local frame, and its height: down."""
        north_m, east_m, down_m = self.frame.ned_m(place)
        return complex(north_m, east_m), down_m

    # --- AUTO modes: legs ---------------------------------------------------------------------

    def restart(self) -> None:
        """From what the vehicle does."""
        self._point.start(self._flown)
        self._yaw_rad = self.copter.heading_rad
        self.fly_leg()

    def fly_leg(self) -> None:
        """Another one, or none any more: then it stops."""
        leg = self._leg = self.route.leg
        self._goal, self._goal_down = self._local(self.stops_at() if leg is None else leg.place)
        if leg is not None and leg.does is Does.CLIMB:
            self._goal = self._position
        elif leg is not None and leg.does is Does.LAND:
            self._goal_down = self._point.at.down

    def stops_at(self) -> Place:
        """Where it comes to a stop, as the navigator reckons it."""
        flown = self._flown
        place = flown.place + self._point.stopping_m(flown.velocity)
        return self.frame.place(place.real, place.imag, flown.down)

    def way_home(self) -> list[Leg]:
        """Up, home, and down: to RTL_RETURN_ALT, or less in a cone of 45 degrees about home."""
        p, place, home = self.parameters, self.estimate.place, self.base
        away_m, up_m = abs(self._position - self._local(home)[0]), p["RTL_RETURN_ALT"]
        least_m = p["RTL_DESCEND_ALT"] if away_m < _NEAR_HOME_M else max(away_m, 10.0)
        height_m = home.altitude_amsl_m + min(up_m, least_m)
        return back(place, home, max(height_m, place.altitude_amsl_m), 0.0)

    def on_disarmed(self) -> None:
        """The motors stand."""
        self._flying, self._ramp_s = False, None
        super().on_disarmed()

    # --- on the ground ------------------------------------------------------------------------

    def lifts_off(self) -> bool:
        """Whether the thrust carries it, once the take-off ramp has begun."""
        return self._flying and self._order[1] < 0.0

    def wants_up(self) -> bool:
        """In the take-off ramp."""
        return self._ramp_s is not None

    def touch_down(self) -> None:
        """It comes to rest, and forgets what held against the air."""
        self.copter.stand(self.ground_m)
        if self._ramp_s is None:
            self._control.integral = 0j

    stand = touch_down  # even if the motors turn

    def _starts(self) -> bool:
        """Whether the take-off ramp begins: motors spun up and a climb demanded."""
        wanted = self._wanted
        if self.now_s - self.armed_s < _SPOOLS_UP_S:
            return False
        climbs = wanted.down < self.local_m[2] - _WANTS_UP or wanted.sink < -_WANTS_UP
        climbs = climbs or wanted.push_down < -_WANTS_UP
        if not climbs or self.mode.name not in ("Takeoff", "Offboard", "Mission"):
            return False
        self._ramp_s = self.now_s
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
        if since_s >= _RAMP_S:
            self._ramp_s = None
            return most
        return (most + _RAMP_FROM_M_S) * since_s / _RAMP_S - _RAMP_FROM_M_S

    # --- one step -----------------------------------------------------------------------------

    def steer(self) -> None:
        """The mode says what it wants, the position controller what that takes."""
        self._wanted = getattr(self, self.mode.flies)()
        self._flying = self._ramp_s is not None or not self.landed or self._starts()
        if self._flying:
            most_up_m_s = self._most_up_m_s()
            self._order = self._control.run(self._wanted, self._flown, most_up_m_s, self.step_s)
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
                velocity, push = complex(v_n, v_e), complex(a_n, a_e)
                self._offboard = State(complex(n, e), d, velocity, v_d, push, a_d)
        return self._offboard

    def descend(self) -> State:
        """Without a position, or by hand but without a pilot: level, and down."""
        return State(sink=self.parameters["MPC_LAND_SPEED"])

    sink = descend

    def fly_legs(self) -> State:
        """AUTO modes: the point that is followed moves to where the leg ends."""
        p, point, sink_m_s = self.parameters, self._point, None
        if self.route.leg is not self._leg:
            self.fly_leg()
        if self._ramp_s is not None and self._most_up_m_s() <= 0.0:  # it waits for the vehicle
            point.start(self._flown._replace(velocity=0j, sink=0.0))
            return point.at
        if self.route.lands:
            slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
            share = (self.height_m - _SLOW_AT_M) / (_SLOWS_AT_M - _SLOW_AT_M)
            sink_m_s = slow + (fast - slow) * min(max(share, 0.0), 1.0)
            if self.height_m < _CRAWLS_AT_M:
                sink_m_s = min(slow, _CRAWL_M_S)
        cruise_m_s = min(self.speed_m_s or p["MPC_XY_CRUISE"], p["MPC_XY_VEL_MAX"])
        climbs = p["MPC_TKO_SPEED" if self.mode.name == "Takeoff" else "MPC_Z_V_AUTO_UP"]
        speeds = (cruise_m_s, climbs, p["MPC_Z_V_AUTO_DN"])
        wanted = point.towards(self._goal, self._goal_down, speeds, self.step_s, sink_m_s)
        self.follow_route()
        return wanted

    def is_there(self, leg: Leg) -> bool:
        """Near enough: over home and the place of a landing nearer than on the way."""
        p, near_m = self.parameters, leg.acceptance_m
        if leg.does is Does.LAND or leg.command == RETURN:
            near_m = _ARRIVED_M
        elif near_m != near_m:
            near_m = p["NAV_ACC_RAD"]
        off_m = abs(self._goal_down - self.local_m[2])
        return abs(self._goal - self._position) < near_m and off_m < p["NAV_MC_ALT_RAD"]

    def _turn(self) -> None:
        """Turn the nose: to the setpoint's yaw, or along the way."""
        copter, name, target, leg = self.copter, self.mode.name, self.target, self.route.leg
        if name == "Offboard":
            if target is not None and target.yaw_rad == target.yaw_rad:
                self._yaw_rad = target.yaw_rad
            elif target is not None and target.yaw_rate_rad_s == target.yaw_rate_rad_s:
                self._yaw_rad = copter.heading_rad + target.yaw_rate_rad_s / _TURN_1_S
        elif leg is not None and leg.does is not Does.LAND:
            way = self._goal - self._position
            if leg.yaw_rad == leg.yaw_rad:
                self._yaw_rad = leg.yaw_rad
            elif abs(way) > _NEAR_M:
                self._yaw_rad = math.atan2(way.imag, way.real)
        most, off_rad = _SLEW_RAD_S[name == "Offboard"], self._yaw_rad - copter.heading_rad
        self._turn_rad_s = min(max(_TURN_1_S * math.remainder(off_rad, math.tau), -most), most)
        turned_rad = copter.heading_rad + self._turn_rad_s * self.step_s
        copter.heading_rad = math.remainder(turned_rad, math.tau)

    # --- to tell ------------------------------------------------------------------------------

    def target_echo(self) -> Setpoint:
        """What the controller steers for: its own velocity and acceleration, not those sent."""
        control, wanted = self._control, self._wanted
        lies = self.touched_s is not None and self.now_s - self.touched_s > _LIES_S
        if lies or not self._flying:
            return _IDLE._replace(yaw_rad=self.copter.heading_rad)
        position = (wanted.place.real, wanted.place.imag, wanted.down)
        velocity = (control.velocity.real, control.velocity.imag, control.sink)
        return Setpoint(
            is_global=False,
            frame=LOCAL_NED,
            type_mask=sum(1 << bit for bit, v in enumerate((*position, *velocity)) if v != v),
            position=position,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=(control.asked.real, control.asked.imag, control.asked_down),
            yaw_rad=self._yaw_rad,
            yaw_rate_rad_s=0.0 if self.mode.name == "Offboard" else self._turn_rad_s,
        )

    def waypoint(self) -> Waypoint | None:
        """Where the leg ends."""
        leg = self.route.leg
        return leg and Waypoint(place=leg.place, distance_m=abs(self._goal - self._position))
