"""Zones and radars from a GeoJSON file (RFC 7946: longitude before latitude, WGS84)."""

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


@final
@dataclass(slots=True, kw_only=True)
class Threats:
    """What a file holds, as tables of a mission file."""

    keep_outs: list[RawTable] = field(default_factory=list)
    keep_ins: list[RawTable] = field(default_factory=list)
    radars: list[RawTable] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out or taken otherwise than it is written, for people."""


def read_geojson(path: Path, where: str) -> Threats:
    """The threats of a file.  Raises InputError about it, or naming the feature in it.

    Polygons and multipolygons are zones; a point with the property radius_m is a circle, one of
    kind "radar" a radar with range_m and altitude_amsl_m.
    """
    found = json_table(path, where, _REMEDY)
    _check_coordinates(found, path, where)
    features = found.get("features") if found.get("type") == "FeatureCollection" else [found]
    if found.get("type") not in ("FeatureCollection", "Feature") or not isinstance(features, list):
        raise InputError(where, str(path), "it is no GeoJSON FeatureCollection", _REMEDY)
    return threats_of(features, path.name)


def threats_of(features: list[Any], name: str) -> Threats:
    """The threats of GeoJSON features; name: of the file.  Raises InputError naming the feature."""
    if len(features) > _MAX_FEATURES:
        rule = f"it has more than {_MAX_FEATURES:,}"
        remedy = "Keep those that are near the mission."
        raise InputError(f"{name}: features", len(features), rule, remedy)
    threats = Threats()
    for index, feature in enumerate(features):
        _add(threats, feature, f"{name}: features[{index}]", index)
    return threats


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
