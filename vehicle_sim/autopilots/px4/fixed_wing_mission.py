"""How a fixed wing of PX4 flies the legs of a mission (mission.py says which)."""

import math
from typing import TYPE_CHECKING, final

from vehicle_sim.autopilots.px4 import mission
from vehicle_sim.autopilots.px4.modes import Mode
from vehicle_sim.autopilots.px4.runway import CLEARED, CLIMB_OUT_M_S

if TYPE_CHECKING:
    from vehicle_sim.autopilots.px4.fixed_wing import Px4FixedWing


@final
class MissionFlight:
    """The leg that is flown.  Mutable."""

    def __init__(self, px4: "Px4FixedWing") -> None:
        self._px4 = px4
        self._aimed = False
        self._leg: mission.Leg | None = None
        self._arrived_us: int | None = None
        """When it came to the circle of a loiter with turns."""

    def forget(self) -> None:
        """Another mode, or the same one anew."""
        self._aimed, self._leg = False, None

    def follow(self) -> None:
        """Fly on along the leg; tell the mission when it is done."""
        px4, leg = self._px4, self.aim()
        if leg is None:
            return
        if leg.command == mission.TAKEOFF:
            if px4.estimate.altitude_amsl_m >= leg.altitude_amsl_m:
                px4.say(CLEARED)
                px4.mission.arrived()
        elif leg.command == mission.LAND:
            px4.land()
        elif self._has_arrived(leg):
            px4.mission.arrived()

    def aim(self) -> mission.Leg | None:
        """The leg of now, with the course set to it."""
        leg = self._px4.mission.leg
        if leg is not self._leg or not self._aimed:
            before, self._leg, self._aimed = self._leg, leg, True
            self._arrived_us = None
            self._set_course(leg, before)
        return leg

    def _set_course(self, leg: mission.Leg | None, before: mission.Leg | None) -> None:
        """Along the line from the last waypoint, or about the leg's place."""
        px4 = self._px4
        course = px4.course
        course.airspeed_m_s = px4.cruise_m_s(Mode.MISSION)
        if leg is None:
            px4.start_hold(Mode.MISSION)
            return
        north_m, east_m = px4.projection.to_local(leg.latitude_deg, leg.longitude_deg)
        here_n, here_e, _ = px4.local_m
        if leg.command == mission.TAKEOFF:
            way_rad = px4.vehicle.heading_rad
            if math.hypot(north_m - here_n, east_m - here_e) > 1.0:
                way_rad = math.atan2(east_m - here_e, north_m - here_n)
            course.straight(px4.local_m, way_rad)
            course.climb_out(CLIMB_OUT_M_S)
        elif leg.command == mission.LAND:
            px4.start_landing(north_m, east_m)
        elif leg.command == mission.WAYPOINT and leg.hold_s == 0.0:
            if before is not None and before.command == mission.WAYPOINT:
                here_n, here_e = px4.projection.to_local(before.latitude_deg, before.longitude_deg)
            course.fly_leg(here_n, here_e, north_m, east_m, px4.loiter_radius_m)
            course.hold_altitude(leg.altitude_amsl_m)
        else:
            radius_m = leg.radius_m if abs(leg.radius_m) > 1.0 else px4.loiter_radius_m
            course.loiter(north_m, east_m, radius_m)
            course.hold_altitude(leg.altitude_amsl_m)

    def _has_arrived(self, leg: mission.Leg) -> bool:
        """Near enough in distance and height; of a loiter with turns after these."""
        px4 = self._px4
        course, estimate = px4.course, px4.estimate
        off_m = abs(estimate.altitude_amsl_m - leg.altitude_amsl_m)
        if not off_m < px4.parameters["NAV_FW_ALT_RAD"]:
            return False
        if not course.circling:
            near_m = course.switch_m(estimate)
            if leg.acceptance_m > near_m:
                near_m = leg.acceptance_m
            return course.distance_m(px4.local_m) < near_m
        if self._arrived_us is None:
            if not course.on_circle(px4.local_m):
                return False
            self._arrived_us = px4.now_us
        speed_m_s = math.hypot(estimate.velocity_north_m_s, estimate.velocity_east_m_s)
        round_s = math.tau * abs(course.radius_m) / max(speed_m_s, 1.0)
        return (px4.now_us - self._arrived_us) * 1e-6 >= leg.turns * round_s
