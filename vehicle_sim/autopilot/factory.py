"""Which personality a world asks for, and the vehicle that it flies."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

from vehicle_sim.autopilot import arducopter, arduplane, px4copter, px4plane
from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.dynamics.battery import Model
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.dynamics.plane import Plane, PlaneLimits
from vehicle_sim.errors import InputError
from vehicle_sim.parameters import Readable
from vehicle_sim.sensors import gps
from vehicle_sim.sensors.gps import Receiver
from vehicle_sim.world import Vehicle

_COPTER = Limits(
    speed_m_s=40.0,
    acceleration_m_s2=30.0,
    speed_vertical_m_s=10.0,
    acceleration_vertical_m_s2=5.0,
)
"""A simulated quadcopter that has no other limits than its tilt and its drag."""
_COPTER_DRAG_1_S, _COPTER_DRAG_1_M = 0.340, 0.0193
"""10.05 m/s at 28.7 degrees of tilt and 15.4 m/s at 45, as in the recorded flights."""
_STEEPEST_CDEG = 8000.0


@final
@dataclass(frozen=True, slots=True)
class AutopilotVariant:
    """An autopilot with a kind of vehicle, and what its own simulation flies it with."""

    autopilot: Callable[..., Autopilot]
    """Of vehicle, parameters, plans and rng=: one that boots.  InputError names a parameter that it
    does not have."""
    system_id: str
    """The parameter that holds it."""
    component_id: str | None
    """The same; None: it is always 1."""
    highest_id: int
    """Of both; the least is 1.  Of PX4 as Mavlink::set_system_id has it."""
    receiver: Receiver
    battery: Model


PERSONALITIES: Final = {
    ("ardupilot", "copter"): AutopilotVariant(
        arducopter.make, "MAV_SYSID", None, 255, gps.ARDUCOPTER, "ardupilot copter"
    ),
    ("ardupilot", "plane"): AutopilotVariant(
        arduplane.make, "MAV_SYSID", None, 255, gps.ARDUPLANE, "ardupilot plane"
    ),
    ("px4", "copter"): AutopilotVariant(
        px4copter.make, "MAV_SYS_ID", "MAV_COMP_ID", 254, gps.PX4, "px4"
    ),
    ("px4", "plane"): AutopilotVariant(
        px4plane.make, "MAV_SYS_ID", "MAV_COMP_ID", 254, gps.PX4, "px4"
    ),
}


def personality_of(vehicle: Vehicle) -> AutopilotVariant:
    """The one that a world asks for."""
    return PERSONALITIES[vehicle.autopilot, vehicle.kind]


def ids_of(personality: AutopilotVariant, parameters: Readable) -> tuple[int, int]:
    """System and component that an autopilot boots as; what is out of range counts as 1."""
    names = (personality.system_id, personality.component_id)
    ids = [1 if name is None else int(parameters[name]) for name in names]
    system, component = (each if 1 <= each <= personality.highest_id else 1 for each in ids)
    return system, component


def with_own_ids(vehicle: Vehicle) -> Vehicle:
    """The same vehicle, whose system_id is what its parameter says, if that is given.

    InputError for a system or component id that there cannot be, or that another part has.
    """
    personality, parameters = personality_of(vehicle), vehicle.parameters
    most = personality.highest_id
    for name in (personality.system_id, personality.component_id):
        value = parameters.get(name or "", 1.0)
        if not (1 <= value <= most and value == int(value)):
            rule = f"must be a whole number from 1 to {most}"
            raise InputError(f"parameter {name}", value, rule, "Try 2.")
    given = parameters.get(personality.system_id)
    if given is None and vehicle.system_id > most:
        rule = f"must be from 1 to {most} with {vehicle.autopilot}"
        raise InputError("vehicle.system_id", vehicle.system_id, rule, "Give a smaller one.")
    if given is None:
        return vehicle
    rest = {name: value for name, value in parameters.items() if name != personality.system_id}
    return dataclasses.replace(vehicle, system_id=int(given), parameters=rest)


def make_vehicle(
    vehicle: Vehicle, latitude_deg: float, longitude_deg: float, ground_amsl_m: float
) -> Copter | Plane:
    """The airframe, standing on the ground here."""
    if vehicle.kind == "plane":
        return Plane(
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_amsl_m=ground_amsl_m,
            heading_rad=math.radians(vehicle.heading_deg),
            limits=_plane_limits(vehicle),
        )
    return Copter(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_amsl_m=ground_amsl_m,
        limits=_copter_limits(vehicle),
        drag_1_s=_drag_1_s(vehicle),
        drag_1_m=_COPTER_DRAG_1_M if _only_drag_limits(vehicle) else 0.0,
        heading_rad=math.radians(vehicle.heading_deg),
    )


def _copter_limits(vehicle: Vehicle) -> Limits:
    return Limits(
        speed_m_s=vehicle.speed_max_m_s or _COPTER.speed_m_s,
        acceleration_m_s2=vehicle.acceleration_max_m_s2 or _COPTER.acceleration_m_s2,
        speed_vertical_m_s=vehicle.speed_vertical_max_m_s or _COPTER.speed_vertical_m_s,
        acceleration_vertical_m_s2=vehicle.acceleration_vertical_max_m_s2
        or _COPTER.acceleration_vertical_m_s2,
    )


def _drag_1_s(vehicle: Vehicle) -> float:
    """A vehicle whose speed is given is limited by that; any other by its drag."""
    if vehicle.drag_1_s is not None:
        return vehicle.drag_1_s
    return _COPTER_DRAG_1_S if _only_drag_limits(vehicle) else 0.0


def _only_drag_limits(vehicle: Vehicle) -> bool:
    """An ArduPilot as its own simulation has it; PX4 brings its drag as a parameter (SIH_KDV)."""
    given = vehicle.speed_max_m_s is not None or vehicle.drag_1_s is not None
    return vehicle.autopilot == "ardupilot" and not given


def _plane_limits(vehicle: Vehicle) -> PlaneLimits:
    usual = PlaneLimits() if vehicle.autopilot == "ardupilot" else SIH_AIRPLANE
    bank_deg = vehicle.bank_max_deg
    limits = dataclasses.replace(
        usual,
        airspeed_min_m_s=vehicle.airspeed_min_m_s or usual.airspeed_min_m_s,
        airspeed_max_m_s=vehicle.airspeed_max_m_s or usual.airspeed_max_m_s,
        bank_max_rad=usual.bank_max_rad if bank_deg is None else math.radians(bank_deg),
        climb_max_m_s=vehicle.climb_max_m_s or usual.climb_max_m_s,
        sink_max_m_s=vehicle.sink_max_m_s or usual.sink_max_m_s,
    )
    if limits.airspeed_min_m_s >= limits.airspeed_max_m_s:
        value, most = limits.airspeed_min_m_s, limits.airspeed_max_m_s
        rule = f"must be less than airspeed_max_m_s, which is {most:g}"
        raise InputError("vehicle.airspeed_min_m_s", value, rule, "Give both.")
    return limits


def overrides_of(vehicle: Vehicle) -> dict[str, float]:
    """The parameters of the world file, and those that follow from the limits that it gives.

    An ArduCopter's climb, descent and tilt follow the vehicle's limits and not its own defaults: a
    vehicle for 3 km of height would otherwise climb for twenty minutes.  PX4 has the drag of its
    simulated quadcopter as a parameter.
    """
    overrides: dict[str, float] = {personality_of(vehicle).system_id: vehicle.system_id}
    if vehicle.kind == "copter" and vehicle.autopilot == "ardupilot":
        vertical_m_s = vehicle.speed_vertical_max_m_s
        if vertical_m_s is not None:
            overrides |= dict.fromkeys(("WPNAV_SPEED_UP", "WPNAV_SPEED_DN"), vertical_m_s * 100.0)
        if vehicle.acceleration_max_m_s2 is not None:
            overrides["ANGLE_MAX"] = _STEEPEST_CDEG
        if vehicle.acceleration_vertical_max_m_s2 is not None:
            overrides["WPNAV_ACCEL_Z"] = vehicle.acceleration_vertical_max_m_s2 * 100.0
    if vehicle.kind == "copter" and vehicle.autopilot == "px4":
        given = vehicle.drag_1_s is not None or vehicle.speed_max_m_s is not None
        if given:
            overrides["SIH_KDV"] = _drag_1_s(vehicle)
    return overrides | vehicle.parameters
