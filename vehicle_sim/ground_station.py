"""What a timeline has a person at a ground station do: orders to companion or autopilot, a fence.

The station is system 255, and on a link of its own: what it is answered is not heard by anybody.
"""

import math
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.faults import Happening
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.plans import CIRCLE_OUT, PlanItem

STATION: Final = Sender(system=255, component=190)


def order(happening: Happening, vehicle: Vehicle, system: int, component: int) -> Any:
    """The command that a line names, or DO_REPOSITION to so far from the vehicle, at its height."""
    to = (system, component)
    if happening.command:
        given = (happening.command, 0, happening.p1, happening.p2, happening.p3, 0.0, 0.0, 0.0, 0.0)
        return mavlink.MAVLink_command_long_message(*to, *given)
    place = (*_beside(vehicle, *happening.by_m[:2]), vehicle.altitude_amsl_m)
    what = (mavlink.MAV_FRAME_GLOBAL_INT, mavlink.MAV_CMD_DO_REPOSITION, 0, 0)
    return mavlink.MAVLink_command_int_message(*to, *what, -1.0, 0.0, 0.0, math.nan, *place)


def new_fence(happening: Happening, vehicle: Vehicle) -> PlanItem:
    """A circle to stay out of, so far ahead of the vehicle (true course) or about it."""
    north, east, _ = vehicle.velocity_neu_m_s
    share = happening.ahead_m / max(math.hypot(north, east), 1e-6)
    x, y = _beside(vehicle, share * north, share * east)
    circle = (happening.radius_m, 0.0, 0.0, 0.0)
    return PlanItem(frame=0, command=CIRCLE_OUT, parameters=circle, x=x, y=y)


def _beside(vehicle: Vehicle, north_m: float, east_m: float) -> tuple[int, int]:
    """Latitude and longitude, 1e-7 degrees."""
    frame = LocalFrame(latitude_deg=vehicle.latitude_deg, longitude_deg=vehicle.longitude_deg)
    latitude_deg, longitude_deg = frame.to_geographic(north_m, east_m)
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7)
