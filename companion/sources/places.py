"""Places, zones and radars of a mission file, in its local frame.

They are given in metres from the origin, or in degrees.
"""

import math

from companion.errors import InputError
from companion.geodesy import LocalFrame, parts_within, short_way, wrap_deg
from companion.planner import rules
from companion.planner.settings import Task
from companion.sources.mission_schema import MissionRadarTable, MissionTable, PlaceTable, ZoneTable
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone, Zone

Place = tuple[float, float]
"""North, east, metres; or latitude, longitude, degrees."""

_FARTHEST_M = 1e6
"""From the origin: beyond, the local frame is too far from a map."""
_AROUND_M = 50e3
"""Of what is drawn on a larger scale, the part within this of the map: farther than any distance
that is asked of a zone."""
_PER_DEGREE_M = 111e3
_MAP_DEG = 5.0  # more than any map reaches from its origin
_STRAIGHT_M = 2000.0
"""An edge that is straight in degrees is, at 60 degrees of latitude, 0.15 m off over this."""


def place_of(table: PlaceTable, frame: LocalFrame, field: str) -> Place:
    """North and east of a place, however it is given.  Raises InputError about the field."""
    metres = {"north_m": table.north_m, "east_m": table.east_m}
    degrees = {"latitude_deg": table.latitude_deg, "longitude_deg": table.longitude_deg}
    in_metres, in_degrees = (
        any(value is not None for value in pair.values()) for pair in (metres, degrees)
    )
    if in_metres and in_degrees:
        rule = "a place is given by north_m and east_m, or by latitude_deg and longitude_deg"
        raise InputError(field, [*metres.values(), *degrees.values()], rule, "Remove one pair.")
    for key, value in (degrees if in_degrees else metres).items():
        if value is None:
            remedy = f"Add {key}; see docs/files.md."
            raise InputError(f"{field}.{key}", None, "it is missing", remedy)
    if table.latitude_deg is None or table.longitude_deg is None:
        assert table.north_m is not None
        assert table.east_m is not None
        return table.north_m, table.east_m
    place = frame.to_local_m(table.latitude_deg, table.longitude_deg)
    if not _is_near(place):
        shown = [table.latitude_deg, table.longitude_deg]
        raise InputError(field, shown, "it lies more than 1,000 km from the origin", "Correct it.")
    return place


def _is_near(place_ne_m: Place) -> bool:
    return math.hypot(*place_ne_m) <= _FARTHEST_M  # false for what is no number


def radar_of(radar: MissionRadarTable, frame: LocalFrame, field: str) -> Radar:
    """The radar that a table means.  Raises InputError about the field."""
    centre = (*place_of(radar, frame, field), radar.altitude_amsl_m)
    return Radar(name=radar.name, centre_nea_m=centre, range_m=radar.range_m)


def zones_of(
    model: MissionTable, task: Task, frame: LocalFrame, where: str
) -> tuple[tuple[Zone, ...], str]:
    """The zones that matter, and how many keep-outs were left out that lie away from the map."""
    found, far = list[Zone](), 0
    for key, tables in {"keep_outs": model.keep_outs, "keep_ins": model.keep_ins}.items():
        keep_in = key == "keep_ins"
        for index, table in enumerate(tables):
            field = f"{where}: {key}[{index}]"
            made = _zone(table, task, frame, field, keep_in=keep_in)
            if made is None and keep_in:
                rule = "all of the map lies outside of it, more than 1,000 km from its corners"
                raise InputError(field, table.name, rule, "Remove it, or correct it.")
            if made is None or not (keep_in or _touches(made[0], task)):
                far += 1
                continue
            zone, corners = made
            if isinstance(zone, PolygonZone):
                rules.refuse(rules.of_polygon(corners, field, zone.name))
            found.append(zone)
    note = f"{far} of {len(model.keep_outs)} keep-outs lie away from the map" if far else ""
    return tuple(found), note


_Made = tuple[Zone, tuple[Place, ...]]
"""A zone, and its corners as they are given, if it has any."""


def _zone(
    table: ZoneTable, task: Task, frame: LocalFrame, field: str, *, keep_in: bool
) -> _Made | None:
    """The zone, or None if nothing of it comes near the map, and it is far away."""
    shapes = (table.radius_m, table.vertices_m, table.vertices_deg)
    placed = any(
        value is not None
        for value in (table.north_m, table.east_m, table.latitude_deg, table.longitude_deg)
    )
    if sum(shape is not None for shape in shapes) != 1 or placed != (table.radius_m is not None):
        word = "keep-in" if keep_in else "keep-out"
        remedy = (
            "Give a place (north_m and east_m, or latitude_deg and longitude_deg) and radius_m, or "
            "three or more corners: vertices_m [north, east] or vertices_deg [latitude, longitude]."
        )
        raise InputError(field, table.name, f"a {word} is a circle or a polygon", remedy)
    if table.radius_m is not None:
        return _circle(table, table.radius_m, task, frame, field, keep_in=keep_in)
    if table.vertices_m is not None:
        corners = tuple((north, east) for north, east in table.vertices_m)
        return PolygonZone(name=table.name, vertices_ne_m=corners, keep_in=keep_in), corners
    return _polygon_in_degrees(table, task, frame, field, keep_in=keep_in)


def _circle(
    table: ZoneTable, radius_m: float, task: Task, frame: LocalFrame, field: str, *, keep_in: bool
) -> _Made | None:
    if table.latitude_deg is not None and table.longitude_deg is not None:
        away_m = math.hypot(*frame.to_local_m(table.latitude_deg, table.longitude_deg))
        if not away_m <= _FARTHEST_M:  # nor is what is no number
            farthest_m = math.hypot(*(max(map(abs, span)) for span in _reach_m(task)))
            if not away_m <= farthest_m + radius_m:
                return None
            shown = [table.latitude_deg, table.longitude_deg]
            rule = "its centre lies more than 1,000 km from the origin, and it reaches the map"
            raise InputError(field, shown, rule, "Draw its edge near the mission as a polygon.")
    north, east = place_of(table, frame, field)
    zone = CircleZone(
        name=table.name, north_m=north, east_m=east, radius_m=radius_m, keep_in=keep_in
    )
    return zone, ()


def _reach_m(task: Task) -> tuple[tuple[float, float], tuple[float, float]]:
    """The map and what is near enough to count: lowest and highest north, west and east."""
    limits, reach = task.limits, task.zone_search_clearance_m
    north, east = limits.north_m, limits.east_m
    return (north[0] - reach, north[1] + reach), (east[0] - reach, east[1] + reach)


def _polygon_in_degrees(
    table: ZoneTable, task: Task, frame: LocalFrame, field: str, *, keep_in: bool
) -> _Made | None:
    degrees = [(latitude, longitude) for latitude, longitude in table.vertices_deg or []]
    for number, (latitude, longitude) in enumerate(degrees):
        if abs(latitude) > 90.0:
            rule = "out of range: latitude comes first, -90 to 90"
            shown = [latitude, longitude]
            raise InputError(f"{field}.vertices_deg[{number}]", shown, rule, "Swap them.")
    places = [frame.to_local_m(*place) for place in degrees]
    are_near = [_is_near(place) for place in places]
    checked = tuple(places)
    if not all(are_near):
        north, east = _reach_m(task)
        part = _part_near(degrees, frame, north, east, table.name, field)
        if part is None:
            return None
        if any(are_near):
            rule = "some of it lies more than 1,000 km from the origin"
            raise InputError(field, table.name, rule, "Give only the part near the mission.")
        drawn = short_way(degrees) or []
        checked = tuple((a * _PER_DEGREE_M, b * _PER_DEGREE_M) for a, b in drawn)
        degrees, places = part, [frame.to_local_m(*place) for place in part]
    corners = _straight_in_degrees(degrees, places, frame)
    return PolygonZone(name=table.name, vertices_ne_m=corners, keep_in=keep_in), checked


def _part_near(
    degrees: list[Place],
    frame: LocalFrame,
    north_m: tuple[float, float],
    east_m: tuple[float, float],
    name: str,
    field: str,
) -> list[Place] | None:
    """Of a polygon with corners far away, the part about the map; None if it does not touch it.

    An edge goes the short way around the Earth, unless the other way is the one that touches the
    map: then nobody can tell.
    """

    def within(wider_m: float, drawn: list[Place]) -> list[list[Place]]:
        spans = [(low - wider_m, high + wider_m) for low, high in (north_m, east_m)]
        return parts_within(drawn, frame, spans[0], spans[1])

    drawn = short_way(degrees)
    if drawn is not None and within(0.0, drawn):
        parts = within(_AROUND_M, drawn)
        if len(parts) == 1:
            return parts[0]
        rule = "it goes all around the Earth, to both sides of the map"
        raise InputError(field, name, rule, "Give only the part near the mission.")
    following = [*degrees[1:], *degrees[:1]]
    jumps = [abs(b[1] - a[1]) > 180.0 for a, b in zip(degrees, following, strict=True)]
    if any(jumps) and (within(0.0, degrees) or (drawn is None and _is_poleward(degrees, frame))):
        k = jumps.index(True)
        rule = f"the edge from its corner {k} (from 0) may go either way around the Earth"
        raise InputError(field, name, rule, "Give only the part near the mission.")
    return None


def _is_poleward(degrees: list[Place], frame: LocalFrame) -> bool:
    """Whether the origin may lie on the pole's side of what goes around one."""
    side = math.copysign(1.0, sum(latitude for latitude, _ in degrees))
    lowest_deg = min(side * latitude for latitude, _ in degrees)
    return side * frame.latitude_deg >= lowest_deg - _MAP_DEG


def _straight_in_degrees(
    degrees: list[Place], places: list[Place], frame: LocalFrame
) -> tuple[Place, ...]:
    """Corners in metres, with more of them on long edges: these are straight in degrees."""
    found: list[Place] = []
    for k, (latitude, longitude) in enumerate(degrees):
        following = (k + 1) % len(degrees)
        pieces = math.ceil(max(math.dist(places[k], places[following]) / _STRAIGHT_M, 1.0))
        north = degrees[following][0] - latitude
        east = wrap_deg(degrees[following][1] - longitude)
        found.append(places[k])
        for step in range(1, pieces):
            part = step / pieces
            found.append(frame.to_local_m(latitude + part * north, longitude + part * east))
    return tuple(found)


def _touches(zone: Zone, task: Task) -> bool:
    """Whether a keep-out comes near the map."""
    (south_m, north_m), (west_m, east_m) = _reach_m(task)
    reach = 0.0
    if isinstance(zone, CircleZone):
        north, east = [zone.north_m], [zone.east_m]
        reach = zone.radius_m
    else:
        north = [corner[0] for corner in zone.vertices_ne_m]
        east = [corner[1] for corner in zone.vertices_ne_m]
    if not north:
        return True  # it will be refused
    return (
        min(north) - reach <= north_m
        and max(north) + reach >= south_m
        and min(east) - reach <= east_m
        and max(east) + reach >= west_m
    )
