"""PX4 1.17 flying a multicopter: OFFBOARD without look-ahead, and AUTO modes (px4.md 3 to 8)."""

import math
from typing import Final, final

from vehicle_sim.autopilots import TargetEcho, Waypoint
from vehicle_sim.autopilots.px4 import mission
from vehicle_sim.autopilots.px4.autopilot import RATES_HZ, Px4, profile
from vehicle_sim.autopilots.px4.commands import HANDLERS
from vehicle_sim.autopilots.px4.modes import MANUAL_MODES, NAVIGATED, Mode
from vehicle_sim.autopilots.px4.position_control import (
    Gains,
    PositionControl,
    Trajectory,
    Wanted,
)
from vehicle_sim.autopilots.px4.setpoints import NOTHING, Target, Vector, flyable
from vehicle_sim.dynamics.copter import Copter

_QUADROTOR: Final = 2
_NAN: Final = math.nan
_STILL: Final = (0.0, 0.0, 0.0)
_RAMP_FROM_M_S: Final = 2.47
"""Downward speed limit that the take-off ramp begins with: z of POSITION_TARGET in the log."""
_DETECTED_S: Final = 0.85
"""Spool-up to "takeoff detected": 1.8 to 2.0 s after arming in the logs, COM_SPOOLUP_TIME 1 s."""
_HEAVY_M_S2: Final = 1.5
"""What the integral pushes down with when the ramp begins."""
_LIES_US: Final = 1_100_000
"""Contact to idling: 54.6 to 55.75 s of px4-offboard-short.tlog."""
_ARRIVED_M: Final = 0.5
_RESPONSE_S: Final = 0.1
"""Of the attitude: 12 m/s and then "position here" overshoots by 10 m (px4.md 4)."""
_TAKEN_OFF_US: Final = 2_200_000
"""At its height, until a take-off is over: 7.8 s after arming at the default height (px4.md 3)."""
_IDLE: Final = TargetEcho(
    position_ned_m=NOTHING,
    velocity_ned_m_s=NOTHING,
    acceleration_ned_m_s2=(0.0, 0.0, 100.0),
    yaw_rad=0.0,
    type_mask=63,
)
"""POSITION_TARGET_LOCAL_NED while the motors idle, as recorded."""


@final
class Px4Multicopter(Px4):
    """A quadcopter of PX4's SIH simulator: 1 kg, drag SIH_KDV."""

    vehicle: Copter
    HANDLERS = HANDLERS
    TABLES = ("px4/common", "px4/multicopter")
    profile = profile(vehicle_type=_QUADROTOR, rates_hz=RATES_HZ)

    def _set_up(self) -> None:
        self._control = PositionControl(Gains(self.parameters))
        self._path = Trajectory()
        self._version = -1
        self._goal: Vector = NOTHING
        """Of the AUTO modes, in the local frame; NaN: still braking."""
        self._began_m: Vector = _STILL
        """Where the mode began."""
        self._ramp_us: int | None = None
        """When the take-off ramp began; None: on the ground or done with it."""
        self._flying = False
        """The position controller runs."""
        self._yaw_rad = self.vehicle.heading_rad
        self._asked = (NOTHING, NOTHING, NOTHING)
        """Position, velocity and acceleration that the controller was asked for."""
        self._leg: mission.Leg | None = None
        self._returning = 0
        """RTL: 0 climbs, 1 flies home, 2 descends and lands."""
        self._aim_yaw_rad = _NAN
        self._turn_rad_s = 0.0
        self._judged: Target | None = None
        self._flies = False
        self._up_us: int | None = None

    # --- modes --------------------------------------------------------------------------------

    def _begin(self, mode: Mode, before: Mode) -> None:
        """Start the smooth motion of the AUTO modes from what the vehicle does."""
        self._refresh()
        self._path.limit(self.parameters, manual=mode in MANUAL_MODES)
        north, east, up = self._velocity
        continues = before is mode and self._flying
        if not continues:
            self._path.start(self.local_m, (north, east, -up))
        self._goal = NOTHING
        self._began_m = self._stopping_point() if mode is Mode.LOITER else self.local_m
        self._leg = None
        self._returning = 0
        self._aim_yaw_rad = _NAN
        self._yaw_rad = self.vehicle.heading_rad
        if mode is Mode.TAKEOFF:
            self._aim_takeoff()
        elif mode is Mode.LOITER:
            self._goal = self._began_m
            if self.reposition is not None:
                *place, self._aim_yaw_rad = self.reposition
                self._goal = self._given(*place)
        elif mode is Mode.LAND and self.land_place is not None:
            north_m, east_m = self.projection.to_local(*self.land_place)
            self._goal = (north_m, east_m, _NAN)
        elif mode is Mode.RTL:
            self._aim_return()

    def _stopping_point(self) -> Vector:
        """Where braking will end: the navigator holds there (preproject_stop_point)."""
        (north_m, east_m, down_m), (v_n, v_e, _) = self.local_m, self._velocity
        braking = max(self.parameters["MPC_ACC_HOR"], 0.5)
        jerk = max(self.parameters["MPC_JERK_AUTO"], 0.5)
        seconds = math.hypot(v_n, v_e) / (2.0 * braking) + braking / jerk
        return north_m + v_n * seconds, east_m + v_e * seconds, down_m

    @property
    def _velocity(self) -> Vector:
        e = self.estimate
        return e.velocity_north_m_s, e.velocity_east_m_s, e.velocity_up_m_s

    def _down(self, altitude_amsl_m: float) -> float:
        """Height in the local frame."""
        return self._reference.altitude_amsl_m - altitude_amsl_m

    def _aim_takeoff(self) -> None:
        """Straight up to the commanded altitude, or MIS_TAKEOFF_ALT above home."""
        place, altitude_m = self.takeoff_place, self._takeoff_altitude_m()
        if place is not None and math.isfinite(place[2]):  # never down
            altitude_m = max(altitude_m, self.estimate.altitude_amsl_m)
        north_m, east_m, _ = self.local_m
        self._goal = (north_m, east_m, self._down(altitude_m))

    def _given(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Vector:
        """A place in the local frame; what is not given of it is where it is."""
        north_m, east_m, down_m = self.local_m
        if math.isfinite(latitude_deg) and math.isfinite(longitude_deg):
            north_m, east_m = self.projection.to_local(latitude_deg, longitude_deg)
        return north_m, east_m, self._down(altitude_m) if math.isfinite(altitude_m) else down_m

    def _aim_return(self) -> None:
        """First straight up: to RTL_RETURN_ALT, less within the cone about home."""
        home = self.home or self._reference
        home_n, home_e = self.projection.to_local(home.latitude_deg, home.longitude_deg)
        north_m, east_m, down_m = self.local_m
        away_m = math.hypot(north_m - home_n, east_m - home_e)
        parameters = self.parameters
        height_m = parameters["RTL_RETURN_ALT"]
        if away_m < parameters["RTL_MIN_DIST"]:
            height_m = min(height_m, parameters["RTL_DESCEND_ALT"])
        elif parameters["RTL_CONE_ANG"] > 0.0:
            cone_rad = math.radians(min(parameters["RTL_CONE_ANG"], 89.0))
            height_m = min(height_m, max(away_m / math.tan(cone_rad), 10.0))
        self._goal = (north_m, east_m, min(down_m, self._down(home.altitude_amsl_m + height_m)))

    # --- one step -----------------------------------------------------------------------------

    def _refresh(self) -> None:
        """A parameter has changed."""
        parameters = self.parameters
        if parameters.version == self._version:
            return
        self._version = parameters.version
        self._control.gains = Gains(parameters)
        self._path.limit(parameters, manual=self.mode in MANUAL_MODES)
        self.vehicle.drag_1_m = 0.0
        self.vehicle.response_s = _RESPONSE_S
        self.vehicle.drag_1_s = parameters["SIH_KDV"] / max(parameters["SIH_MASS"], 0.1)
        self.vehicle.hover_throttle = parameters["MPC_THR_HOVER"]

    def _fly(self, dt_s: float) -> None:
        copter = self.vehicle
        if self.parameters.version != self._version:
            self._refresh()
        if not self.armed:
            self._flying, self._ramp_us = False, None
            if copter.altitude_amsl_m > self.ground_amsl_m + 0.01 and not self.landed:
                copter.fall(dt_s)
                if copter.altitude_amsl_m <= self.ground_amsl_m:
                    self.landed = True
                    copter.stand(self.ground_amsl_m)
            else:
                self.landed = True
                copter.stand(self.ground_amsl_m)
            return
        wanted = self._asked = self._wanted(dt_s)
        if not self._flying and not self._start(wanted):
            copter.stand(self.ground_amsl_m)
            self._contact(pressed=True)
            return
        most_up_m_s = self._control.gains.vertical_up_m_s
        if self._ramp_us is not None:
            most_up_m_s = self._most_up_m_s(self._ramp_us)
        e = self.estimate
        state = (
            self.local_m,
            (e.velocity_north_m_s, e.velocity_east_m_s, -e.velocity_up_m_s),
            (copter.acceleration_north_m_s2, copter.acceleration_east_m_s2, 0.0),
        )
        a_n, a_e, a_d = self._control.run(wanted, state, most_up_m_s, dt_s)
        self._turn(dt_s)
        if copter.altitude_amsl_m <= self.ground_amsl_m and a_d >= 0.0:
            self._stand()
            return
        copter.advance(a_n, a_e, -a_d, dt_s)
        if copter.altitude_amsl_m < self.ground_amsl_m:
            self._stand()
        elif self._ramp_us is None:
            self._contact_us = None

    def _stand(self) -> None:
        """On the ground, with the motors turning."""
        self.vehicle.stand(self.ground_amsl_m)
        pressed = self._ramp_us is None
        if pressed:
            self._control.level()
        self._contact(pressed=pressed)
        if self.landed and pressed:
            self._flying = False

    def _start(self, wanted: Wanted) -> bool:
        """Whether the take-off ramp begins: motors spun up and a climb demanded."""
        if self.now_us - self._armed_us < self.parameters["COM_SPOOLUP_TIME"] * 1e6:
            return False
        position, velocity, acceleration = wanted
        up = position[2] < self.local_m[2] - 0.1 or velocity[2] < -0.1 or acceleration[2] < -0.1
        if not up or (self.mode not in (Mode.TAKEOFF, Mode.OFFBOARD, Mode.MISSION)):
            return False
        self._ramp_us = self.now_us
        self._flying = True
        self._control.reset(_HEAVY_M_S2)
        north, east, up_m_s = self._velocity
        self._path.start(self.local_m, (north, east, -up_m_s))
        return True

    def _most_up_m_s(self, ramp_us: int) -> float:
        """MPC_Z_VEL_MAX_UP, in the take-off ramp that began then less, negative at first."""
        most = self._control.gains.vertical_up_m_s
        since_s = (self.now_us - ramp_us) * 1e-6
        if since_s >= _DETECTED_S:
            self._took_off()
        ramp_s = max(self.parameters["MPC_TKO_RAMP_T"], 0.1)
        if since_s >= ramp_s:
            self._ramp_us = None
            return most
        return -_RAMP_FROM_M_S + (most + _RAMP_FROM_M_S) * since_s / ramp_s

    def _wanted(self, dt_s: float) -> Wanted:
        """What the mode asks of the position controller."""
        mode = self.mode
        if mode is Mode.OFFBOARD:
            return self._offboard()
        if mode is Mode.DESCEND:
            return self._sink()
        if mode in MANUAL_MODES:
            if not self.pilot_present:
                return self._sink()
            self._path.towards_speed(0.0, 0.0, 0.0, dt_s)
            return self._path.wanted()
        self._automatic(dt_s)
        return self._path.wanted()

    def _offboard(self) -> Wanted:
        """The setpoint goes straight to the controller; what it cannot fly makes it stop."""
        target = self.target
        if target is not self._judged:
            self._judged = target
            self._flies = target is not None and flyable(target)
        if target is None or not self._flies:
            return NOTHING, _STILL, NOTHING
        return target.position_m, target.velocity_m_s, target.acceleration_m_s2

    # --- AUTO modes ---------------------------------------------------------------------------

    def _automatic(self, dt_s: float) -> None:
        """Move the point that the controller follows."""
        mode, path = self.mode, self._path
        if self._ramp_us is not None and self._most_up_m_s(self._ramp_us) <= 0.0:
            path.start(self.local_m, _STILL)
            return
        if mode is Mode.LAND:
            self._descend(dt_s)
        elif mode is Mode.RTL:
            self._return(dt_s)
        elif mode is Mode.MISSION:
            self._follow_mission(dt_s)
        else:
            self._go(dt_s)
            if mode is Mode.TAKEOFF and self._is_up():
                self.finish_takeoff()

    def _speeds(self) -> tuple[float, float, float]:
        parameters = self.parameters
        cruise_m_s = self.speed_m_s or parameters["MPC_XY_CRUISE"]
        return (
            min(cruise_m_s, parameters["MPC_XY_VEL_MAX"]),
            parameters["MPC_TKO_SPEED" if self.mode is Mode.TAKEOFF else "MPC_Z_V_AUTO_UP"],
            parameters["MPC_Z_V_AUTO_DN"],
        )

    def _go(self, dt_s: float) -> None:
        """To the goal; without one, brake, and stay where that ends."""
        path = self._path
        if self._goal[0] != self._goal[0] and path.stands and abs(path.v[2]) < 0.05:
            self._goal = self._began_m
        path.to_goal(self._goal, self._speeds(), dt_s)

    def _descend(self, dt_s: float) -> None:
        """Down to the ground, slower the nearer it is."""
        path = self._path
        if self._goal[0] != self._goal[0] and path.stands:
            self._goal = (path.p[0], path.p[1], _NAN)
        path.to_goal(self._goal, self._speeds(), dt_s, self._land_speed_m_s())

    def _land_speed_m_s(self) -> float:
        """MPC_LAND_ALT1 to 3: from MPC_Z_V_AUTO_DN to MPC_LAND_SPEED to MPC_LAND_CRWL."""
        parameters = self.parameters
        height_m = self._height_m
        slow = parameters["MPC_LAND_SPEED"]
        if height_m < parameters["MPC_LAND_ALT3"]:
            return min(slow, parameters["MPC_LAND_CRWL"])
        upper_m, lower_m = parameters["MPC_LAND_ALT1"], parameters["MPC_LAND_ALT2"]
        share = min(max((height_m - lower_m) / max(upper_m - lower_m, 0.1), 0.0), 1.0)
        return slow + (parameters["MPC_Z_V_AUTO_DN"] - slow) * share

    def _return(self, dt_s: float) -> None:
        """RTL: up, home, down to RTL_DESCEND_ALT, land."""
        home = self.home or self._reference
        if self._returning == 0 and abs(self._goal[2] - self.local_m[2]) < _ARRIVED_M:
            north_m, east_m = self.projection.to_local(home.latitude_deg, home.longitude_deg)
            self._goal = (north_m, east_m, self._goal[2])
            self._returning = 1
        elif self._returning == 1 and self._is_over_goal():
            self._goal = (self._goal[0], self._goal[1], _NAN)
            self._returning = 2
        if self._returning == 2:
            self._descend(dt_s)
        else:
            self._go(dt_s)

    def _is_over_goal(self) -> bool:
        north_m, east_m = self._goal[0] - self.local_m[0], self._goal[1] - self.local_m[1]
        return math.hypot(north_m, east_m) < _ARRIVED_M

    def _is_up(self) -> bool:
        """The take-off has reached its height and has stood there for a moment."""
        near = (
            not self.landed
            and self._goal[2] - self.local_m[2] > -self.parameters["NAV_MC_ALT_RAD"]
            and abs(self._path.v[2]) < 0.3
        )
        if not near or self._up_us is None:
            self._up_us = self.now_us if near else None
        return self._up_us is not None and self.now_us - self._up_us >= _TAKEN_OFF_US

    def _follow_mission(self, dt_s: float) -> None:
        leg = self.mission.leg
        if leg is not self._leg:
            self._leg = leg
            self._aim_leg(leg)
        if leg is None:
            self._go(dt_s)
        elif leg.command == mission.LAND and self._is_over_goal():
            self._goal = (self._goal[0], self._goal[1], _NAN)
            self.mission.arrived()
            self._descend(dt_s)
        elif leg.command == mission.LAND and self._goal[2] != self._goal[2]:
            self._descend(dt_s)
        else:
            self._go(dt_s)
            if self._has_arrived(leg):
                self.mission.arrived()

    def _aim_leg(self, leg: mission.Leg | None) -> None:
        self._goal = NOTHING
        if leg is None:
            return
        north_m, east_m = self.projection.to_local(leg.latitude_deg, leg.longitude_deg)
        down_m = self._down(leg.altitude_amsl_m)
        if leg.command == mission.LAND:
            down_m = self._path.p[2]
        elif leg.command == mission.TAKEOFF and self.landed:
            north_m, east_m, _ = self.local_m
        self._goal = (north_m, east_m, down_m)
        self._aim_yaw_rad = leg.yaw_rad

    def _has_arrived(self, leg: mission.Leg) -> bool:
        radius_m = leg.acceptance_m if leg.acceptance_m == leg.acceptance_m else _NAN
        if radius_m != radius_m:
            radius_m = self.parameters["NAV_ACC_RAD"]
        north_m, east_m = self._goal[0] - self.local_m[0], self._goal[1] - self.local_m[1]
        near = math.hypot(north_m, east_m) < radius_m
        return near and abs(self._goal[2] - self.local_m[2]) < self.parameters["NAV_MC_ALT_RAD"]

    # --- by hand ------------------------------------------------------------------------------

    def _sink(self) -> Wanted:
        """Without a pilot the flight tasks of these modes cannot run: level, and down."""
        return NOTHING, (_NAN, _NAN, self.parameters["MPC_LAND_SPEED"]), NOTHING

    def _turn(self, dt_s: float) -> None:
        """Turn the nose: to the setpoint's yaw, or along the way."""
        copter, mode, parameters = self.vehicle, self.mode, self.parameters
        by_client = mode is Mode.OFFBOARD
        most_deg_s = parameters["MC_YAWRATE_MAX" if by_client else "MPC_YAWRAUTO_MAX"]
        if by_client:
            target = self.target
            if target is not None:
                if target.yaw_rad == target.yaw_rad:
                    self._yaw_rad = target.yaw_rad
                elif target.yaw_rate_rad_s == target.yaw_rate_rad_s:
                    self._yaw_rad = copter.heading_rad + target.yaw_rate_rad_s / 2.8
        elif mode in NAVIGATED and mode is not Mode.LAND:
            north_m, east_m = self._aim[0] - self.local_m[0], self._aim[1] - self.local_m[1]
            if self._aim_yaw_rad == self._aim_yaw_rad:
                self._yaw_rad = self._aim_yaw_rad
            elif math.hypot(north_m, east_m) > 2.0:
                self._yaw_rad = math.atan2(east_m, north_m)
        off_rad = math.remainder(self._yaw_rad - copter.heading_rad, math.tau)
        most_rad_s = math.radians(most_deg_s)
        rate = min(max(parameters["MC_YAW_P"] * off_rad, -most_rad_s), most_rad_s)
        self._turn_rad_s = rate
        copter.heading_rad = math.remainder(copter.heading_rad + rate * dt_s, math.tau)

    # --- to tell ------------------------------------------------------------------------------

    def target_echo(self) -> TargetEcho | None:
        """What the controller steers for: its own velocity and acceleration, not those sent."""
        contact_us = self._contact_us
        lies = contact_us is not None and self.now_us - contact_us > _LIES_US
        if lies or not self._flying or (self.landed and self._ramp_us is None):
            return _IDLE._replace(yaw_rad=self.vehicle.heading_rad)
        position, velocity = self._asked[0], self._control.velocity
        mask = 0
        for bit, value in enumerate((*position, *velocity)):
            if value != value:
                mask |= 1 << bit
        return TargetEcho(
            position_ned_m=position,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=self._control.acceleration,
            yaw_rad=self._yaw_rad,
            yaw_rate_rad_s=0.0 if self.mode is Mode.OFFBOARD else self._turn_rad_s,
            type_mask=mask,
        )

    def _waypoint(self) -> Waypoint | None:
        goal_n, goal_e, goal_d = self._aim
        return Waypoint(
            place=self.projection.place(goal_n, goal_e, self._reference.altitude_amsl_m - goal_d),
            distance_m=math.hypot(goal_n - self.local_m[0], goal_e - self.local_m[1]),
        )

    @property
    def _aim(self) -> Vector:
        """The navigator's place: the goal, or where the mode began."""
        n, e, d = (_NAN,) * 3 if self.mode is Mode.LAND else self._goal
        m_n, m_e, m_d = self._began_m
        return n if n == n else m_n, e if e == e else m_e, d if d == d else m_d
