"""ArduCopter's AUTO mode: runs the mission's items."""

import math
from typing import TYPE_CHECKING, final

from vehicle_sim.autopilots import Place
from vehicle_sim.autopilots.ardupilot.copter_mission import (
    CONDITION_YAW,
    DO_CHANGE_SPEED,
    Goal,
    Leg,
    Mission,
    goal_of,
    name_of,
)
from vehicle_sim.autopilots.ardupilot.flat_earth import Vector, bearing_rad, distance_m, offset
from vehicle_sim.plans import PlanItem, PlanKind

if TYPE_CHECKING:
    from vehicle_sim.autopilots.ardupilot.copter_flight import Flight


@final
class Auto:
    """The mission as it is being flown."""

    def __init__(self, flight: "Flight") -> None:
        self._flight = flight
        self._mission = Mission(())
        self.goal: Goal | None = None
        self.complete = False
        self.paused = False
        self._arrived_us: int | None = None
        self._angle_rad = 0.0
        self._swept_rad = 0.0

    def can_begin(self) -> bool:
        """Whether there is a mission; on the ground, one that begins with a take-off."""
        return len(self._flight.host.plans[PlanKind.MISSION]) > 1

    def begin(self) -> None:
        """From the first item, or after the last one that was flown (MIS_RESTART 0)."""
        host = self._flight.host
        self._mission = Mission(host.plans[PlanKind.MISSION])
        self.complete = self.paused = False
        current = host.mission_current
        if host.parameters["MIS_RESTART"] or current < 1 or current >= len(self._mission.items):
            current = 1
        self.jump_to(current)

    def jump_to(self, number: int) -> None:
        """Fly this item next."""
        host = self._flight.host
        self._mission = Mission(host.plans[PlanKind.MISSION])
        self._advance(number - 1)

    def _advance(self, after: int) -> None:
        host, flight = self._flight.host, self._flight
        number, done = self._mission.following(after)
        for index, item in done:
            self._do(index, item)
        self._arrived_us = None
        if number == 0:
            self.goal, self.complete = None, True
            flight.guided.stop()
            return
        item = self._mission.items[number]
        host.mission_current = number
        host.say(6, f"Mission: {number} {name_of(item.command)}")
        home = host.home or host.estimate.place
        goal = self.goal = goal_of(number, item, host.estimate.place, home)
        if goal.leg is Leg.TAKEOFF:
            flight.takeoff_us = host.now_us
        elif goal.leg is Leg.RETURN:
            flight.begin_return(climb=True)
        elif goal.leg is Leg.CIRCLE:
            self._angle_rad = bearing_rad(goal.place, host.estimate.place)
            self._swept_rad = 0.0
        flight.control.start_vertical()

    def _do(self, number: int, item: PlanItem) -> None:
        """Things that take no time."""
        flight, p = self._flight, item.parameters
        flight.host.say(6, f"Mission: {number} {name_of(item.command)}")
        if item.command == DO_CHANGE_SPEED and 0.0 < p[1] < math.inf:
            flight.control.speed_m_s = p[1]
        elif item.command == CONDITION_YAW and math.isfinite(p[0]):
            heading_rad = flight.copter.heading_rad
            flight.yaw.fix(heading_rad, math.radians(p[0]), p[2], relative=p[3] == 1.0)

    def _reached(self) -> None:
        goal = self.goal
        assert goal is not None
        host = self._flight.host
        host.say(6, f"Reached command #{goal.number}")
        host.reached(goal.number)
        self._advance(goal.number)

    @property
    def landing(self) -> bool:
        """Whether the item is a landing, or an RTL that lands."""
        goal = self.goal
        if goal is None:
            return False
        going = self._flight.return_place is not None
        return (goal.leg is Leg.LAND and self._arrived_us is not None) or (
            goal.leg is Leg.RETURN and not going
        )

    @property
    def taking_off(self) -> bool:
        """Whether the item is a take-off."""
        return self.goal is not None and self.goal.leg is Leg.TAKEOFF

    def on_ground(self) -> None:
        """Armed and standing: a take-off may begin."""
        flight, goal = self._flight, self.goal
        if goal is not None and goal.leg is Leg.TAKEOFF and flight.takeoff_us is None:
            flight.takeoff_us = flight.host.now_us

    # --- flying -------------------------------------------------------------------------------

    def run(self, dt_s: float) -> Vector:
        """Fly the item for one step."""
        flight, goal = self._flight, self.goal
        if not flight.host.ekf.aiding or goal is None or self.paused:
            return flight.stop_level(0.0, dt_s)
        match goal.leg:
            case Leg.TAKEOFF:
                wanted = flight.go(goal.place, dt_s)
                here_m = flight.host.estimate.altitude_amsl_m
                if here_m > goal.place.altitude_amsl_m - 0.3 and self._waited(0.7):
                    flight.abandon_takeoff()
                    self._reached()
                return wanted
            case Leg.RETURN:
                return flight.run_return(dt_s)
            case Leg.LAND:
                return self._land(goal, dt_s)
            case Leg.CIRCLE:
                return self._circle(goal, dt_s)
            case Leg.WAIT:
                if self._waited(goal.hold_s):
                    self._reached()
                return flight.go(goal.place, dt_s)
            case Leg.GO:
                return self._go(goal, dt_s)

    def _waited(self, seconds: float) -> bool:
        now_us = self._flight.host.now_us
        if self._arrived_us is None:
            self._arrived_us = now_us
        return now_us - self._arrived_us >= seconds * 1e6

    def _go(self, goal: Goal, dt_s: float) -> Vector:
        flight = self._flight
        here = flight.host.estimate.place
        radius_m = flight.host.parameters["WPNAV_RADIUS"] / 100.0
        level_m = distance_m(here, goal.place)
        away_m = math.hypot(level_m, here.altitude_amsl_m - goal.place.altitude_amsl_m)
        wanted = flight.go(goal.place, dt_s)
        if (away_m < radius_m or self._arrived_us is not None) and self._waited(goal.hold_s):
            self._reached()
        return wanted

    def _land(self, goal: Goal, dt_s: float) -> Vector:
        flight = self._flight
        if self._arrived_us is None:
            if distance_m(flight.host.estimate.place, goal.place) < 1.0:
                self._arrived_us = flight.host.now_us
                flight.lands_with_position = True
            return flight.go(goal.place, dt_s)
        return flight.run_landing(dt_s)

    def _circle(self, goal: Goal, dt_s: float) -> Vector:
        flight = self._flight
        speed = min(flight.control.speed_m_s, math.sqrt(2.5 * goal.radius_m))
        edge = offset(
            goal.place,
            goal.radius_m * math.cos(self._angle_rad),
            goal.radius_m * math.sin(self._angle_rad),
        )
        if self._arrived_us is None:
            if distance_m(flight.host.estimate.place, edge) > 2.0:
                above = Place(
                    latitude_deg=edge.latitude_deg,
                    longitude_deg=edge.longitude_deg,
                    altitude_amsl_m=goal.place.altitude_amsl_m,
                )
                return flight.go(above, dt_s)
            self._arrived_us = flight.host.now_us
        rate = speed / goal.radius_m
        self._angle_rad += rate * dt_s
        self._swept_rad += rate * dt_s
        if self._swept_rad >= goal.turns * math.tau:
            self._reached()
        up_m = goal.place.altitude_amsl_m - flight.host.estimate.altitude_amsl_m
        climb_m_s = min(max(up_m, -1.5), 2.5)
        return flight.circle(goal.place, goal.radius_m, self._angle_rad, rate, climb_m_s, dt_s)
