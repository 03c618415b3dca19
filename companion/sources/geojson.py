"""Zones and radars from a GeoJSON file (RFC 7946: longitude before latitude, WGS84)."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, final

from companion.errors import InputError
from companion.sources.files import RawTable, json_table, plain

Corners = list[list[float]]
"""Latitude, longitude of each corner."""

_REMEDY = "Give a GeoJSON FeatureCollection of polygons and points; see docs/files.md."
_KINDS = ("keep_out", "keep_in", "radar")
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
        _Feature.of(feature, f"{name}: features[{index}]", index).add_to(threats)
    return threats


def _check_coordinates(found: RawTable, path: Path, where: str) -> None:
    """A file of before RFC 7946 may be in other coordinates, and then says so."""
    crs = found.get("crs")
    if crs is not None and not any(name in str(crs) for name in _WGS84):
        rule = "its coordinates (crs) are not longitude and latitude of WGS84"
        remedy = "Convert it (ogr2ogr -t_srs EPSG:4326 -lco RFC7946=YES)."
        raise InputError(where, str(path), rule, remedy)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Feature:
    """One feature, and how it is called in errors."""

    label: str
    name: str
    kind: str
    properties: RawTable
    geometry: RawTable

    @classmethod
    def of(cls, feature: Any, label: str, index: int) -> "_Feature":
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise InputError(label, _shown(feature), "it is no Feature", _REMEDY)
        properties = feature.get("properties") or {}
        geometry = feature.get("geometry")
        if not isinstance(properties, dict) or not isinstance(geometry, dict):
            raise InputError(label, _shown(feature), "it has no geometry or properties", _REMEDY)
        name = plain(properties.get("name"), f"feature {index}")
        label = f"{label} ({name})"
        kind = properties.get("kind", "keep_out")
        if kind not in _KINDS:
            remedy = f"Choose from: {', '.join(_KINDS)}."
            raise InputError(f"{label}.properties.kind", kind, "no such kind", remedy)
        return cls(label=label, name=name, kind=kind, properties=properties, geometry=geometry)

    def add_to(self, threats: Threats) -> None:
        shape, coordinates = self.geometry.get("type"), self.geometry.get("coordinates")
        if shape == "Point":
            self._add_point(threats, coordinates)
        elif self.kind == "radar":
            self._refuse("geometry.type", shape, "a radar is a point", "Make it a Point.")
        elif shape == "Polygon":
            self._add_polygon(threats, coordinates, self.name)
        elif shape == "MultiPolygon":
            parts = self._list(coordinates, "geometry.coordinates")
            if self.kind == "keep_in" and len(parts) > 1:
                rule = "the vehicle cannot keep inside of several polygons at once"
                self._refuse("geometry.type", shape, rule, "Keep one polygon of it.")
            for number, part in enumerate(parts, start=1):
                name = self.name if len(parts) == 1 else f"{self.name} part {number}"
                self._add_polygon(threats, part, name)
        else:
            rule = "only Polygon, MultiPolygon and Point say what to keep from"
            remedy = "Draw it as an area, or remove it."
            self._refuse("geometry.type", shape, rule, remedy)

    def _add_point(self, threats: Threats, coordinates: Any) -> None:
        latitude, longitude = self._place(coordinates, "geometry.coordinates")
        place = {"name": self.name, "latitude_deg": latitude, "longitude_deg": longitude}
        if self.kind == "radar":
            numbers = {key: self._number(key) for key in ("altitude_amsl_m", "range_m")}
            threats.radars.append(place | numbers)
            return
        zone = place | {"radius_m": self._number("radius_m")}
        (threats.keep_ins if self.kind == "keep_in" else threats.keep_outs).append(zone)

    def _add_polygon(self, threats: Threats, rings: Any, name: str) -> None:
        outlines = [
            self._ring(ring, f"geometry.coordinates[{number}]")
            for number, ring in enumerate(self._list(rings, "geometry.coordinates"))
        ]
        if not outlines:
            self._refuse("geometry.coordinates", rings, "it has no corners", "Draw it anew.")
        outer, holes = outlines[0], outlines[1:]
        if self.kind == "keep_in":
            threats.keep_ins.append({"name": name, "vertices_deg": outer})
            for number, hole in enumerate(holes, start=1):
                zone = {"name": f"{name} hole {number}", "vertices_deg": hole}
                threats.keep_outs.append(zone)
            return
        threats.keep_outs.append({"name": name, "vertices_deg": outer})
        if holes:
            threats.notes.append(f"keep-out {name!r}: its holes are kept out of as well")

    def _ring(self, ring: Any, where: str) -> Corners:
        corners = [
            list(self._place(place, f"{where}[{number}]"))
            for number, place in enumerate(self._list(ring, where))
        ]
        if len(corners) > 1 and corners[0] == corners[-1]:
            corners.pop()  # RFC 7946 says the first corner twice
        if len(corners) < 3:
            self._refuse(where, ring, "a ring has three or more corners", "Draw it anew.")
        return corners

    def _place(self, place: Any, where: str) -> tuple[float, float]:
        """Latitude and longitude of a position."""
        if not isinstance(place, list) or not 2 <= len(place) <= 4:
            self._refuse(where, place, "a position is [longitude, latitude]", _REMEDY)
        if not all(_is_finite(number) for number in place):
            self._refuse(where, place, "a position is made of numbers", _REMEDY)
        longitude, latitude = float(place[0]), float(place[1])
        if not -180.0 <= longitude <= 180.0 or not -90.0 <= latitude <= 90.0:
            rule = "out of range: longitude comes first, -180 to 180, then latitude, -90 to 90"
            self._refuse(where, place, rule, "Swap them, or correct them.")
        return latitude, longitude

    def _number(self, key: str) -> float:
        value: Any = self.properties.get(key)
        if not _is_finite(value):
            rule = "it must be a number" if key in self.properties else "it is missing"
            remedy = f"Give the point a property {key}, in metres."
            self._refuse(f"properties.{key}", value, rule, remedy)
        return float(value)

    def _list(self, value: Any, where: str) -> list[Any]:
        if not isinstance(value, list):
            self._refuse(where, value, "it must be a list", _REMEDY)
        return list(value)

    def _refuse(self, where: str, value: Any, rule: str, remedy: str) -> NoReturn:
        raise InputError(f"{self.label}.{where}", _shown(value), rule, remedy)


def _is_finite(value: Any) -> bool:
    """Whether it is a number of this world (an integer of a thousand digits is none)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _shown(value: Any) -> Any:
    """What to show of a value: containers by their kind, they may be long."""
    if isinstance(value, dict):
        return value.get("type", "an object")
    return value if not isinstance(value, list) or len(value) <= 4 else f"{len(value)} items"
