"""Rules between the numbers of a task, for all sources of settings.

Mission files, targets from a ground station or from the vehicle, and replays under other settings
are all checked by them.  A broken rule is an InputError whose field is named as in mission.toml.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.planner.settings import Task

Place = tuple[float, float]
Broken = tuple[str, object, str, str]
"""A rule that is broken: the field, its value, the rule, and the remedy."""

_GRAVITY_M_S2 = 9.81  # standard gravity (ISO 80000-3), to 0.04 %
MAX_CELLS = 2.5e7  # of a map: 200 MB for each array of altitudes, and a plan holds several
_MAX_LATERAL_M_S2 = 20.0
"""Of a copter: 2 g, a tilt of 64 degrees; more is a slip of the pen and no way to fly."""
_MAX_BANK_DEG = 45.0  # of a plane: ArduPlane's default roll limit; PX4's is 50 degrees
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


def refuse(broken: Iterable[Broken], where: str = "") -> None:
    """Raise InputError for the first that is broken; where comes before the field ("file: ")."""
    for field, value, rule, remedy in broken:
        raise InputError(f"{where}{field}", value, rule, remedy)


def newly_broken(before: Task, after: Task, target_ne_m: Place) -> InputError | None:
    """The first rule that a change of a task breaks; None: it breaks none.

    Fields that broke a rule before do not prevent a change: the vehicle's fence may exclude a
    target, and home may be at the edge of the map.
    """
    was, now = (
        [*of_task(task), *of_target(task, target_ne_m, "targets[0]")] for task in (before, after)
    )
    known = {field for field, *_ in was}
    return next((InputError(*broken) for broken in now if broken[0] not in known), None)


def target_refusal(task: Task, target_ne_m: Place) -> str:
    """Why a place cannot be a target, as text; empty if it can."""
    return next((f"the target: {rule}" for _, _, rule, _ in of_target(task, target_ne_m, "")), "")


def of_area(north_m: tuple[float, float], east_m: tuple[float, float]) -> Iterator[Broken]:
    """A map has an inside."""
    for axis, (low, high) in (("north", north_m), ("east", east_m)):
        if low >= high:
            rule = f"it must be more than area.{axis}_min_m = {low:g}"
            yield f"area.{axis}_max_m", high, rule, "Swap or widen them."


def of_task(task: Task) -> Iterator[Broken]:
    """All rules of a task, in the order in which they are told."""
    limits, settings = task.limits, task.settings
    range_m, speed, d_s = settings.scan_range_m, limits.speed_m_s, settings.safety_distance_m
    floor, ceiling, end_m = limits.floor_amsl_m, limits.ceiling_amsl_m, task.end_radius_m

    yield from of_area(limits.north_m, limits.east_m)
    if ceiling - floor <= _MIN_BAND_ERRORS * task.error_m:
        rule = (
            f"it must lie above altitude.floor_amsl_m = {floor:g} by more than 4 times "
            "vehicle.tracking_error_m + navigation_error_m"
        )
        yield "altitude.ceiling_amsl_m", ceiling, rule, "Widen the band."
    sides_m = (high - low for low, high in (limits.north_m, limits.east_m))
    if math.prod(sides_m) / task.cell_m**2 > MAX_CELLS:
        rule = f"the map has more than {MAX_CELLS:.0e} cells of R / 80"
        yield "planner.scan_range_m", range_m, rule, "Raise it, or make [area] smaller."

    given_m, least_m = settings.scan_distance_m, task.shortest_scan_distance_m
    if given_m is not None and given_m < least_m:
        rule = f"eq. 4: L must be at least V (T + scan time) + tail = {least_m:g} m"
        remedy = "Leave scan_distance_m out, or lower planning_time_s or speed_m_s."
        yield "planner.scan_distance_m", given_m, rule, remedy
    if task.scan_distance_m > _MOST_OF_SIGHT * end_m:
        rule = (
            f"eq. 4: with V = {speed:g} m/s and d_s = {d_s:g} m it needs L = "
            f"{task.scan_distance_m:g} m, too much for R = {range_m:g} m "
            f"(at most {_MOST_OF_SIGHT * end_m:g} m)"
        )
        remedy = "Lower planning_time_s, speed_m_s or safety_distance_m, or raise scan_range_m."
        yield "planner.planning_time_s", settings.planning_time_s, rule, remedy
    period_s = settings.position_period_s
    least_s = 0.0 if settings.is_near else _SCAN_REQUESTS * period_s  # there is no TERRAIN_REQUEST
    if settings.scan_time_s < least_s:
        rule = f"a scan takes {_SCAN_REQUESTS} requests, one a position ({period_s:g} s)"
        remedy = f"Raise it to {least_s:g}, or raise vehicle.position_rate_hz."
        yield "planner.scan_time_s", settings.scan_time_s, rule, remedy

    turns = {"turn_radius_m": limits.turn_radius_m}
    if not limits.hovers:
        turns["loiter_radius_m"] = limits.loiter_radius_m
    for key, radius_m in turns.items():
        if too_tight := _too_tight(speed**2 / radius_m, hovers=limits.hovers):
            rule = f"at V = {speed:g} m/s it asks for {too_tight}"
            yield f"vehicle.{key}", radius_m, rule, "Raise it, or lower vehicle.speed_m_s."
    if limits.turn_radius_m > 0.5 * range_m:
        rule = f"a turn must fit into the scan range R = {range_m:g} m twice"
        remedy = "Lower it, or raise planner.scan_range_m."
        yield "vehicle.turn_radius_m", limits.turn_radius_m, rule, remedy
    room_m = task.zone_search_clearance_m + task.envelope.lead_m + 2.0 * limits.turn_radius_m
    if not limits.hovers and room_m > end_m:
        rule = (
            f"a plane holds on circles: with what it flies until then, a turn and {_least(task)} "
            f"it needs {room_m:.0f} m, and the scan range R = {range_m:g} m leaves {end_m:.0f} m"
        )
        remedy = "Lower it, vehicle.turn_radius_m or safety_distance_m, or raise scan_range_m."
        yield "vehicle.loiter_radius_m", limits.loiter_radius_m, rule, remedy

    if (ground_m := task.stated_ground_amsl_m) is not None:
        least_m = ground_m + task.search_clearance_m - (task.band_amsl_m[0] - floor)
        if floor < least_m:
            rule = (
                f"the ground reaches terrain.highest_amsl_m = {ground_m:g}, and no path lies "
                "nearer to it than d_s and the vehicle's errors"
            )
            remedy = f"Raise it to {math.ceil(least_m)}, or lower planner.safety_distance_m."
            yield "altitude.floor_amsl_m", floor, rule, remedy


def _too_tight(lateral_m_s2: float, *, hovers: bool) -> str:
    """What a turn asks for that is too much for the vehicle; empty if nothing is."""
    if hovers:
        too_much = lateral_m_s2 > _MAX_LATERAL_M_S2
        return f"{lateral_m_s2:.3g} m/s2 sideways, over 2 g" if too_much else ""
    bank = math.degrees(math.atan(lateral_m_s2 / _GRAVITY_M_S2))
    too_much = bank > _MAX_BANK_DEG
    return f"{bank:.0f} degrees of bank, over {_MAX_BANK_DEG:g}" if too_much else ""


def of_target(task: Task, target_ne_m: Place, field: str) -> Iterator[Broken]:
    """A target lies on the map, and where no zone forbids to be."""
    limits, kept_m = task.limits, task.zone_search_clearance_m
    inset_m = kept_m if task.settings.profile.verified else 0.0
    sides_m = {"north": limits.north_m, "east": limits.east_m}
    for value, (axis, (low, high)) in zip(target_ne_m, sides_m.items(), strict=True):
        if not low + inset_m <= value <= high - inset_m:
            rule = f"it lies outside the map, {low:g} to {high:g} m"
            if low <= value <= high:
                rule = f"it lies nearer than {_least(task)} to the edge of the map"
            yield f"{field}.{axis}_m", value, rule, "Move it, or widen [area]."
    for zone in task.zones:
        if (gap_m := float(zone.distance_m(*np.array(target_ne_m)))) < kept_m:
            keep, edge = ("keep-in", " the edge of") if zone.keep_in else ("keep-out", "")
            where = f"nearer than {_least(task)} to{edge}"
            if gap_m < 0.0:
                where = "outside" if zone.keep_in else "inside"
            rule = f"it lies {where} {keep} {zone.name!r}"
            yield field, list(target_ne_m), rule, "Move the target, or remove the zone."


def _least(task: Task) -> str:
    circle = "" if task.limits.hovers else ", and the circle that a plane holds on"
    return f"{task.zone_search_clearance_m:g} m (d_s and the vehicle's errors{circle})"


def of_polygon(vertices_ne_m: tuple[Place, ...], field: str, name: str) -> Iterator[Broken]:
    """A polygon has a clear inside."""
    corners = np.array(vertices_ne_m, dtype=np.float64).reshape(-1, 2)
    if len(set(vertices_ne_m)) < 3:
        remedy = "Give three or more different corners."
        yield field, name, "a polygon has three or more corners", remedy
    elif len(corners) > _MAX_CORNERS:
        yield field, name, f"it has more than {_MAX_CORNERS} corners", "Simplify it, outwards."
    elif (crossing := first_crossing(corners)) is not None:
        edges = f"the edges from its corners {crossing[0]} and {crossing[1]} (from 0) cross"
        remedy = "Draw it so that it does not cross itself."
        yield field, name, f"{edges}, so it has no clear inside", remedy
    elif abs(_area_m2(corners - corners[0])) < _MIN_AREA_M2:
        yield field, name, "it has no area", "Give corners that do not lie on one line."


def _area_m2(corners: FloatArray) -> float:
    """Of a polygon whose first corner is the origin; signed.  (corners, 2)."""
    north, east = corners.T
    return 0.5 * float(north[:-1] @ east[1:] - east[:-1] @ north[1:])


def first_crossing(corners_ne_m: FloatArray) -> tuple[int, int] | None:
    """The first two edges of a closed polygon that cross, if any do.

    (corners, 2) -> the corners that they begin at, or None.  Edges that only touch do not cross.
    """
    begins, ends = corners_ne_m, np.roll(corners_ne_m, -1, axis=0)
    for k in range(len(begins) - 2):
        others = slice(k + 2, len(begins) - (k == 0))
        a, b, c, d = begins[k], ends[k], begins[others], ends[others]
        crosses = (_side(a, b, c) * _side(a, b, d) < 0.0) & (_side(c, d, a) * _side(c, d, b) < 0.0)
        if crosses.any():
            return k, k + 2 + int(crosses.argmax())
    return None


def _side(a: FloatArray, b: FloatArray, points: FloatArray) -> FloatArray:
    """On which side of the line from a to b points lie: the sign.  (..., 2) x3 -> (...)."""
    along, off = b - a, points - a
    return np.sign(along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0])
