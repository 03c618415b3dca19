"""Which autopilot a world asks for, and the vehicle that it flies.

Another one is a row of PERSONALITIES: a `Firmware` value, and a class of its own only if its law is
new (simulator.md).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, final

from vehicle_sim.autopilot import arducopter, arduplane, ideal, px4copter, px4plane
from vehicle_sim.autopilot.core import Autopilot, Boot, Firmware
from vehicle_sim.dynamics.battery import Model
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.dynamics.plane import Plane, PlaneLimits
from vehicle_sim.errors import InputError
from vehicle_sim.parameters import Parameters, Readable
from vehicle_sim.sensors import gps
from vehicle_sim.sensors.gps import Receiver
from vehicle_sim.world import LIMITS
from vehicle_sim.world import Vehicle as VehicleTable

_COPTER: Final = Limits(
    speed_m_s=40.0, acceleration_m_s2=30.0, speed_vertical_m_s=10.0, acceleration_vertical_m_s2=5.0
)
"""A simulated quadcopter that has no other limits than its tilt and its drag."""
_ARDUCOPTER_DRAG: Final = (0.340, 0.0193)
"""10.05 m/s at 28.7 degrees of tilt and 15.4 m/s at 45, as in the recorded flights."""
_STEEPEST_CDEG: Final = 8000.0
HIGHEST_ID: Final = 254
"""Of system and component; the least is 1.  255 is a ground station's."""


@final
@dataclass(frozen=True, slots=True)
class Personality:
    """An autopilot with a kind of vehicle, and what its own simulation flies it with."""

    make: Callable[[Boot], Autopilot]
    firmware: Firmware
    receiver: Receiver
    battery: Model
    limits: Limits | PlaneLimits
    drag: tuple[float, float] = (0.0, 0.0)
    """Of a copter: 1/s, and 1/m for the square of the speed.  PX4's is a parameter (SIH_KDV)."""


_ARDUCOPTER: Final = Personality(
    *(arducopter.ArduCopter, arducopter.FIRMWARE, gps.ARDUCOPTER, "ardupilot copter", _COPTER),
    _ARDUCOPTER_DRAG,
)
PERSONALITIES: Final = {
    ("ardupilot", "copter"): _ARDUCOPTER,
    ("ideal", "copter"): replace(_ARDUCOPTER, make=ideal.Ideal, drag=(0.0, 0.0)),
    ("ardupilot", "plane"): Personality(
        *(arduplane.ArduPlane, arduplane.FIRMWARE, gps.ARDUPLANE, "ardupilot plane", PlaneLimits())
    ),
    ("px4", "copter"): Personality(
        *(px4copter.Px4Copter, px4copter.FIRMWARE, gps.PX4, "px4", _COPTER)
    ),
    ("px4", "plane"): Personality(
        *(px4plane.Px4Plane, px4plane.FIRMWARE, gps.PX4, "px4", px4plane.SIH_AIRPLANE)
    ),
}
"""By vehicle.autopilot and vehicle.kind of the world file."""


def personality_of(vehicle: VehicleTable) -> Personality:
    """The one that a world asks for; InputError if there is none."""
    personality = PERSONALITIES.get((vehicle.autopilot, vehicle.kind))
    if personality is None:
        known = " or ".join(f"'{name}'" for name, kind in PERSONALITIES if kind == vehicle.kind)
        rule = f"must be {known} with a {vehicle.kind}"
        raise InputError("vehicle.autopilot", vehicle.autopilot, rule, "Correct the world file.")
    return personality


def ids_of(personality: Personality, parameters: Readable) -> tuple[int, int]:
    """System and component that an autopilot boots as."""
    system, component, *_ = (*(int(parameters[name]) for name in personality.firmware.ids), 1)
    return system, component


def with_own_id(vehicle: VehicleTable) -> VehicleTable:
    """The same vehicle, whose system_id is what its parameter says, if that is given.

    InputError for a parameter that its autopilot does not have, or not with this value.
    """
    personality, parameters = personality_of(vehicle), dict(vehicle.parameters)
    Parameters(personality.firmware.table, parameters)
    system_id = parameters.pop(personality.firmware.ids[0], vehicle.system_id)
    return vehicle.model_copy(update={"system_id": int(system_id), "parameters": parameters})


def make_vehicle(
    vehicle: VehicleTable, latitude_deg: float, longitude_deg: float, ground_amsl_m: float
) -> Copter | Plane:
    """The airframe, standing on the ground here."""
    usual = personality_of(vehicle)
    place: Any = {
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "altitude_amsl_m": ground_amsl_m,
        "heading_rad": math.radians(vehicle.heading_deg),
    }
    own = {key: value for key in LIMITS[vehicle.kind] if (value := getattr(vehicle, key))}
    if isinstance(usual.limits, Limits):
        drags = usual.drag if (drag_1_s := _own_drag_1_s(vehicle)) is None else (drag_1_s, 0.0)
        limits = replace(usual.limits, **{key.replace("_max", ""): own[key] for key in own})
        return Copter(**place, limits=limits, drag_1_s=drags[0], drag_1_m=drags[1])
    if "bank_max_deg" in own:
        own["bank_max_rad"] = math.radians(own.pop("bank_max_deg"))
    able = replace(usual.limits, **own)
    if able.airspeed_min_m_s >= able.airspeed_max_m_s:
        rule = f"must be less than airspeed_max_m_s, which is {able.airspeed_max_m_s:g}"
        raise InputError("vehicle.airspeed_min_m_s", able.airspeed_min_m_s, rule, "Give both.")
    return Plane(**place, limits=able)


def _own_drag_1_s(vehicle: VehicleTable) -> float | None:
    """What the world gives; a vehicle whose speed it gives is limited by that, and has no drag."""
    if vehicle.drag_1_s is None and vehicle.speed_max_m_s is not None:
        return 0.0
    return vehicle.drag_1_s


def overrides_of(vehicle: VehicleTable) -> dict[str, float]:
    """The parameters of the world file, and those that follow from the limits that it gives.

    An ArduCopter's climb, descent and tilt follow the vehicle's limits and not its own defaults: a
    vehicle for 3 km of height would otherwise climb for twenty minutes.  PX4 has the drag of its
    simulated quadcopter as a parameter.
    """
    follow: dict[str, float | None] = {}
    speed_m_s, most_m_s2 = vehicle.speed_vertical_max_m_s, vehicle.acceleration_vertical_max_m_s2
    if vehicle.kind == "copter" and vehicle.autopilot == "px4":
        follow["SIH_KDV"] = _own_drag_1_s(vehicle)
    elif vehicle.kind == "copter":  # in cm/s and cm/s2
        follow["WPNAV_SPEED_UP"] = follow["WPNAV_SPEED_DN"] = speed_m_s and speed_m_s * 100.0
        follow["WPNAV_ACCEL_Z"] = most_m_s2 and most_m_s2 * 100.0
        follow["ANGLE_MAX"] = vehicle.acceleration_max_m_s2 and _STEEPEST_CDEG
    follow[personality_of(vehicle).firmware.ids[0]] = float(vehicle.system_id)
    return {name: value for name, value in follow.items() if value is not None} | vehicle.parameters
