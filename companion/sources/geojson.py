"""Zones and radars from a GeoJSON file (RFC 7946: longitude before latitude, WGS84)."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from companion.errors import InputError
from companion.sources.files import RawTable, json_table, plain
from companion.sources.schema import validated

_REMEDY = "Give a GeoJSON FeatureCollection of polygons and points; see docs/files.md."
_WGS84 = ("CRS84", "4326")
_MAX_FEATURES = 100_000
_LINES = ("LineString", "MultiLineString")
_ALONE = ("Polygon", "MultiPolygon", "Point", "MultiPoint", "GeometryCollection")

NoZone = Literal["points", "lines", "empty"]
"""Kinds of features that maps have beside zones."""
_NO_ZONES: dict[NoZone, tuple[str, str]] = {
    "points": ("point without radius_m", "points without radius_m"),
    "lines": ("line", "lines"),
    "empty": ("without a geometry", "without a geometry"),
}
"""One, and several."""


@final
@dataclass(slots=True, kw_only=True)
class Threats:
    """What a file holds, as tables of a mission file."""

    keep_outs: list[RawTable] = field(default_factory=list)
    keep_ins: list[RawTable] = field(default_factory=list)
    radars: list[RawTable] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out or taken otherwise than it is written, for people."""


def read_geojson(path: Path, where: str, leave_out: Collection[NoZone] = ()) -> Threats:
    """The threats of a file; leave_out: what a map may have beside zones.

    Raises InputError about it, naming the feature in it, or counting those that are no zones.
    Polygons and multipolygons are zones; a point with the property radius_m is a circle, one of
    kind "radar" a radar with range_m and altitude_amsl_m.
    """
    found = json_table(path, where, _REMEDY)
    _check_coordinates(found, path, where)
    if found.get("type") in _ALONE:
        found = {"type": "Feature", "properties": None, "geometry": found}
    features = found.get("features") if found.get("type") == "FeatureCollection" else [found]
    if found.get("type") not in ("FeatureCollection", "Feature") or not isinstance(features, list):
        raise InputError(where, str(path), "it is no GeoJSON FeatureCollection", _REMEDY)
    name = path.name
    if len(features) > _MAX_FEATURES:
        rule = f"it has more than {_MAX_FEATURES:,}"
        remedy = "Keep those that are near the mission."
        raise InputError(f"{name}: features", len(features), rule, remedy)
    threats, no_zones = Threats(), Counter[NoZone]()
    for index, feature in enumerate(features):
        if not isinstance(feature, dict):
            label, rule = f"{name}: features[{index}]", "a feature is a JSON object"
            raise InputError(label, feature, rule, "Remove or complete it.")
        for part in _parts(feature):
            if (kind := _no_zone(part)) is not None:
                no_zones[kind] += 1
            else:
                _add(threats, part, f"{name}: features[{index}]", index)
    unasked = {kind: count for kind, count in no_zones.items() if kind not in leave_out}
    if unasked:
        rule = "a zone is a polygon, or a point with radius_m"
        kinds = ", ".join(f'"{kind}"' for kind in no_zones)
        remedy = (
            "Remove or complete them, or leave them out: "
            f'threats = {{ file = "{plain(name, "")}", leave_out = [{kinds}] }}.'
        )
        raise InputError(f"{name}: features", _counted(unasked), rule, remedy)
    if no_zones:
        threats.notes.append(f"{name}: left out, as they are no zones: {_counted(no_zones)}")
    return threats


def _counted(kinds: Mapping[NoZone, int]) -> str:
    return ", ".join(f"{count:,} {_NO_ZONES[kind][count > 1]}" for kind, count in kinds.items())


def _parts(feature: Any, deepest: int = 8) -> Iterator[Any]:
    """The feature, or one for each geometry of a collection and each place of a MultiPoint."""
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    inner: Any = None
    if isinstance(geometry, dict) and geometry.get("type") == "GeometryCollection":
        inner = geometry.get("geometries")
    elif isinstance(geometry, dict) and geometry.get("type") == "MultiPoint":
        places = geometry.get("coordinates")
        if isinstance(places, list):
            inner = [{"type": "Point", "coordinates": place} for place in places]
    elif isinstance(geometry, dict) and geometry.get("type") == "MultiPolygon":
        polygons = geometry.get("coordinates")
        if isinstance(polygons, list) and any(map(_is_empty, polygons)):
            whole = [each for each in polygons if not _is_empty(each)]
            empty = [geometry | {"coordinates": []}] * (len(polygons) - len(whole))
            inner = [geometry | {"coordinates": whole}, *empty] if whole else None
    if not isinstance(inner, list) or not inner or deepest == 0:
        yield feature
        return
    for each in inner:
        yield from _parts(feature | {"geometry": each}, deepest - 1)


def _no_zone(feature: Any) -> NoZone | None:
    """What a feature is that can be no zone, whatever was meant by it; None: it may be one."""
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        return None
    geometry, properties = feature.get("geometry"), feature.get("properties")
    if geometry is None:
        return "empty"
    if not isinstance(geometry, dict):
        return None
    kind = geometry.get("type")
    inside = geometry.get("geometries" if kind == "GeometryCollection" else "coordinates")
    if kind in (*_ALONE, *_LINES) and _is_empty(inside):
        return "empty"
    if kind in _LINES:
        return "lines"
    given = properties if isinstance(properties, dict) else {}
    if kind == "Point" and given.get("kind") != "radar" and given.get("radius_m") is None:
        return "points"
    return None


def _is_empty(coordinates: Any) -> bool:
    return isinstance(coordinates, list) and all(_is_empty(each) for each in coordinates)


def _check_coordinates(found: RawTable, path: Path, where: str) -> None:
    """A file of before RFC 7946 may be in other coordinates, and then says so."""
    crs = found.get("crs")
    if crs is not None and not any(name in str(crs) for name in _WGS84):
        rule = "its coordinates (crs) are not longitude and latitude of WGS84"
        remedy = "Convert it (ogr2ogr -t_srs EPSG:4326 -lco RFC7946=YES)."
        raise InputError(where, str(path), rule, remedy)


# --- what a feature may be


def _latitude_first(place: list[float]) -> list[float]:
    longitude, latitude = place[:2]
    if not -180.0 <= longitude <= 180.0 or not -90.0 <= latitude <= 90.0:
        rule = "out of range: longitude comes first, -180 to 180, then latitude, -90 to 90"
        raise PydanticCustomError("place", rule)
    return [latitude, longitude]


def _corners(ring: list[list[float]]) -> list[list[float]]:
    """RFC 7946 says the first corner twice."""
    corners = ring[:-1] if len(ring) > 1 and ring[0] == ring[-1] else ring
    if len(corners) < 3:
        raise PydanticCustomError("ring", "a ring has three or more corners")
    return corners


class _Json(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)


_Place = Annotated[list[float], Field(min_length=2, max_length=4), AfterValidator(_latitude_first)]
_Rings = Annotated[list[Annotated[list[_Place], AfterValidator(_corners)]], Field(min_length=1)]


class _Point(_Json):
    type: Literal["Point"]
    coordinates: _Place


class _Polygon(_Json):
    type: Literal["Polygon"]
    coordinates: _Rings


class _MultiPolygon(_Json):
    type: Literal["MultiPolygon"]
    coordinates: list[_Rings]


class _Properties(_Json):
    name: Any = None
    kind: Literal["keep_out", "keep_in", "radar"] = "keep_out"
    radius_m: float | None = None
    altitude_amsl_m: float | None = None
    range_m: float | None = None


class _Feature(_Json):
    type: Literal["Feature"]
    properties: _Properties | None = None
    geometry: Annotated[_Point | _Polygon | _MultiPolygon, Field(discriminator="type")]


def _add(threats: Threats, raw: Any, label: str, index: int) -> None:
    """Add the zones or the radar of a feature; label: how it is called in errors."""
    given = raw.get("properties") if isinstance(raw, dict) else None
    name = plain(given.get("name") if isinstance(given, dict) else None, f"feature {index}")
    label = f"{label} ({name})"
    feature = validated(_Feature, raw, label)
    properties, geometry = feature.properties or _Properties(), feature.geometry
    kind = properties.kind
    zones = threats.keep_ins if kind == "keep_in" else threats.keep_outs
    if isinstance(geometry, _Point):
        latitude, longitude = geometry.coordinates
        place: RawTable = {"name": name, "latitude_deg": latitude, "longitude_deg": longitude}
        for key in ("altitude_amsl_m", "range_m") if kind == "radar" else ("radius_m",):
            if (value := getattr(properties, key)) is None:
                remedy = f"Give the point a property {key}, in metres."
                raise InputError(f"{label}.properties.{key}", None, "it is missing", remedy)
            place[key] = value
        (threats.radars if kind == "radar" else zones).append(place)
        return
    if kind == "radar":
        rule = "a radar is a point"
        raise InputError(f"{label}.geometry.type", geometry.type, rule, "Make it a Point.")
    parts = [geometry.coordinates] if isinstance(geometry, _Polygon) else geometry.coordinates
    if kind == "keep_in" and len(parts) > 1:
        rule = "the vehicle cannot keep inside of several polygons at once"
        raise InputError(f"{label}.geometry.type", geometry.type, rule, "Keep one polygon of it.")
    for number, (outer, *holes) in enumerate(parts, start=1):
        part = name if len(parts) == 1 else f"{name} part {number}"
        zones.append({"name": part, "vertices_deg": outer})
        if kind == "keep_in":
            threats.keep_outs += [
                {"name": f"{part} hole {hole}", "vertices_deg": ring}
                for hole, ring in enumerate(holes, start=1)
            ]
        elif holes:
            threats.notes.append(f"keep-out {part!r}: its holes are kept out of as well")
