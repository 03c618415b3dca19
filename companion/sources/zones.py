"""Places and zones of mission files, in degrees or in metres, and zones of GeoJSON files.

GeoJSON is as RFC 7946 has it: longitude before latitude, WGS84.  Its shapes are shapely's.
"""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from companion.errors import InputError
from companion.geodesy import LocalFrame, parts_within, short_way, wrap_deg
from companion.planner import rules
from companion.planner.rules import Broken
from companion.planner.settings import Place, Task
from companion.ranges import Latitude, Longitude, Positive
from companion.sources.files import RawTable, json_table, plain
from companion.sources.tables import Altitude, Horizontal, Table, validated
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone, Zone

Name = Annotated[str, Field(min_length=1, max_length=100)]
_FARTHEST_M: Final = 1e6
"""From the origin: beyond, the local frame is too far from a map."""
_STRAIGHT_M: Final = 2000.0
"""An edge that is straight in degrees is, at 60 degrees of latitude, 0.15 m off over this."""


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

    def place(self, frame: LocalFrame, field: str) -> Place:
        """North and east of it, however it is given.  Raises InputError about the field."""
        if self.degrees is None:
            return self.north_m or 0.0, self.east_m or 0.0
        if not _is_near(place := frame.to_local_m(*self.degrees)):
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
    by_m, found, far = task.zone_search_clearance_m, list[Zone](), 0
    map_ne_m = shapely.box(south - by_m, west - by_m, north + by_m, east + by_m)
    for kind, tables in (("keep_outs", keep_outs), ("keep_ins", keep_ins)):
        for number, table in enumerate(tables):
            field, keep_in = f"{kind}[{number}]", kind == "keep_ins"
            zone = _zone(table, frame, map_ne_m, field, keep_in=keep_in)
            if zone is not None:
                found.append(zone)
            elif keep_in:
                rule = "all of the map lies outside of it, more than 1,000 km from its corners"
                raise InputError(field, table.name, rule, "Remove it, or correct it.")
            else:
                far += 1
    note = f"{far} of {len(keep_outs)} keep-outs lie away from the map" if far else ""
    return tuple(found), note


def _zone(
    table: ZoneTable, frame: LocalFrame, map_ne_m: shapely.Polygon, field: str, *, keep_in: bool
) -> Zone | None:
    """The zone; None: it is a keep-out, or lies beyond the local frame, and is away from the map.

    map_ne_m: with what comes near it.  Raises InputError about the field.
    """
    if table.radius_m is not None:
        radius_m = table.radius_m
        if table.degrees is not None and not _is_near(place := frame.to_local_m(*table.degrees)):
            farthest_m = float(np.hypot(*map_ne_m.exterior.xy).max())
            if not math.hypot(*place) <= farthest_m + radius_m:  # nor what is no number
                return None
            rule = "its centre lies more than 1,000 km from the origin, and it reaches the map"
            remedy = "Draw its edge near the mission as a polygon."
            raise InputError(field, [*table.degrees], rule, remedy)
        north, east = table.place(frame, field)
        box = shapely.box(north - radius_m, east - radius_m, north + radius_m, east + radius_m)
        is_near = keep_in or box.intersects(map_ne_m)
        circle = CircleZone(
            name=table.name, north_m=north, east_m=east, radius_m=radius_m, keep_in=keep_in
        )
        return circle if is_near else None
    if table.vertices_m is not None:
        corners = drawn = tuple((north, east) for north, east in table.vertices_m)
    else:
        degrees = [(latitude, longitude) for latitude, longitude in table.vertices_deg or []]
        corners = tuple(frame.to_local_m(*place) for place in degrees)
        if not all(map(_is_near, corners)):
            south, west, north, east = map_ne_m.bounds
            ways = [each for each in (short_way(degrees), degrees) if each]  # around the Earth
            spans = (south, north), (west, east)
            if len(ways) == 2 and not any(parts_within(each, frame, *spans) for each in ways):
                return None
            rule = "it may reach the map, and some of it lies more than 1,000 km from the origin"
            raise InputError(field, table.name, rule, "Give only the part near the mission.")
        drawn = _straight_in_degrees(degrees, frame)
    box = shapely.MultiPoint(drawn).envelope
    if not (keep_in or box.is_empty or box.intersects(map_ne_m)):
        return None
    rules.refuse(rules.of_polygon(corners, field, table.name))
    return PolygonZone(name=table.name, vertices_ne_m=drawn, keep_in=keep_in)


def _is_near(place_ne_m: Place) -> bool:
    return math.hypot(*place_ne_m) <= _FARTHEST_M  # false for what is no number


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
        for part in (step / pieces for step in range(1, pieces)):
            found.append(frame.to_local_m(latitude + part * north, longitude + part * east))
    return tuple(found)


# --- GeoJSON

_REMEDY: Final = "Give a GeoJSON FeatureCollection of polygons and points; see docs/files.md."
_WGS84: Final = ("CRS84", "4326")
_MAX_FEATURES: Final = 100_000
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


@dataclass(slots=True, kw_only=True)
class Zones:
    """The zones that a file holds, as tables of a mission file."""

    keep_outs: list[RawTable] = field(default_factory=list)
    keep_ins: list[RawTable] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out or taken otherwise than it is written, for people."""

    def add(self, zone: RawTable, *, inside: bool) -> None:
        """A zone; inside: that the vehicle stays inside of."""
        (self.keep_ins if inside else self.keep_outs).append(zone)


class _Properties(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)
    kind: Literal["keep_out", "keep_in"] = "keep_out"
    radius_m: float | None = None


def read_geojson(path: Path, where: str, leave_out: Collection[NoZone] = ()) -> Zones:
    """The zones of a file; leave_out: what a map may have beside them.

    Raises InputError about it, naming the feature in it, or counting those that are no zones.
    Polygons and multipolygons are zones; a point with the property radius_m is a circle.
    """
    found = json_table(path, where, _REMEDY)
    crs = found.get("crs")  # of before RFC 7946
    if crs is not None and not any(name in str(crs) for name in _WGS84):
        rule = "its coordinates (crs) are not longitude and latitude of WGS84"
        remedy = "Convert it (ogr2ogr -t_srs EPSG:4326 -lco RFC7946=YES)."
        raise InputError(where, str(path), rule, remedy)
    if found.get("type") in _GEOMETRIES:
        found = {"type": "Feature", "geometry": found}
    features = [found] if found.get("type") == "Feature" else found.get("features")
    if found.get("type") not in ("FeatureCollection", "Feature") or not isinstance(features, list):
        raise InputError(where, str(path), "it is no GeoJSON FeatureCollection", _REMEDY)
    if len(features) > _MAX_FEATURES:
        rule, remedy = f"it has more than {_MAX_FEATURES:,}", "Keep those near the mission."
        raise InputError(f"{path.name}: features", len(features), rule, remedy)
    zones, no_zones = Zones(), Counter[NoZone]()
    for index, feature in enumerate(features):
        label = f"{path.name}: features[{index}]"
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise InputError(label, feature, 'it has no type "Feature"', "Remove or complete it.")
        no_zones.update(_take(feature, f"feature {index}", label, zones))
    if unasked := {kind: count for kind, count in no_zones.items() if kind not in leave_out}:
        rule = "a zone is a polygon, or a point with radius_m"
        kinds = ", ".join(f'"{kind}"' for kind in no_zones)
        remedy = (
            "Remove or complete them, or leave them out: "
            f'threats = {{ file = "{plain(path.name, "")}", leave_out = [{kinds}] }}.'
        )
        raise InputError(f"{path.name}: features", _counted(unasked), rule, remedy)
    if no_zones:
        zones.notes.append(f"{path.name}: left out, as they are no zones: {_counted(no_zones)}")
    return zones


def _counted(kinds: Mapping[NoZone, int]) -> str:
    return ", ".join(f"{count:,} x {_NO_ZONES[kind]}" for kind, count in kinds.items())


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
    said = validated(_Properties, given, f"{label}.properties")
    is_keep_in = said.kind == "keep_in"
    for point in points:
        [(latitude, longitude)] = _corners(point, label)
        place = {"latitude_deg": latitude, "longitude_deg": longitude}
        zones.add({"name": name, **place, "radius_m": said.radius_m}, inside=is_keep_in)
    if is_keep_in and len(polygons) > 1:
        rule = "the vehicle cannot keep inside of several polygons at once"
        raise InputError(f"{label}.geometry.type", "MultiPolygon", rule, "Keep one polygon of it.")
    for number, polygon in enumerate(polygons, start=1):
        of_several = name if len(polygons) == 1 else f"{name} part {number}"
        zone = {"name": of_several, "vertices_deg": _corners(polygon.exterior, label)}
        zones.add(zone, inside=is_keep_in)
        if is_keep_in:
            for hole, ring in enumerate(polygon.interiors, start=1):
                corners = _corners(ring, label)
                zones.keep_outs.append({"name": f"{name} hole {hole}", "vertices_deg": corners})
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


def _corners(outline: BaseGeometry, label: str) -> list[list[float]]:
    """Latitude and longitude of each corner, of a ring's first, which it says twice, once."""
    corners = []
    for longitude, latitude in shapely.get_coordinates(outline).tolist():
        if not (abs(longitude) <= 180.0 and abs(latitude) <= 90.0):
            rule = "out of range: longitude comes first, -180 to 180, then latitude, -90 to 90"
            place = f"{label}.geometry.coordinates"
            raise InputError(place, [longitude, latitude], rule, "Swap or correct them.")
        corners.append([latitude, longitude])
    return corners[:-1] if isinstance(outline, shapely.LinearRing) else corners
