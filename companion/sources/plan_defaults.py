"""Default values of a mission that a .plan lacks, so that the plan alone can be flown.

A mission.toml that names the plan overrides any of them.  Each assumption is reported.
"""

import math

from companion.errors import InputError
from companion.geodesy import LocalFrame
from companion.planner.rules import MAX_CELLS
from companion.planner.settings import CELLS_PER_RANGE
from companion.profiles import FLIGHT
from companion.sources.files import RawTable
from companion.sources.plan_file import Plan, listing

_GRAVITY_M_S2 = 9.81
_COPTER: RawTable = {
    "acceleration_m_s2": 2.0,
    "climb_rate_m_s": 1.5,  # PX4 multicopters sink no faster by themselves
    "tracking_error_m": 5.0,
    "navigation_error_m": 5.0,
}
_PLANE: RawTable = {
    "acceleration_m_s2": 2.0,
    "climb_rate_m_s": 2.5,
    "tracking_error_m": 15.0,
    "navigation_error_m": 5.0,
}
_LATERAL_M_S2 = {"copter": 1.5, "plane": 2.0}
"""ArduCopter keeps to a path up to this; ArduPlane is then 10 m off it."""
_MAX_SLOPE_DEG = {"copter": 30.0, "plane": 7.0}
_PLANE_SINK_M_S = 1.8  # PX4 sinks at 2
_MIN_RADIUS_M = {"copter": 10.0, "plane": 60.0}
_MIN_LOITER_M = 100.0  # both autopilots ask for 80, ArduPlane flies 17 more
_LOITER_BANK_RAD = math.radians(35.0)
_SPEED_M_S = {"copter": 5.0, "plane": 15.0}  # QGroundControl's own
_SIGHT_M = {"copter": 2000.0, "plane": 3000.0}
_DISTANCE_M = {"copter": 30.0, "plane": 50.0}
_MIN_DISTANCE_M = {"copter": 10.0, "plane": 20.0}
_SEARCH_ERRORS = 1.1  # of the vehicle's errors: what paths keep besides d_s (`Task.band_amsl_m`)
_BAND_ERRORS = 8.0
_MAX_M_S = 500.0
_FARTHEST_M = 1e6  # from the origin, as for any place (`sources.places`)


def with_plan(given: RawTable, plan: Plan, name: str) -> tuple[RawTable, list[str]]:
    """A mission table with the plan in it, and what was assumed, for people.

    What is given, itself not yet checked, goes before the plan; zones and rally points of both
    count.  name: of the mission, if nothing is given.  Raises InputError about a waypoint that is
    too far from launch for any map, or whose altitude without a radar is not known.
    """
    vehicle, notes = _vehicle(given, plan)
    vehicle_as_given = _merged(vehicle, _table(given, "vehicle"))
    ground_m = _number(_table(given, "terrain"), "highest_amsl_m", plan.home_amsl_m)
    ground_m = max(ground_m, plan.home_amsl_m)
    is_blind = vehicle_as_given.get("scanner") is False
    planner = _planner(given, vehicle["kind"])
    own_targets = not _table(given, "from_vehicle").get("targets")
    if plan.unknown_altitudes and own_targets:
        notes.append(_about_unknown_altitudes(plan, is_blind=is_blind))
    if is_blind and "safety_distance_m" not in _table(given, "planner"):
        planner["safety_distance_m"] = _least_distance_m(plan, vehicle_as_given, ground_m)
    assumed: RawTable = {
        "schema": 1,
        "name": name,
        "origin": {"latitude_deg": plan.home_deg[0], "longitude_deg": plan.home_deg[1]},
        "vehicle": vehicle,
        "planner": planner,
        "end": {"action": plan.end_action},
        "keep_outs": plan.keep_outs,
        "keep_ins": plan.keep_ins,
        "rally_points": plan.rally_points,
    }
    if "targets" not in given and own_targets:
        assumed["targets"] = _at_their_altitudes(plan) if is_blind else plan.targets
    assumed["altitude"] = _altitude(plan, vehicle_as_given, planner, ground_m)
    if "altitude" not in given:
        notes.append(_about_altitude(plan, assumed["altitude"], is_blind=is_blind))
    table = _merged(assumed, given)
    if "area" not in given and (area := _area(table, plan, planner["scan_range_m"])):
        _check_reach(table, plan, area, planner["scan_range_m"])
        table["area"] = area
        notes.append(f"map assumed: {planner['scan_range_m']:g} m around launch and targets")
    if "scan_range_m" not in _table(given, "planner"):
        sight = "looking ahead" if is_blind else "a terrain radar that sees"
        notes.append(
            f"assumed: {sight} {planner['scan_range_m']:g} m (R), "
            f"d_s = {planner['safety_distance_m']:g} m"
        )
    return table, [*notes, *plan.notes]


def _vehicle(given: RawTable, plan: Plan) -> tuple[RawTable, list[str]]:
    chosen = _table(given, "vehicle")
    kind = chosen.get("kind") if chosen.get("kind") in ("copter", "plane") else plan.kind
    kind = str(kind or "copter")
    planned = plan.speed_m_s[kind]
    if planned is not None and not 0.0 < planned < _MAX_M_S:
        planned = None
    speed = _positive(chosen, "speed_m_s", planned or _SPEED_M_S[kind])
    table: RawTable = {"kind": kind, "speed_m_s": speed}
    table |= _COPTER if kind == "copter" else _PLANE
    climb = table["climb_rate_m_s"]
    dive = climb if kind == "copter" else _PLANE_SINK_M_S
    radius = max(_round_up(speed**2 / _LATERAL_M_S2[kind]), _MIN_RADIUS_M[kind])
    table["turn_radius_m"] = radius
    table["climb_angle_deg"] = _slope_deg(climb, speed, kind)
    table["dive_angle_deg"] = _slope_deg(dive, speed, kind)
    if kind == "plane":
        tightest = speed**2 / (_GRAVITY_M_S2 * math.tan(_LOITER_BANK_RAD))
        table["loiter_radius_m"] = max(_round_up(tightest), _MIN_LOITER_M)
    notes = []
    if "speed_m_s" not in chosen:
        source = f"{'hover' if kind == 'copter' else 'cruise'} speed of the plan"
        notes.append(f"a {kind} at {speed:g} m/s ({source if planned else 'assumed'})")
    return table, notes


def _slope_deg(rate_m_s: float, speed_m_s: float, kind: str) -> float:
    slope = math.degrees(math.atan(rate_m_s / speed_m_s))
    return math.floor(min(slope, _MAX_SLOPE_DEG[kind]) * 10.0) / 10.0


def _round_up(value_m: float) -> float:
    return math.ceil(value_m / 5.0) * 5.0


def _planner(given: RawTable, kind: str) -> RawTable:
    chosen = _table(given, "planner")
    return {
        "scan_range_m": _positive(chosen, "scan_range_m", _SIGHT_M[kind]),
        "safety_distance_m": _positive(chosen, "safety_distance_m", _DISTANCE_M[kind]),
        "planning_time_s": 3.0,
    }


def _altitude(plan: Plan, vehicle: RawTable, planner: RawTable, ground_m: float) -> RawTable:
    """A band around the altitudes of the waypoints, high enough above launch to begin in it.

    ground_m: the highest of the ground, AMSL, if that is stated; otherwise as launch.  Without a
    radar it begins where paths just keep d_s and the errors from that, and no higher: what is
    flown in it are the waypoints' own altitudes.
    """
    error, distance = _error_m(vehicle), planner["safety_distance_m"]
    heights = plan.altitudes_amsl_m or [plan.home_amsl_m]
    if vehicle.get("scanner") is False:
        inset = _SEARCH_ERRORS * error
        least = ground_m + max(distance * FLIGHT.margin, distance + inset) - inset
        floor = math.ceil(10.0 * max(min(heights) - inset, least) + 1e-6) / 10.0
    else:
        above_ground = ground_m + distance + 2.0 * error
        floor = float(math.ceil(max(min(heights) - 2.0 * error, above_ground)))
    ceiling = math.ceil(max(max(heights) + 2.0 * error, floor + _BAND_ERRORS * error))
    return {"floor_amsl_m": float(floor), "ceiling_amsl_m": float(ceiling)}


def _error_m(vehicle: RawTable) -> float:
    return sum(_positive(vehicle, key, 5.0) for key in ("tracking_error_m", "navigation_error_m"))


def _least_distance_m(plan: Plan, vehicle: RawTable, ground_m: float) -> float:
    """d_s without a radar: the usual, or as much as the lowest waypoint leaves above the ground."""
    kind = vehicle["kind"] if vehicle.get("kind") in _DISTANCE_M else "copter"
    heights = [height for height in plan.target_amsl_m if height is not None]
    room_m = min(heights, default=math.inf) - ground_m - _SEARCH_ERRORS * _error_m(vehicle)
    usual_m = _DISTANCE_M[kind]
    if room_m >= usual_m:
        return usual_m
    return max(float(math.floor(room_m + 1e-6)), _MIN_DISTANCE_M[kind])


def _at_their_altitudes(plan: Plan) -> list[RawTable]:
    pairs = zip(plan.targets, plan.target_amsl_m, strict=True)
    return [
        target if height is None else target | {"altitude_amsl_m": height}
        for target, height in pairs
    ]


def _about_altitude(plan: Plan, band: RawTable, *, is_blind: bool) -> str:
    between = f"{band['floor_amsl_m']:g} to {band['ceiling_amsl_m']:g} m AMSL"
    if not plan.altitudes_amsl_m:
        return f"altitude: anywhere from {between} (assumed; launch at {plan.home_amsl_m:g} m)"
    heights = plan.altitudes_amsl_m
    low, high = f"{min(heights):g}", f"{max(heights):g}"
    planned = low if low == high else f"{low} to {high}"
    if is_blind:
        launch = f"launch at {plan.home_amsl_m:g} m"
        return f"altitude: the plan's own, {planned} m AMSL ({launch}), in a band of {between}"
    return (
        f"altitude: anywhere from {between} (assumed from the plan's {planned} m, launch at "
        f"{plan.home_amsl_m:g} m AMSL); waypoints are passed at any altitude of this band"
    )


def _area(table: RawTable, plan: Plan, margin_m: float) -> RawTable | None:
    """The box around launch and targets, as far beyond them as the radar sees."""
    origin = _table(table, "origin")
    latitude = _number(origin, "latitude_deg", math.nan)
    longitude = _number(origin, "longitude_deg", math.nan)
    if not (abs(latitude) <= 85.0 and abs(longitude) <= 180.0):
        return None  # refused by the schema
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    places = [frame.to_local_m(*plan.home_deg), *_targets_ne_m(table, frame)]
    north, east = ([place[axis] for place in places] for axis in (0, 1))
    if not all(math.isfinite(value) for value in (*north, *east)):
        return None
    return {
        "north_min_m": float(math.floor(min(north) - margin_m)),
        "north_max_m": float(math.ceil(max(north) + margin_m)),
        "east_min_m": float(math.floor(min(east) - margin_m)),
        "east_max_m": float(math.ceil(max(east) + margin_m)),
    }


def _targets_ne_m(table: RawTable, frame: LocalFrame) -> list[tuple[float, float]]:
    """Where the targets lie; nan for what the schema refuses."""
    targets, found = table.get("targets") or [], []
    for target in targets if isinstance(targets, list) else []:
        lat, lon, north_m, east_m = (
            _number(target if isinstance(target, dict) else {}, key, math.nan)
            for key in ("latitude_deg", "longitude_deg", "north_m", "east_m")
        )
        found.append((north_m, east_m) if math.isnan(lat) else frame.to_local_m(lat, lon))
    return found


def _check_reach(table: RawTable, plan: Plan, area: RawTable, sight_m: float) -> None:
    """Refuse an assumed map that is too large, by the waypoint that makes it so."""
    sides = [area[f"{axis}_max_m"] - area[f"{axis}_min_m"] for axis in ("north", "east")]
    by_hand = _table(table, "scanner").get("kind", "terrain_radar") != "terrain_radar"
    cells = math.prod(sides) / max(round(sight_m / CELLS_PER_RANGE), 1) ** 2
    if max(map(abs, area.values())) < _FARTHEST_M and (by_hand or cells <= MAX_CELLS):
        return
    latitude, longitude = plan.home_deg
    frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
    far_m = [math.hypot(*place) for place in _targets_ne_m(table, frame)]
    if not far_m:
        return
    index = far_m.index(max(far_m))
    target = table["targets"][index]
    name = f"{plan.name}: {target.get('name') or f'targets[{index}]'}"
    shown = [target.get("latitude_deg"), target.get("longitude_deg")]
    rule = (
        f"it lies {max(far_m) / 1000.0:,.0f} km from launch ({latitude:g}, {longitude:g}), too far "
        "for one map"
    )
    remedy = (
        "Correct it or launch; if both are right, name the plan in a mission.toml with a larger "
        "planner.scan_range_m."
    )
    raise InputError(name, shown, rule, remedy)


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
    names = [label.removeprefix(f"{plan.name}: ") for label, _ in plan.unknown_altitudes]
    what = "altitude above terrain, where the ground is not known"
    return f"left out: {len(names)} x {what} ({listing(names)}). {remedy}"


def _merged(assumed: RawTable, given: RawTable) -> RawTable:
    """What is given over what is assumed; lists of zones and points one after the other."""
    result = dict(assumed)
    for key, value in given.items():
        below = result.get(key)
        if isinstance(value, dict) and isinstance(below, dict):
            result[key] = _merged(below, value)
        elif key in ("keep_outs", "keep_ins", "rally_points") and isinstance(value, list):
            result[key] = [*value, *(below or [])]
        else:
            result[key] = value
    return result


def _table(table: RawTable, key: str) -> RawTable:
    found = table.get(key)
    return found if isinstance(found, dict) else {}


def _number(table: RawTable, key: str, default: float) -> float:
    """A number, if that is what is there; what is there otherwise, the schema refuses."""
    value = table.get(key)
    fit = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9
    return float(value) if fit and value is not None else default


def _positive(table: RawTable, key: str, default: float) -> float:
    value = _number(table, key, default)
    return value if value > 0.0 else default
