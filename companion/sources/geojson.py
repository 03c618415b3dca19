"""Zones from a GeoJSON file (RFC 7946: longitude before latitude, WGS84)."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from companion.errors import InputError
from companion.sources.files import RawTable, json_table, plain
from companion.sources.plan_file import Zones
from companion.sources.schema import validated

_REMEDY: Final = "Give a GeoJSON FeatureCollection of polygons and points; see docs/files.md."
_WGS84: Final = ("CRS84", "4326")
_MAX_FEATURES: Final = 100_000
_SEVERAL: Final = ("MultiPoint", "MultiPolygon")
_LINES: Final = ("LineString", "MultiLineString")
_ALONE: Final = ("Point", "Polygon", *_SEVERAL, "GeometryCollection")
_DEEPEST: Final = 8  # collections in collections

NoZone = Literal["points", "lines", "empty"]
"""Kinds of features that maps have beside zones."""
_NO_ZONES: Final[dict[NoZone, tuple[str, str]]] = {
    "points": ("point without radius_m", "points without radius_m"),
    "lines": ("line", "lines"),
    "empty": ("without a geometry", "without a geometry"),
}
"""One, and several."""


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
_Ring = Annotated[list[_Place], AfterValidator(_corners)]


class _Point(_Json):
    type: Literal["Point"]
    coordinates: _Place


class _Polygon(_Json):
    type: Literal["Polygon"]
    coordinates: list[_Ring] = Field(min_length=1)


class _Properties(_Json):
    kind: Literal["keep_out", "keep_in"] = "keep_out"
    radius_m: float | None = None


class _Feature(_Json):
    """A feature of which only one geometry is left, with its parts taken apart."""

    type: Literal["Feature"]
    properties: _Properties | None = None
    geometry: _Point | _Polygon = Field(discriminator="type")


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
    if found.get("type") in _ALONE:
        found = {"type": "Feature", "geometry": found}
    features = found.get("features") if found.get("type") == "FeatureCollection" else [found]
    if found.get("type") not in ("FeatureCollection", "Feature") or not isinstance(features, list):
        raise InputError(where, str(path), "it is no GeoJSON FeatureCollection", _REMEDY)
    if len(features) > _MAX_FEATURES:
        rule, remedy = f"it has more than {_MAX_FEATURES:,}", "Keep those near the mission."
        raise InputError(f"{path.name}: features", len(features), rule, remedy)
    zones, no_zones = Zones(), Counter[NoZone]()
    for index, feature in enumerate(features):
        label = f"{path.name}: features[{index}]"
        if not isinstance(feature, dict):
            raise InputError(label, feature, "a feature is a JSON object", "Remove or complete it.")
        _take(feature, index, label, zones, no_zones)
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
    return ", ".join(f"{count:,} {_NO_ZONES[kind][count > 1]}" for kind, count in kinds.items())


def _take(raw: RawTable, index: int, label: str, zones: Zones, no_zones: Counter[NoZone]) -> None:
    """Add the zones of a feature; label: how it is called in errors."""
    given = raw.get("properties")
    given = given if isinstance(given, dict) else {}
    name = plain(given.get("name"), f"feature {index}")
    label, polygons, is_keep_in = f"{label} ({name})", list[_Polygon](), False
    if given.get("kind") == "radar":
        rule, remedy = "it was removed in this version", "Write it as [[radars]] in a mission.toml."
        raise InputError(f"{label}.properties.kind", "radar", rule, remedy)
    for geometry in _taken_apart(raw.get("geometry")):
        no_zone = _no_zone(geometry, given) if raw.get("type") == "Feature" else None
        if no_zone is not None:
            no_zones[no_zone] += 1
            continue
        feature = validated(_Feature, raw | {"geometry": geometry}, label)
        properties = feature.properties or _Properties()
        is_keep_in = properties.kind == "keep_in"
        if isinstance(feature.geometry, _Polygon):
            polygons.append(feature.geometry)
            continue
        latitude, longitude = feature.geometry.coordinates
        place = {"latitude_deg": latitude, "longitude_deg": longitude}
        circle = {"name": name, **place, "radius_m": properties.radius_m}
        zones.add(circle, inside=is_keep_in)
    if is_keep_in and len(polygons) > 1:
        rule = "the vehicle cannot keep inside of several polygons at once"
        raise InputError(f"{label}.geometry.type", "MultiPolygon", rule, "Keep one polygon of it.")
    for number, polygon in enumerate(polygons, start=1):
        part = name if len(polygons) == 1 else f"{name} part {number}"
        outer, *holes = polygon.coordinates
        zone = {"name": part, "vertices_deg": outer}
        zones.add(zone, inside=is_keep_in)
        if is_keep_in:
            for hole, ring in enumerate(holes, start=1):
                zones.keep_outs.append({"name": f"{part} hole {hole}", "vertices_deg": ring})
        elif holes:
            zones.notes.append(f"keep-out {part!r}: its holes are kept out of as well")


def _taken_apart(geometry: Any, deepest: int = _DEEPEST) -> Iterator[Any]:
    """The geometries of collections, the points and the polygons of what has several."""
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    inner = None
    if kind == "GeometryCollection":
        inner = geometry.get("geometries")
    elif kind in _SEVERAL and isinstance(several := geometry.get("coordinates"), list):
        inner = [{"type": kind.removeprefix("Multi"), "coordinates": each} for each in several]
    if not isinstance(inner, list) or deepest == 0:
        yield geometry
    for each in inner or [None] if isinstance(inner, list) and deepest else ():
        yield from _taken_apart(each, deepest - 1)


def _no_zone(geometry: Any, properties: RawTable) -> NoZone | None:
    """What a geometry is that can be no zone, whatever was meant by it; None: it may be one."""
    if geometry is None:
        return "empty"
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind in (*_ALONE, *_LINES) and _is_empty(geometry.get("coordinates")):
        return "empty"
    if kind in _LINES:
        return "lines"
    return "points" if kind == "Point" and properties.get("radius_m") is None else None


def _is_empty(coordinates: Any) -> bool:
    return isinstance(coordinates, list) and all(map(_is_empty, coordinates))
