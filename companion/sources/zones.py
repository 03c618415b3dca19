"""Places and zones of mission files, in degrees or in metres, and zones of GeoJSON files.

GeoJSON is as RFC 7946 has it: longitude before latitude, WGS84.  Its shapes are shapely's.
"""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import shapely
from pydantic import BaseModel, ConfigDict, Field
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from companion.errors import InputError
from companion.geodesy import LocalFrame, parts_within, short_way, straight_in_degrees
from companion.planner import rules
from companion.planner.rules import Broken
from companion.planner.settings import Place, Task
from companion.ranges import Altitude, Horizontal, Latitude, Longitude, Positive
from companion.sources.files import RawTable, json_table, plain
from companion.sources.tables import Table, validated
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone, Zone

Name = Annotated[str, Field(min_length=1, max_length=100)]
FARTHEST_M: Final = 1e6
"""From the origin: beyond, the local frame is too far from a map."""


class PlaceTable(Table):
    """A place: north and east of the origin, or latitude and longitude."""

    north_m: Horizontal | None = None
    east_m: Horizontal | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None

    @property
    def given(self) -> list[str]:
        """Which of them are given."""
        return [key for key in PlaceTable.model_fields if getattr(self, key) is not None]

    @property
    def degrees(self) -> tuple[float, float] | None:
        """Latitude and longitude, if it is given by these."""
        if self.latitude_deg is None or self.longitude_deg is None:
            return None
        return self.latitude_deg, self.longitude_deg

    def broken(self) -> Iterator[Broken]:
        """It is given by one of the pairs, and by all of that."""
        if self.given not in (["north_m", "east_m"], ["latitude_deg", "longitude_deg"]):
            rule = "a place is given by north_m and east_m, or by latitude_deg and longitude_deg"
            yield "", self.given, rule, "Give one of these pairs."

    def local_m(self, frame: LocalFrame) -> Place:
        """North and east of it, however it is given."""
        if self.degrees is None:
            return self.north_m or 0.0, self.east_m or 0.0
        return frame.to_local_m(*self.degrees)

    def place(self, frame: LocalFrame, field: str) -> Place:
        """Likewise.  Raises InputError about the field if the local frame does not go so far."""
        place = self.local_m(frame)
        if self.degrees is not None and not _is_near(place):
            rule = "it lies more than 1,000 km from the origin"
            raise InputError(field, [*self.degrees], rule, "Correct it.")
        return place


class TargetTable(PlaceTable):
    """A place to reach, at its altitude, or at any of the band."""

    name: Name | None = None
    altitude_amsl_m: Altitude | None = None


class RadarTable(PlaceTable):
    """A known radar."""

    name: str
    altitude_amsl_m: Altitude
    range_m: Positive

    def radar(self, frame: LocalFrame, field: str) -> Radar:
        """As the planner has it.  Raises InputError about the field."""
        centre = (*self.place(frame, field), self.altitude_amsl_m)
        return Radar(name=self.name, centre_nea_m=centre, range_m=self.range_m)


class ZoneTable(PlaceTable):
    """A zone that is never entered, or never left: a circle or a polygon."""

    name: str
    radius_m: Positive | None = None
    vertices_m: list[Annotated[list[Horizontal], Field(min_length=2, max_length=2)]] | None = None
    vertices_deg: list[Annotated[list[Longitude], Field(min_length=2, max_length=2)]] | None = None
    """Latitude, longitude of each corner."""

    def broken(self) -> Iterator[Broken]:
        """It is a circle about a place, or a polygon."""
        shapes = [self.radius_m, self.vertices_m, self.vertices_deg]
        if shapes.count(None) != 2 or bool(self.given) != (self.radius_m is not None):
            remedy = "Give a place and radius_m, or three or more corners; see docs/files.md."
            yield "", self.name, "a zone is a circle or a polygon", remedy
        elif self.given:
            yield from super().broken()
        for number, (latitude, longitude) in enumerate(self.vertices_deg or []):
            if abs(latitude) > 90.0:
                rule = "out of range: latitude comes first, -90 to 90"
                yield f"vertices_deg[{number}]", [latitude, longitude], rule, "Swap them."


def zones_of(
    keep_outs: Sequence[ZoneTable], keep_ins: Sequence[ZoneTable], task: Task, frame: LocalFrame
) -> tuple[tuple[Zone, ...], str]:
    """The zones that matter, and how many keep-outs were left out that lie away from the map."""
    (south, north), (west, east) = task.limits.north_m, task.limits.east_m
    by_m, kept = task.zone_search_clearance_m, list[Zone]()
    map_ne_m = shapely.box(south - by_m, west - by_m, north + by_m, east + by_m)
    for number, table in enumerate(keep_outs):
        zone = _zone(table, frame, map_ne_m, f"keep_outs[{number}]", keep_in=False)
        kept += [] if zone is None else [zone]
    far = len(keep_outs) - len(kept)
    for number, table in enumerate(keep_ins):
        zone = _zone(table, frame, map_ne_m, field := f"keep_ins[{number}]", keep_in=True)
        if zone is None:
            rule = "all of the map lies outside of it, more than 1,000 km from its corners"
            raise InputError(field, table.name, rule, "Remove it, or correct it.")
        kept.append(zone)
    note = f"{far} of {len(keep_outs)} keep-outs lie away from the map" if far else ""
    return tuple(kept), note


def _zone(
    table: ZoneTable, frame: LocalFrame, map_ne_m: shapely.Polygon, field: str, *, keep_in: bool
) -> Zone | None:
    """The zone; None: it is a keep-out, or lies beyond the local frame, and is away from the map.

    map_ne_m: with what comes near it.  Raises InputError about the field.
    """
    south, west, north, east = map_ne_m.bounds
    if (radius_m := table.radius_m) is not None:
        at = table.local_m(frame)
        if table.degrees is not None and not _is_near(at):
            farthest_m = math.hypot(max(-south, north), max(-west, east))
            if not math.hypot(*at) <= farthest_m + radius_m:  # nor what is no number
                return None
            raise _too_far(table, field)
        beside_m = max(south - at[0], at[0] - north, west - at[1], at[1] - east)
        if beside_m > radius_m and not keep_in:
            return None
        return CircleZone(
            name=table.name, north_m=at[0], east_m=at[1], radius_m=radius_m, keep_in=keep_in
        )
    if table.vertices_m is not None:
        corners = drawn = tuple((north, east) for north, east in table.vertices_m)
    else:
        degrees = [(latitude, longitude) for latitude, longitude in table.vertices_deg or []]
        corners, onwards = tuple(frame.to_local_m(*place) for place in degrees), short_way(degrees)
        if onwards is None or not all(map(_is_near, corners)):
            spans = (south, north), (west, east)
            ways = (onwards, degrees)  # around the Earth
            if onwards and not any(parts_within(ring, frame, *spans) for ring in ways if ring):
                return None
            raise _too_far(table, field)
        drawn = tuple(frame.to_local_m(*place) for place in straight_in_degrees(onwards))
    if drawn and not keep_in and shapely.MultiPoint(drawn).envelope.disjoint(map_ne_m):
        return None
    rules.refuse(rules.of_polygon(corners, field, table.name))
    return PolygonZone(name=table.name, vertices_ne_m=drawn, keep_in=keep_in)


def _too_far(table: ZoneTable, field: str) -> InputError:
    rule = "it may reach the map, and more than 1,000 km from the origin, or around a pole"
    return InputError(field, table.name, rule, "Give the part near the mission, as a polygon.")


def _is_near(place_ne_m: Place) -> bool:
    return math.hypot(*place_ne_m) <= FARTHEST_M  # false for what is no number


# --- zones as files have them


def place_deg(place: Sequence[float | None], where: str) -> dict[str, float]:
    """Latitude and longitude as keys of a mission file.  InputError (where) if it is no place."""
    latitude, longitude = place[:2]
    if latitude is None or longitude is None or abs(latitude) > 90.0 or abs(longitude) > 180.0:
        rule = "out of range: latitude is -90 to 90, longitude -180 to 180"
        remedy = "Swap (GeoJSON has longitude first) or correct them."
        raise InputError(where, f"latitude {latitude}, longitude {longitude}", rule, remedy)
    return {"latitude_deg": latitude, "longitude_deg": longitude}


@dataclass(slots=True, kw_only=True)
class Zones:
    """The zones that a file holds, as tables of a mission file."""

    keep_outs: list[RawTable] = field(default_factory=list)
    keep_ins: list[RawTable] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out or taken otherwise than it is written, for people."""

    def add(
        self, name: str, where: str, inside: bool, *corners: Any, radius_m: float | None = None
    ) -> None:
        """A polygon of these corners, latitude first, or a circle about one.

        inside: that the vehicle stays inside of.  InputError (where) about a corner.
        """
        places, zone = [place_deg(corner, where) for corner in corners], RawTable(name=name)
        if radius_m is None:
            zone["vertices_deg"] = [[*place.values()] for place in places]
        else:
            zone |= {**places[0], "radius_m": radius_m}
        (self.keep_ins if inside else self.keep_outs).append(zone)


# --- GeoJSON

_REMEDY: Final = "Give a GeoJSON FeatureCollection of polygons and points; see docs/files.md."
_WGS84: Final = ("CRS84", "4326")
_GEOMETRIES: Final = ("Point", "Polygon", "MultiPoint", "MultiPolygon", "GeometryCollection")
_BROKEN: Final = (
    *(ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError),
    shapely.errors.ShapelyError,
)
"""What shapely raises about a geometry that is none."""

NoZone = Literal["points", "lines", "empty"]
"""Kinds of features that maps have beside zones."""
_NO_ZONES: Final[dict[NoZone, str]] = {
    "points": "point without radius_m",
    "lines": "line",
    "empty": "feature without a geometry",
}


class _Properties(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)
    kind: Literal["keep_out", "keep_in"] = "keep_out"
    radius_m: float | None = None


def read_geojson(path: Path, where: str, leave_out: Collection[NoZone] = ()) -> Zones:
    """The zones of a file; leave_out: what a map may have beside them.

    Raises InputError about it, naming the feature in it, or counting those that are no zones.
    Polygons and multipolygons are zones; a point with the property radius_m is a circle.
    """
    content = json_table(path, where, _REMEDY)
    crs = content.get("crs")  # of before RFC 7946
    if crs is not None and not any(name in str(crs) for name in _WGS84):
        rule = "its coordinates (crs) are not longitude and latitude of WGS84"
        remedy = "Convert it (ogr2ogr -t_srs EPSG:4326 -lco RFC7946=YES)."
        raise InputError(where, str(path), rule, remedy)
    if content.get("type") in _GEOMETRIES:
        content = {"type": "Feature", "geometry": content}
    if content.get("type") == "Feature":
        content = {"type": "FeatureCollection", "features": [content]}
    features = content.get("features")
    if content.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise InputError(where, str(path), "it is no GeoJSON FeatureCollection", _REMEDY)
    zones, no_zones = Zones(), Counter[NoZone]()
    for index, feature in enumerate(features):
        label = f"{path.name}: features[{index}]"
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise InputError(label, feature, 'it has no type "Feature"', "Remove or complete it.")
        no_zones.update(_take(feature, f"feature {index}", label, zones))
    counted = {kind: f"{n:,} x {_NO_ZONES[kind]}" for kind, n in no_zones.items()}
    if unasked := [words for kind, words in counted.items() if kind not in leave_out]:
        kinds = ", ".join(f'"{kind}"' for kind in counted)
        remedy = (
            "Remove or complete them, or leave them out: "
            f'threats = {{ file = "{plain(path.name, "")}", leave_out = [{kinds}] }}.'
        )
        rule = "a zone is a polygon, or a point with radius_m"
        raise InputError(f"{path.name}: features", ", ".join(unasked), rule, remedy)
    if counted:
        left_out = ", ".join(counted.values())
        zones.notes.append(f"{path.name}: left out, as they are no zones: {left_out}")
    return zones


def _take(raw: RawTable, default: str, label: str, zones: Zones) -> Iterator[NoZone]:
    """Add the zones of a feature; what of it is none.  label: how it is called in errors."""
    given = raw.get("properties")
    given = given if isinstance(given, dict) else {}
    name = plain(given.get("name"), default)
    label, has_radius = f"{label} ({name})", given.get("radius_m") is not None
    polygons, points = list[shapely.Polygon](), list[shapely.Point]()
    for part in _parts(raw.get("geometry"), label):
        if part is None or part.is_empty:
            yield "empty"
        elif isinstance(part, shapely.Polygon):
            polygons.append(part)
        elif isinstance(part, shapely.Point) and has_radius:
            points.append(part)
        else:
            yield "points" if isinstance(part, shapely.Point) else "lines"
    if not polygons and not points:
        return
    properties, where = validated(_Properties, given, f"{label}.properties"), f"{label}.geometry"
    inside = properties.kind == "keep_in"
    if inside and len(polygons) > 1:
        rule = "the vehicle cannot keep inside of several polygons at once"
        raise InputError(f"{where}.type", "MultiPolygon", rule, "Keep one polygon of it.")
    where += ".coordinates"
    for point in points:
        zones.add(name, where, inside, (point.y, point.x), radius_m=properties.radius_m)
    for number, polygon in enumerate(polygons, start=1):
        of_several = name if len(polygons) == 1 else f"{name} part {number}"
        zones.add(of_several, where, inside, *_corners(polygon.exterior))
        if inside:
            for hole, ring in enumerate(polygon.interiors, start=1):
                zones.add(f"{name} hole {hole}", where, False, *_corners(ring))
        elif polygon.interiors:
            zones.notes.append(f"keep-out {of_several!r}: its holes are kept out of as well")


def _parts(raw: Any, label: str) -> Iterator[BaseGeometry | None]:
    """The points, lines and polygons of a geometry; itself, if it is empty."""
    try:
        inner = [None if raw is None else shape(raw)]
    except _BROKEN:
        rule = "it is no geometry as RFC 7946 has it"
        raise InputError(f"{label}.geometry", raw, rule, "Remove or correct it.") from None
    while inner:
        geometry = inner.pop(0)
        if geometry is not None and hasattr(geometry, "geoms") and not geometry.is_empty:
            inner[:0] = geometry.geoms
        else:
            yield geometry


def _corners(ring: shapely.LinearRing) -> Iterable[tuple[float, float]]:
    """Latitude and longitude of each, of the first, which it says twice, once."""
    return [(latitude, longitude) for longitude, latitude, *_ in ring.coords[:-1]]
