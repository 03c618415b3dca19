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
_AROUND_M: Final = 50e3
"""Of what is drawn on a larger scale, the part within this of the map: farther than any distance
that is asked of a zone."""
_PER_DEGREE_M: Final = 111e3
_MAP_DEG: Final = 5.0  # more than any map reaches from its origin
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
    for number, table in enumerate(model.keep_outs):
        zone = _zone(table, frame, spans, f"{where}: keep_outs[{number}]", keep_in=False)
        if zone is None or not _touches(zone, spans):
            far += 1
        else:
            found.append(zone)
    for number, table in enumerate(model.keep_ins):
        field = f"{where}: keep_ins[{number}]"
        zone = _zone(table, frame, spans, field, keep_in=True)
        if zone is None:
            rule = "all of the map lies outside of it, more than 1,000 km from its corners"
            raise InputError(field, table.name, rule, "Remove it, or correct it.")
        found.append(zone)
    note = f"{far} of {len(model.keep_outs)} keep-outs lie away from the map" if far else ""
    return tuple(found), note


def _zone(
    table: ZoneTable, frame: LocalFrame, spans: tuple[_Span, _Span], field: str, *, keep_in: bool
) -> Zone | None:
    """The zone, or None if nothing of it comes near the map, and it is far away."""
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
        corners = checked = tuple((north, east) for north, east in table.vertices_m)
    else:
        degrees = [(latitude, longitude) for latitude, longitude in table.vertices_deg or []]
        checked = tuple(frame.to_local_m(*place) for place in degrees)
        are_near = [_is_near(place) for place in checked]
        if not all(are_near):
            part = _part_near(degrees, frame, spans, table.name, field)
            if part is None:
                return None
            if any(are_near):
                rule = "some of it lies more than 1,000 km from the origin"
                raise InputError(field, table.name, rule, "Give only the part near the mission.")
            drawn = short_way(degrees) or []
            checked = tuple((a * _PER_DEGREE_M, b * _PER_DEGREE_M) for a, b in drawn)
            degrees = part
        corners = _straight_in_degrees(degrees, frame)
    zone = PolygonZone(name=table.name, vertices_ne_m=corners, keep_in=keep_in)
    if keep_in or _touches(zone, spans):
        rules.refuse(rules.of_polygon(checked, field, zone.name))
    return zone


def _is_near(place_ne_m: Place) -> bool:
    return math.hypot(*place_ne_m) <= _FARTHEST_M  # false for what is no number


def _wider(span_m: _Span, by_m: float) -> _Span:
    return span_m[0] - by_m, span_m[1] + by_m


def _part_near(
    degrees: list[Place], frame: LocalFrame, spans: tuple[_Span, _Span], name: str, field: str
) -> list[Place] | None:
    """Of a polygon with corners far away, the part about the map; None if it does not touch it.

    An edge goes the short way around the Earth, unless the other way is the one that touches the
    map: then nobody can tell.
    """
    drawn = short_way(degrees)
    if drawn is not None and parts_within(drawn, frame, *spans):
        parts = parts_within(drawn, frame, *(_wider(span, _AROUND_M) for span in spans))
        if len(parts) == 1:
            return parts[0]
        rule = "it goes all around the Earth, to both sides of the map"
        raise InputError(field, name, rule, "Give only the part near the mission.")
    edges = zip(degrees, [*degrees[1:], *degrees[:1]], strict=True)
    jumps = [abs(b[1] - a[1]) > 180.0 for a, b in edges]
    if any(jumps) and (
        parts_within(degrees, frame, *spans) or (drawn is None and _is_poleward(degrees, frame))
    ):
        k = jumps.index(True)
        rule = f"the edge from its corner {k} (from 0) may go either way around the Earth"
        raise InputError(field, name, rule, "Give only the part near the mission.")
    return None


def _is_poleward(degrees: list[Place], frame: LocalFrame) -> bool:
    """Whether the origin may lie on the pole's side of what goes around one."""
    side = math.copysign(1.0, sum(latitude for latitude, _ in degrees))
    lowest_deg = min(side * latitude for latitude, _ in degrees)
    return side * frame.latitude_deg >= lowest_deg - _MAP_DEG


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
