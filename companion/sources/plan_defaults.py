"""Default values of a mission that a .plan lacks, so that the plan alone can be flown.

A mission.toml that names the plan overrides any of them.  Each assumption is reported.
"""

import math
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.planner.rules import MAX_CELLS
from companion.planner.settings import CELLS_PER_RANGE
from companion.profiles import FLIGHT
from companion.sources.files import RawTable, merged
from companion.sources.mission_schema import TargetTable
from companion.sources.plan_file import Plan
from companion.sources.schema import OriginTable

_GRAVITY_M_S2: Final = 9.81
_LOITER_BANK_RAD: Final = math.radians(35.0)
_MIN_LOITER_M: Final = 100.0  # both autopilots ask for 80, ArduPlane flies 17 more
_SEARCH_ERRORS: Final = 1.1  # of the vehicle's errors: kept besides d_s (`Task.band_amsl_m`)
_BAND_ERRORS: Final = 8.0
_MAX_M_S: Final = 500.0
_FARTHEST_M: Final = 1e6  # from the origin, as for any place (`sources.zones`)


# Of each kind of vehicle:
_SPEED_M_S: Final = {"copter": 5.0, "plane": 15.0}  # QGroundControl's own
_CLIMB_M_S: Final = {"copter": 1.5, "plane": 2.5}
_SINK_M_S: Final = {"copter": 1.5, "plane": 1.8}  # PX4's copters sink no faster, its planes at 2
_LATERAL_M_S2: Final = {"copter": 1.5, "plane": 2.0}
"""ArduCopter keeps to a path up to this; ArduPlane is then 10 m off it."""
_MAX_SLOPE_DEG: Final = {"copter": 30.0, "plane": 7.0}
_MIN_RADIUS_M: Final = {"copter": 10.0, "plane": 60.0}
_TRACKING_M: Final = {"copter": 5.0, "plane": 15.0}
_SIGHT_M: Final = {"copter": 2000.0, "plane": 3000.0}
_DISTANCE_M: Final = {"copter": 30.0, "plane": 50.0}
_MIN_DISTANCE_M: Final = {"copter": 10.0, "plane": 20.0}


def with_plan(given: RawTable, plan: Plan, name: str) -> tuple[RawTable, list[str]]:
    """A mission table with the plan in it, and what was assumed, for people.

    What is given, itself not yet checked, goes before the plan; zones and rally points of both
    count.  name: of the mission, if nothing is given.  Raises InputError about a waypoint that is
    too far from launch for any map, or whose altitude without a radar is not known.
    """
    said = _at(given, "vehicle.kind")
    kind = said if said in ("copter", "plane") else plan.kind or "copter"
    is_blind = _at(given, "vehicle.scanner") is False
    ground_m = max(_number(given, "terrain.highest_amsl_m", plan.home_amsl_m), plan.home_amsl_m)
    own_targets = not _at(given, "from_vehicle.targets")
    vehicle, notes = _vehicle(given, plan, kind)
    errors_m = sum(
        _number(given, f"vehicle.{key}", vehicle[key], above=0.0)
        for key in ("tracking_error_m", "navigation_error_m")
    )
    if plan.unknown_altitudes and own_targets:
        notes.append(_about_unknown_altitudes(plan, is_blind=is_blind))
    range_m = _number(given, "planner.scan_range_m", _SIGHT_M[kind], above=0.0)
    distance_m = _DISTANCE_M[kind]
    if is_blind:
        heights_m = [t["altitude_amsl_m"] for t in plan.targets if "altitude_amsl_m" in t]
        room_m = min(heights_m, default=math.inf) - ground_m - _SEARCH_ERRORS * errors_m
        if room_m < distance_m:
            distance_m = max(float(math.floor(room_m + 1e-6)), _MIN_DISTANCE_M[kind])
    distance_m = _number(given, "planner.safety_distance_m", distance_m, above=0.0)
    band = _band(plan, errors_m, distance_m, ground_m, is_blind=is_blind)
    assumed: RawTable = {
        "schema": 1,
        "name": name,
        "origin": {"latitude_deg": plan.home_deg[0], "longitude_deg": plan.home_deg[1]},
        "altitude": band,
        "vehicle": vehicle,
        "planner": {
            "scan_range_m": range_m,
            "safety_distance_m": distance_m,
            "planning_time_s": 3.0,
        },
        "end": {"action": plan.end_action},
        "keep_outs": plan.keep_outs,
        "keep_ins": plan.keep_ins,
        "rally_points": plan.rally_points,
    }
    if own_targets and "targets" not in given:
        of_radars = () if is_blind else ("altitude_amsl_m",)  # with one, any of the band will do
        assumed["targets"] = [
            {key: value for key, value in target.items() if key not in of_radars}
            for target in plan.targets
        ]
    if "altitude" not in given:
        notes.append(_about_altitude(plan, band, is_blind=is_blind))
    table = merged(assumed, given, ("keep_outs", "keep_ins", "rally_points"))
    if "area" not in given and (area := _area(table, plan, range_m)):
        table["area"] = area
        notes.append(f"map assumed: {range_m:g} m around launch and targets")
    if _at(given, "planner.scan_range_m") is None:
        sight = "looking ahead" if is_blind else "a terrain radar that sees"
        notes.append(f"assumed: {sight} {range_m:g} m (R), d_s = {distance_m:g} m")
    return table, [*notes, *plan.notes]


def _vehicle(given: RawTable, plan: Plan, kind: str) -> tuple[RawTable, list[str]]:
    """What is assumed of the vehicle, but for what follows from a speed that is given."""
    planned = plan.speed_m_s.get(kind)
    of_plan = planned is not None and 0.0 < planned < _MAX_M_S
    speed = planned if planned is not None and of_plan else _SPEED_M_S[kind]
    notes = []
    if _at(given, "vehicle.speed_m_s") is None:
        source = f"{'hover' if kind == 'copter' else 'cruise'} speed of the plan"
        notes.append(f"a {kind} at {speed:g} m/s ({source if of_plan else 'assumed'})")
    speed = _number(given, "vehicle.speed_m_s", speed, above=0.0)
    table: RawTable = {
        "kind": kind,
        "speed_m_s": speed,
        "acceleration_m_s2": 2.0,
        "climb_rate_m_s": _CLIMB_M_S[kind],
        "tracking_error_m": _TRACKING_M[kind],
        "navigation_error_m": 5.0,
        "turn_radius_m": max(_round_up(speed**2 / _LATERAL_M_S2[kind]), _MIN_RADIUS_M[kind]),
    }
    for key, rate_m_s in (("climb", _CLIMB_M_S[kind]), ("dive", _SINK_M_S[kind])):
        slope_deg = min(math.degrees(math.atan(rate_m_s / speed)), _MAX_SLOPE_DEG[kind])
        table[f"{key}_angle_deg"] = math.floor(slope_deg * 10.0) / 10.0
    if kind == "plane":
        tightest_m = speed**2 / (_GRAVITY_M_S2 * math.tan(_LOITER_BANK_RAD))
        table["loiter_radius_m"] = max(_round_up(tightest_m), _MIN_LOITER_M)
    return table, notes


def _round_up(value_m: float) -> float:
    return math.ceil(value_m / 5.0) * 5.0


def _band(
    plan: Plan, error_m: float, distance_m: float, ground_m: float, *, is_blind: bool
) -> RawTable:
    """A band around the altitudes of the waypoints, high enough above launch to begin in it.

    ground_m: the highest of the ground, AMSL, if that is stated; otherwise as launch.  Without a
    radar it begins where paths just keep d_s and the errors from that, and no higher: what is
    flown in it are the waypoints' own altitudes.
    """
    heights = plan.altitudes_amsl_m or [plan.home_amsl_m]
    if is_blind:
        inset = _SEARCH_ERRORS * error_m
        least = ground_m + max(distance_m * FLIGHT.margin, distance_m + inset) - inset
        floor = math.ceil(10.0 * max(min(heights) - inset, least) + 1e-6) / 10.0
    else:
        above_ground = ground_m + distance_m + 2.0 * error_m
        floor = float(math.ceil(max(min(heights) - 2.0 * error_m, above_ground)))
    ceiling = math.ceil(max(max(heights) + 2.0 * error_m, floor + _BAND_ERRORS * error_m))
    return {"floor_amsl_m": floor, "ceiling_amsl_m": float(ceiling)}


def _area(table: RawTable, plan: Plan, sight_m: float) -> RawTable | None:
    """The box around launch and targets, as far beyond them as the radar sees.

    None: the schema refuses what it would be drawn about.  InputError about the waypoint that makes
    it too large for a map.
    """
    try:
        frame = LocalFrame(**dict(OriginTable.model_validate(table["origin"])))
        targets = [TargetTable.model_validate(each) for each in table.get("targets", ())]
    except (TypeError, ValidationError):
        return None
    own_m = ((each.north_m or 0.0, each.east_m or 0.0) for each in targets if not each.degrees)
    waypoints = [(each.name, each.degrees) for each in targets if each.degrees]
    degrees = [plan.home_deg, *(place for _, place in waypoints)]
    places_m = [*(frame.to_local_m(*place) for place in degrees), *own_m]
    if not np.isfinite(places_m).all():
        return None
    area = {}
    for axis, values in zip(("north", "east"), zip(*places_m, strict=True), strict=True):
        area[f"{axis}_min_m"] = float(math.floor(min(values) - sight_m))
        area[f"{axis}_max_m"] = float(math.ceil(max(values) + sight_m))
    sides_m = (area[f"{axis}_max_m"] - area[f"{axis}_min_m"] for axis in ("north", "east"))
    cells = math.prod(sides_m) / max(round(sight_m / CELLS_PER_RANGE), 1) ** 2
    by_radar = _at(table, "scanner.kind") in (None, "terrain_radar")
    if max(map(abs, area.values())) >= _FARTHEST_M or (by_radar and cells > MAX_CELLS):
        far_m = [math.dist(place, places_m[0]) for place in places_m[: len(degrees)]]
        index = far_m.index(max(far_m))
        if index > 0:
            far = f"{max(far_m) / 1000.0:,.0f} km from launch {plan.home_deg}"
            remedy = "Correct it or launch, or raise planner.scan_range_m in a mission.toml."
            name = f"{plan.name}: {waypoints[index - 1][0]}"
            rule = f"it lies {far}, too far for one map"
            raise InputError(name, list(degrees[index]), rule, remedy)
    return area


def _about_altitude(plan: Plan, band: RawTable, *, is_blind: bool) -> str:
    between = f"{band['floor_amsl_m']:g} to {band['ceiling_amsl_m']:g} m AMSL"
    launch = f"launch at {plan.home_amsl_m:g} m"
    if not plan.altitudes_amsl_m:
        return f"altitude: anywhere from {between} (assumed; {launch})"
    low, high = f"{min(plan.altitudes_amsl_m):g}", f"{max(plan.altitudes_amsl_m):g}"
    planned = low if low == high else f"{low} to {high}"
    if is_blind:
        return f"altitude: the plan's own, {planned} m AMSL ({launch}), in a band of {between}"
    return (
        f"altitude: anywhere from {between} (assumed from the plan's {planned} m, {launch} AMSL); "
        "waypoints are passed at any altitude of this band"
    )


def _about_unknown_altitudes(plan: Plan, *, is_blind: bool) -> str:
    """A note; without a radar, where altitudes are flown as they are planned, an InputError."""
    where, height_m = plan.unknown_altitudes[0]
    remedy = (
        "Give [terrain] with highest_amsl_m or an elevation file that has the place, or an "
        "altitude above launch or above mean sea level."
    )
    if is_blind:
        rule = "it is above terrain, and how high the ground is there is not known"
        raise InputError(f"{where}: altitude", height_m, rule, remedy)
    what = "altitude above terrain, where the ground is not known"
    return f"left out: {len(plan.unknown_altitudes)} x {what}. {remedy}"


def _at(table: RawTable, path: str) -> Any:
    """What stands at a path ("vehicle.kind"); None: nothing."""
    here: Any = table
    for key in path.split("."):
        here = here.get(key) if isinstance(here, dict) else None
    return here


def _number(table: RawTable, path: str, default: float, above: float = -1e9) -> float:
    """A number, if that is what is there; what is there otherwise, the schema refuses."""
    value = _at(table, path)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and above < value < 1e9 else default
