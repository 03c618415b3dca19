"""Places, zones and radars of a mission file, in its local frame.

They are given in metres from the origin, or in degrees.
"""

import math
from typing import Final

from companion.errors import InputError
from companion.geodesy import LocalFrame, parts_within, short_way, wrap_deg
from companion.planner import rules
from companion.planner.settings import Task
from companion.sources.mission_schema import MissionRadarTable, MissionTable, PlaceTable, ZoneTable
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone, Zone

Place = tuple[float, float]
"""North, east, metres; or latitude, longitude, degrees."""
_Span = tuple[float, float]
"""From and to, metres."""

_FARTHEST_M: Final = 1e6
"""From the origin: beyond, the local frame is too far from a map."""
_STRAIGHT_M: Final = 2000.0
"""An edge that is straight in degrees is, at 60 degrees of latitude, 0.15 m off over this."""


def place_of(table: PlaceTable | ZoneTable, frame: LocalFrame, field: str) -> Place:
    """North and east of a place, however it is given.  Raises InputError about the field."""
    if table.degrees is None:
        assert table.north_m is not None
        assert table.east_m is not None
        return table.north_m, table.east_m
    place = frame.to_local_m(*table.degrees)
    if not _is_near(place):
        rule = "it lies more than 1,000 km from the origin"
        raise InputError(field, [*table.degrees], rule, "Correct it.")
    return place


def radar_of(radar: MissionRadarTable, frame: LocalFrame, field: str) -> Radar:
    """The radar that a table means.  Raises InputError about the field."""
    centre = (*place_of(radar, frame, field), radar.altitude_amsl_m)
    return Radar(name=radar.name, centre_nea_m=centre, range_m=radar.range_m)


def zones_of(
    model: MissionTable, task: Task, frame: LocalFrame, where: str
) -> tuple[tuple[Zone, ...], str]:
    """The zones that matter, and how many keep-outs were left out that lie away from the map."""
    limits, reach_m = task.limits, task.zone_search_clearance_m
    spans = _wider(limits.north_m, reach_m), _wider(limits.east_m, reach_m)
    found, far = list[Zone](), 0
    for kind, tables in (("keep_outs", model.keep_outs), ("keep_ins", model.keep_ins)):
        for number, table in enumerate(tables):
            field, keep_in = f"{where}: {kind}[{number}]", kind == "keep_ins"
            zone = _zone(table, frame, spans, field, keep_in=keep_in)
            if keep_in and zone is None:
                rule = "all of the map lies outside of it, more than 1,000 km from its corners"
                raise InputError(field, table.name, rule, "Remove it, or correct it.")
            if zone is not None and (keep_in or _touches(zone, spans)):
                found.append(zone)
            else:
                far += 1
    note = f"{far} of {len(model.keep_outs)} keep-outs lie away from the map" if far else ""
    return tuple(found), note


def _zone(
    table: ZoneTable, frame: LocalFrame, spans: tuple[_Span, _Span], field: str, *, keep_in: bool
) -> Zone | None:
    """The zone, or None if some of it is far away, and nothing of it comes near the map."""
    if table.radius_m is not None:
        if table.degrees is not None and not _is_near(place := frame.to_local_m(*table.degrees)):
            farthest_m = math.hypot(*(max(map(abs, span)) for span in spans))
            if not math.hypot(*place) <= farthest_m + table.radius_m:  # nor what is no number
                return None
            rule = "its centre lies more than 1,000 km from the origin, and it reaches the map"
            remedy = "Draw its edge near the mission as a polygon."
            raise InputError(field, [*table.degrees], rule, remedy)
        north, east = place_of(table, frame, field)
        return CircleZone(
            name=table.name, north_m=north, east_m=east, radius_m=table.radius_m, keep_in=keep_in
        )
    if table.vertices_m is not None:
        corners = drawn = tuple((north, east) for north, east in table.vertices_m)
    else:
        degrees = [(latitude, longitude) for latitude, longitude in table.vertices_deg or []]
        corners = tuple(frame.to_local_m(*place) for place in degrees)
        if not all(map(_is_near, corners)):
            ways = [each for each in (short_way(degrees), degrees) if each]  # around the Earth
            if len(ways) == 2 and not any(parts_within(each, frame, *spans) for each in ways):
                return None
            rule = "it may reach the map, and some of it lies more than 1,000 km from the origin"
            raise InputError(field, table.name, rule, "Give only the part near the mission.")
        drawn = _straight_in_degrees(degrees, frame)
    zone = PolygonZone(name=table.name, vertices_ne_m=drawn, keep_in=keep_in)
    if keep_in or _touches(zone, spans):
        rules.refuse(rules.of_polygon(corners, field, zone.name))
    return zone


def _is_near(place_ne_m: Place) -> bool:
    return math.hypot(*place_ne_m) <= _FARTHEST_M  # false for what is no number


def _wider(span_m: _Span, by_m: float) -> _Span:
    return span_m[0] - by_m, span_m[1] + by_m


def _straight_in_degrees(degrees: list[Place], frame: LocalFrame) -> tuple[Place, ...]:
    """Corners in metres, with more of them on long edges: these are straight in degrees."""
    places = [frame.to_local_m(*place) for place in degrees]
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


def _touches(zone: Zone, spans: tuple[_Span, _Span]) -> bool:
    """Whether a keep-out comes near the map; one of no corners, which will be refused, does."""
    if isinstance(zone, CircleZone):
        centre, reach_m = (zone.north_m, zone.east_m), zone.radius_m
        boxes = [_wider((at, at), reach_m) for at in centre]
    else:
        boxes = [(min(at), max(at)) for at in zip(*zone.vertices_ne_m, strict=True)]
    return all(
        low <= span[1] and high >= span[0]
        for (low, high), span in zip(boxes, spans, strict=bool(boxes))
    )
