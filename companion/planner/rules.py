"""Rules between the numbers of a task, for all sources of settings.

Mission files, targets from a ground station or from the vehicle, and replays under other settings
are all checked by them.  A broken rule is an InputError whose field is named as in mission.toml.
"""

import math
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.planner.settings import Task
from companion.world.zones import Zone

Place = tuple[float, float]

_GRAVITY_M_S2 = 9.81
"""Standard gravity (ISO 80000-3), to 0.04 %."""
MAX_CELLS = 2.5e7
"""Of a map: 200 MB for each array of altitudes, and a plan holds several."""
_MAX_LATERAL_M_S2 = 20.0
"""Of a copter: 2 g, a tilt of 64 degrees; more is a slip of the pen and no way to fly."""
_MAX_BANK_DEG = 45.0
"""Of a plane: ArduPlane's default roll limit; PX4's is 50 degrees."""
_SCAN_REQUESTS = 33
"""A circle of R = 80 cells touches 31 to 38 rectangles of 28 x 32 cells, as each request covers
(`mavlink.terrain_download`), 34 in the mean; the rectangles at its rim are mostly empty."""
_MOST_OF_SIGHT = 0.6
"""L as a share of how far out subpaths end: a leg gains what is left, and with less than 40 % it
would see the same ground three times."""
_MIN_BAND_ERRORS = 4.0
"""Between floor and ceiling: paths keep 1.1 errors from either (`Task.band_amsl_m`), and as much
again is left to climb in."""
_MIN_AREA_M2 = 1.0
"""Corners of a line have that much by the rounding of degrees to 1e-7 (1 cm) over 100 m."""
_MAX_CORNERS = 2000
"""Of a polygon: crossings are looked for between all pairs of its edges, 0.1 s; a border of more is
of no use at the scale of a flight."""


def check_task(task: Task, where: str = "") -> None:
    """Check a task against every rule between its numbers.

    Raises InputError for the first that is broken; where comes before the field ("file: ").
    """
    for check in _OF_TASKS:
        check(task, where)


def newly_broken(
    before: Task, after: Task, targets_ne_m: Iterable[Place] = ()
) -> InputError | None:
    """The first rule that a change of a task breaks; None: it breaks none.

    Rules that were broken before do not prevent a change: the vehicle's fence may exclude a target,
    and home may be at the edge of the map.
    """
    checks: list[_Check] = [partial(check, where="") for check in _OF_TASKS]
    for number, target in enumerate(targets_ne_m):
        checks.append(partial(check_target, target_ne_m=target, field=f"targets[{number}]"))
    for check in checks:
        if (error := _broken(check, after)) is not None and _broken(check, before) is None:
            return error
    return None


def target_refusal(task: Task, target_ne_m: Place) -> str:
    """Why a place cannot be a target, as text; empty if it can."""
    error = _broken(partial(check_target, target_ne_m=target_ne_m, field="target"), task)
    return "" if error is None else f"the target: {error.rule}"


_Check = Callable[[Task], None]


def _broken(check: _Check, task: Task) -> InputError | None:
    try:
        check(task)
    except InputError as error:
        return error
    return None


def check_target(task: Task, target_ne_m: Place, field: str) -> None:
    """Hold a target to the map and the zones.  Raises InputError about the field."""
    limits, zones = task.limits, task.zones
    inset = task.zone_search_clearance_m if task.settings.profile.verified else 0.0
    for value, (low, high), axis in zip(
        target_ne_m, (limits.north_m, limits.east_m), ("north", "east"), strict=True
    ):
        if not low + inset <= value <= high - inset:
            rule = f"it lies outside the map, {low:g} to {high:g} m"
            if low <= value <= high:
                rule = f"it lies nearer than {_least(task)} to the edge of the map"
            raise InputError(f"{field}.{axis}_m", value, rule, "Move it, or widen [area].")
    for zone in zones:
        gap = float(zone.distance_m(*np.array(target_ne_m)))
        if gap < task.zone_search_clearance_m:
            rule = f"it lies {_where(zone, gap, task)} {zone.name!r}"
            raise InputError(field, list(target_ne_m), rule, "Move the target, or remove the zone.")


def check_polygon(vertices_ne_m: tuple[Place, ...], field: str, name: str) -> None:
    """Hold a polygon to having an inside.  Raises InputError about the field."""
    corners = np.array(vertices_ne_m, dtype=np.float64).reshape(-1, 2)
    if len(set(vertices_ne_m)) < 3:
        remedy = "Give three or more different corners."
        raise InputError(field, name, "a polygon has three or more corners", remedy)
    if len(corners) > _MAX_CORNERS:
        rule = f"it has more than {_MAX_CORNERS} corners"
        raise InputError(field, name, rule, "Simplify it, outwards.")
    crossing = first_crossing(corners)
    if crossing is not None:
        a, b = crossing
        rule = f"the edges from its corners {a} and {b} (from 0) cross, so it has no clear inside"
        raise InputError(field, name, rule, "Draw it so that it does not cross itself.")
    if abs(_area_m2(corners)) < _MIN_AREA_M2:
        remedy = "Give corners that do not lie on one line."
        raise InputError(field, name, "it has no area", remedy)


def first_crossing(corners_ne_m: FloatArray) -> tuple[int, int] | None:
    """The first two edges of a closed polygon that cross, if any do.

    (corners, 2) -> the corners that they begin at, or None.  Edges that only touch do not cross.
    """
    begins, ends = corners_ne_m, np.roll(corners_ne_m, -1, axis=0)
    for k in range(len(begins) - 2):
        others = slice(k + 2, len(begins) - (k == 0))
        c, d = begins[others], ends[others]
        sides_of_k = _side(begins[k], ends[k], c) * _side(begins[k], ends[k], d)
        sides_of_others = _side(c, d, begins[k]) * _side(c, d, ends[k])
        crossing = np.flatnonzero((sides_of_k < 0.0) & (sides_of_others < 0.0))
        if len(crossing):
            return k, k + 2 + int(crossing[0])
    return None


def _side(a: FloatArray, b: FloatArray, points: FloatArray) -> FloatArray:
    """On which side of the line from a to b points lie: the sign.  (..., 2) x3 -> (...)."""
    along, off = b - a, points - a
    return np.sign(along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0])


def _area_m2(corners_ne_m: FloatArray) -> float:
    north, east = (corners_ne_m - corners_ne_m[0]).T
    return 0.5 * float(np.sum(north * np.roll(east, -1) - east * np.roll(north, -1)))


def _least(task: Task) -> str:
    circle = "" if task.limits.hovers else ", and the circle that a plane holds on"
    return f"{task.zone_search_clearance_m:g} m (d_s and the vehicle's errors{circle})"


def _where(zone: Zone, gap_m: float, task: Task) -> str:
    near = f"nearer than {_least(task)} to"
    if zone.keep_in:
        return "outside keep-in" if gap_m < 0.0 else f"{near} the edge of keep-in"
    return "inside keep-out" if gap_m < 0.0 else f"{near} keep-out"


def check_area(north_m: tuple[float, float], east_m: tuple[float, float], where: str = "") -> None:
    """Hold a map to having an inside.  Raises InputError."""
    for axis, (low, high) in (("north", north_m), ("east", east_m)):
        if low >= high:
            rule = f"it must be more than area.{axis}_min_m = {low:g}"
            raise InputError(f"{where}area.{axis}_max_m", high, rule, "Swap or widen them.")


def _check_map(task: Task, where: str) -> None:
    limits = task.limits
    check_area(limits.north_m, limits.east_m, where)
    floor, ceiling = limits.floor_amsl_m, limits.ceiling_amsl_m
    if ceiling - floor <= _MIN_BAND_ERRORS * task.error_m:
        rule = (
            f"it must lie above altitude.floor_amsl_m = {floor:g} by more than 4 times "
            "vehicle.tracking_error_m + navigation_error_m"
        )
        raise InputError(f"{where}altitude.ceiling_amsl_m", ceiling, rule, "Widen the band.")
    cells = math.prod(high - low for low, high in (limits.north_m, limits.east_m))
    if cells / task.cell_m**2 > MAX_CELLS:
        rule = f"the map has more than {MAX_CELLS:.0e} cells of R / 80"
        remedy = "Raise it, or make [area] smaller."
        raise InputError(f"{where}planner.scan_range_m", task.settings.scan_range_m, rule, remedy)


def _check_scan_distance(task: Task, where: str) -> None:
    """Eq. 4 and what it needs: L >= V T + d_s, and room for L within sight."""
    settings, speed = task.settings, task.limits.speed_m_s
    least = task.shortest_scan_distance_m
    given = settings.scan_distance_m
    if given is not None and given < least:
        rule = f"eq. 4: L must be at least V (T + scan time) + tail = {least:g} m"
        remedy = "Leave scan_distance_m out, or lower planning_time_s or speed_m_s."
        raise InputError(f"{where}planner.scan_distance_m", given, rule, remedy)
    room = _MOST_OF_SIGHT * task.end_radius_m
    if task.scan_distance_m > room:
        rule = (
            f"eq. 4: with V = {speed:g} m/s and d_s = {settings.safety_distance_m:g} m it needs "
            f"L = {task.scan_distance_m:g} m, too much for R = {settings.scan_range_m:g} m "
            f"(at most {room:g} m)"
        )
        remedy = "Lower planning_time_s, speed_m_s or safety_distance_m, or raise scan_range_m."
        given = settings.planning_time_s
        raise InputError(f"{where}planner.planning_time_s", given, rule, remedy)
    if settings.is_near:
        return  # no TERRAIN_REQUEST is sent
    least = _SCAN_REQUESTS * settings.position_period_s
    if settings.scan_time_s < least:
        period = f"one a position ({settings.position_period_s:g} s)"
        rule = f"a scan takes {_SCAN_REQUESTS} requests, {period}"
        remedy = f"Raise it to {least:g}, or raise vehicle.position_rate_hz."
        raise InputError(f"{where}planner.scan_time_s", settings.scan_time_s, rule, remedy)


def _check_turns(task: Task, where: str) -> None:
    limits, settings = task.limits, task.settings
    turns = {"turn_radius_m": limits.turn_radius_m}
    if not limits.hovers:
        turns["loiter_radius_m"] = limits.loiter_radius_m
    for key, radius in turns.items():
        if rule := _too_tight(limits.speed_m_s, radius, hovers=limits.hovers):
            remedy = "Raise it, or lower vehicle.speed_m_s."
            raise InputError(f"{where}vehicle.{key}", radius, rule, remedy)
    if limits.turn_radius_m > 0.5 * settings.scan_range_m:
        rule = f"a turn must fit into the scan range R = {settings.scan_range_m:g} m twice"
        remedy = "Lower it, or raise planner.scan_range_m."
        raise InputError(f"{where}vehicle.turn_radius_m", limits.turn_radius_m, rule, remedy)
    if not limits.hovers:
        _check_circle(task, where)


def _check_circle(task: Task, where: str) -> None:
    """Check a plane's overshoot, turn and circle against the scan range."""
    limits, settings = task.limits, task.settings
    room = task.zone_search_clearance_m + task.envelope.lead_m + 2.0 * limits.turn_radius_m
    if room > task.end_radius_m:
        rule = (
            f"a plane holds on circles: with what it flies until then, a turn and {_least(task)} "
            f"it needs {room:.0f} m, and the scan range R = {settings.scan_range_m:g} m leaves "
            f"{task.end_radius_m:.0f} m"
        )
        remedy = "Lower it, vehicle.turn_radius_m or safety_distance_m, or raise scan_range_m."
        raise InputError(f"{where}vehicle.loiter_radius_m", limits.loiter_radius_m, rule, remedy)


def _check_ground(task: Task, where: str) -> None:
    """Without a scanner the lowest path must clear the stated ground."""
    ground_m = task.stated_ground_amsl_m
    if ground_m is None:
        return
    floor_m, (lowest_m, _) = task.limits.floor_amsl_m, task.band_amsl_m
    least_m = ground_m + task.search_clearance_m - (lowest_m - floor_m)
    if floor_m < least_m:
        rule = (
            f"the ground reaches terrain.highest_amsl_m = {ground_m:g}, and no path lies "
            f"nearer to it than d_s and the vehicle's errors"
        )
        remedy = f"Raise it to {math.ceil(least_m)}, or lower planner.safety_distance_m."
        raise InputError(f"{where}altitude.floor_amsl_m", floor_m, rule, remedy)


_OF_TASKS = (_check_map, _check_scan_distance, _check_turns, _check_ground)


def _too_tight(speed_m_s: float, radius_m: float, *, hovers: bool) -> str:
    lateral = speed_m_s**2 / radius_m
    at_speed = f"at V = {speed_m_s:g} m/s it asks for"
    if hovers:
        too_much = lateral > _MAX_LATERAL_M_S2
        return f"{at_speed} {lateral:.3g} m/s2 sideways, over 2 g" if too_much else ""
    bank = math.degrees(math.atan(lateral / _GRAVITY_M_S2))
    too_much = bank > _MAX_BANK_DEG
    return f"{at_speed} {bank:.0f} degrees of bank, over {_MAX_BANK_DEG:g}" if too_much else ""
