"""Zones from a GeoJSON file (RFC 7946: longitude before latitude, WGS84), its shapes by shapely."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import shapely
from pydantic import BaseModel, ConfigDict
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from companion.errors import InputError
from companion.sources.files import RawTable, json_table, plain
from companion.sources.plan_file import Zones
from companion.sources.schema import validated

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
    features = found.get("features") if found.get("type") == "FeatureCollection" else [found]
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
    return ", ".join(f"{count:,} x {_NO_ZONES[kind]}" for kind, count in kinds.items())


def _take(raw: RawTable, index: int, label: str, zones: Zones, no_zones: Counter[NoZone]) -> None:
    """Add the zones of a feature; label: how it is called in errors."""
    properties = raw.get("properties")
    given: RawTable = properties if isinstance(properties, dict) else {}
    name = plain(given.get("name"), f"feature {index}")
    label, has_radius = f"{label} ({name})", given.get("radius_m") is not None
    polygons, points = list[shapely.Polygon](), list[shapely.Point]()
    for part in _parts(raw.get("geometry"), label):
        if part is None or part.is_empty:
            no_zones["empty"] += 1
        elif isinstance(part, shapely.Polygon):
            polygons.append(part)
        elif isinstance(part, shapely.Point) and has_radius:
            points.append(part)
        else:
            no_zones["points" if isinstance(part, shapely.Point) else "lines"] += 1
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
