"""Rules between the numbers of a task, for all sources of settings.

Mission files, targets from a ground station or from the vehicle, and replays under other settings
are all checked by them.  A broken rule is an InputError whose field is named as in mission.toml.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.planner.settings import Place, Task

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
_LEAST_OF_SPEED = 0.5
"""Of V: who asks for a speed is not given less than half of it, but told what stands against it."""
_STEP_M_S = 0.1  # speeds are told to people, who read one decimal
_MIN_BAND_ERRORS = 4.0
"""Between floor and ceiling: paths keep 1.1 errors from either (`Task.band_amsl_m`), and as much
again is left to climb in."""
_MIN_AREA_M2 = 1.0
"""Corners of a line have that much by the rounding of degrees to 1e-7 (1 cm) over 100 m."""
_MAX_CORNERS = 2000  # of a polygon: a border of more is of no use at the scale of a flight


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


def slowed_to_sight(task: Task) -> Task:
    """The task at the highest speed, V or less, at which eq. 4 leaves a copter enough of R.

    It turns as tightly as its lateral acceleration lets it there.  A task that needs less than half
    of V, turns too tightly or names its L stays as it is, and so does a plane's: see `of_task`.
    """
    limits, settings = task.limits, task.settings
    may = limits.hovers and settings.profile.verified and settings.scan_distance_m is None
    if not may or _sees_enough(task) or _of_turn(limits, "turn_radius_m")[0]:
        return task
    least, most = (share * limits.speed_m_s / _STEP_M_S for share in (_LEAST_OF_SPEED, 1.0))
    steps = range(math.floor(most), math.ceil(least) - 1, -1)
    slower = (task.at_speed(round(step * _STEP_M_S, 1)) for step in steps)
    return next((slowed for slowed in slower if _sees_enough(slowed)), task)


def _sees_enough(task: Task) -> bool:
    """Whether a leg gains as much as it should, by eq. 4."""
    return task.scan_distance_m <= _MOST_OF_SIGHT * task.end_radius_m


def of_area(north_m: tuple[float, float], east_m: tuple[float, float]) -> Iterator[Broken]:
    """A map has an inside."""
    for axis, (low, high) in (("north", north_m), ("east", east_m)):
        if low >= high:
            rule = f"it must be more than area.{axis}_min_m = {low:g}"
            yield f"area.{axis}_max_m", high, rule, "Swap or widen them."


def of_task(task: Task) -> Iterator[Broken]:
    """All rules of a task that are broken, in the order in which they are told."""
    limits, settings, end_m = task.limits, task.settings, task.end_radius_m
    range_m, speed, d_s = settings.scan_range_m, limits.speed_m_s, settings.safety_distance_m
    (south, north), (west, east) = limits.north_m, limits.east_m
    floor, ceiling, turn_m = limits.floor_amsl_m, limits.ceiling_amsl_m, limits.turn_radius_m
    asked_m, least_m = settings.scan_distance_m, task.shortest_scan_distance_m
    sight_m, period_s = max(0.0, _MOST_OF_SIGHT * end_m), settings.position_period_s
    scan_s = 0.0 if settings.is_near else _SCAN_REQUESTS * period_s  # there is no TERRAIN_REQUEST
    room_m = task.zone_search_clearance_m + task.envelope.lead_m + 2.0 * turn_m
    ground_m = -math.inf if task.stated_ground_amsl_m is None else task.stated_ground_amsl_m
    over_m = ground_m + task.search_clearance_m - (task.band_amsl_m[0] - floor)

    yield from of_area(limits.north_m, limits.east_m)
    table = (
        (ceiling - floor <= _MIN_BAND_ERRORS * task.error_m, "altitude.ceiling_amsl_m", ceiling,
         f"it must lie more than {_MIN_BAND_ERRORS * task.error_m:g} m above altitude.floor_amsl_m "
         f"= {floor:g}: 4 times vehicle.tracking_error_m + navigation_error_m",
         "Widen the band."),
        ((north - south) * (east - west) / task.cell_m**2 > MAX_CELLS, "planner.scan_range_m",
         range_m, f"the map has more than {MAX_CELLS:.0e} cells of R / 80",
         "Raise it, or make [area] smaller."),
        (asked_m is not None and asked_m < least_m, "planner.scan_distance_m", asked_m,
         f"eq. 4: L must be at least V (T + scan time) + tail = {least_m:g} m",
         "Leave scan_distance_m out, or lower planning_time_s or speed_m_s."),
        (not _sees_enough(task), "planner.planning_time_s", settings.planning_time_s,
         f"eq. 4: with V = {speed:g} m/s and d_s = {d_s:g} m it needs L = "
         f"{task.scan_distance_m:g} m, too much for R = {range_m:g} m (at most {sight_m:g} m)",
         "Lower planning_time_s, speed_m_s or safety_distance_m, or raise scan_range_m."),
        (settings.scan_time_s < scan_s, "planner.scan_time_s", settings.scan_time_s,
         f"a scan takes {_SCAN_REQUESTS} requests, one a position ({period_s:g} s)",
         f"Raise it to {scan_s:g}, or raise vehicle.position_rate_hz."),
        *(_of_turn(limits, key) for key in ("turn_radius_m", "loiter_radius_m")),
        (turn_m > 0.5 * range_m, "vehicle.turn_radius_m", turn_m,
         f"a turn must fit into the scan range R = {range_m:g} m twice",
         "Lower it, or raise planner.scan_range_m."),
        (not limits.hovers and room_m > end_m, "vehicle.loiter_radius_m", limits.loiter_radius_m,
         f"a plane holds on circles: with what it flies until then, a turn and {_least(task)} "
         f"it needs {room_m:.0f} m, and the scan range R = {range_m:g} m leaves {end_m:.0f} m",
         "Lower it, vehicle.turn_radius_m or safety_distance_m, or raise scan_range_m."),
        (floor < over_m, "altitude.floor_amsl_m", floor,
         f"the ground reaches terrain.highest_amsl_m = {ground_m:g}, and no path lies nearer to "
         "it than d_s and the vehicle's errors",
         f"Raise it to {math.ceil(max(over_m, floor))}, or lower planner.safety_distance_m."),
    )  # fmt: skip
    for is_broken, field, value, rule, remedy in table:
        if is_broken:
            yield field, value, rule, remedy


def _of_turn(limits: Limits, key: str) -> tuple[bool, str, object, str, str]:
    """A turn asks for no more than the vehicle can.  A copter's loiter radius is 0: no turn."""
    speed, radius_m = limits.speed_m_s, getattr(limits, key)
    sideways_m_s2 = speed**2 / radius_m if radius_m else 0.0
    bank_deg = math.degrees(math.atan(sideways_m_s2 / _GRAVITY_M_S2))
    too_much = f"{bank_deg:.0f} degrees of bank, over {_MAX_BANK_DEG:g}"
    is_broken = bank_deg > _MAX_BANK_DEG
    if limits.hovers:
        too_much = f"{sideways_m_s2:.3g} m/s2 sideways, over 2 g"
        is_broken = sideways_m_s2 > _MAX_LATERAL_M_S2
    rule = f"at V = {speed:g} m/s it asks for {too_much}"
    return is_broken, f"vehicle.{key}", radius_m, rule, "Raise it, or lower vehicle.speed_m_s."


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
    north, east = (corners - corners[:1]).T
    if len(set(vertices_ne_m)) < 3:
        remedy = "Give three or more different corners."
        yield field, name, "a polygon has three or more corners", remedy
    elif len(corners) > _MAX_CORNERS:
        yield field, name, f"it has more than {_MAX_CORNERS} corners", "Simplify it, outwards."
    elif (crossing := first_crossing(corners)) is not None:
        edges = f"the edges from its corners {crossing[0]} and {crossing[1]} (from 0) cross"
        remedy = "Draw it so that it does not cross itself."
        yield field, name, f"{edges}, so it has no clear inside", remedy
    elif abs(north[:-1] @ east[1:] - east[:-1] @ north[1:]) < 2.0 * _MIN_AREA_M2:
        yield field, name, "it has no area", "Give corners that do not lie on one line."


def first_crossing(corners_ne_m: FloatArray) -> tuple[int, int] | None:
    """The corners that the first two edges of a closed polygon begin at that cross, if any do.

    (corners, 2).  Edges that only touch do not cross.
    """
    import shapely  # no plan needs it

    edges = shapely.linestrings(np.stack([corners_ne_m, np.roll(corners_ne_m, -1, axis=0)], axis=1))
    pairs = shapely.STRtree(edges).query(edges, predicate="crosses").T.tolist()
    return min(((one, other) for one, other in pairs), default=None)
