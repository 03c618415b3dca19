"""Zones and radars from a file, whose format is detected by its content.

GeoJSON, KML (OGC 12-007r2, read as the GeoJSON that it corresponds to), and fence lists of
Mission Planner and MAVProxy.
"""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from companion.errors import InputError
from companion.sources.files import RawTable, read_text
from companion.sources.geojson import NoZone, Threats, read_geojson, threats_of
from companion.sources.recognised import refuse_other
from companion.sources.waypoint_file import (
    is_waypoint_list,
    read_fence_list,
    read_waypoint_fence,
)

_REMEDY: Final = (
    "Give a GeoJSON or KML file (a .kmz unzipped), or a fence list of Mission Planner or MAVProxy; "
    "see docs/files.md."
)
_GEOMETRIES: Final = (
    "Point",
    "LineString",
    "LinearRing",
    "Polygon",
    "Model",
    "Track",
    "MultiTrack",
)
_NUMBERS: Final = ("radius_m", "altitude_amsl_m", "range_m")


def read_threats(path: Path, where: str, leave_out: Collection[NoZone] = ()) -> Threats:
    """The threats of a file; leave_out: what a map may have beside zones.

    Raises InputError about it, or naming the place in it.
    """
    threats = _read(path, where, leave_out)
    if not (threats.keep_outs or threats.keep_ins or threats.radars):
        threats.notes.append(f"{path.name}: it holds no zone and no radar")
    return threats


def _read(path: Path, where: str, leave_out: Collection[NoZone]) -> Threats:
    if is_waypoint_list(path):
        plan = read_waypoint_fence(path, where)
        notes = [f"{path.name}: its {len(plan.targets)} waypoints are not flown"]
        return Threats(
            keep_outs=plan.keep_outs, keep_ins=plan.keep_ins, notes=notes if plan.targets else []
        )
    refuse_other(path, where, but_zones=True)
    text = read_text(path, where, _REMEDY)
    first = text.lstrip()[:1]
    if first == "{":
        return read_geojson(path, where, leave_out)
    if first == "<":
        return threats_of(list(_features(text, path, where)), path.name, leave_out)
    if first and first in "#+-.0123456789":
        return Threats(keep_ins=[read_fence_list(path, where)])
    raise InputError(where, str(path), "what is in it is not known", _REMEDY)


def _features(text: str, path: Path, where: str) -> Iterator[RawTable]:
    """The placemarks of a KML text, as GeoJSON features."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(where, str(path), f"not XML: {error}", _REMEDY) from None
    if _tag(root) != "kml":
        raise InputError(where, str(path), f"it is <{_tag(root)}>, not <kml>", _REMEDY)
    for placemark in _below(root, "Placemark"):
        properties: RawTable = {"name": _text(placemark, "name")}
        for datum in (*_below(placemark, "Data"), *_below(placemark, "SimpleData")):
            key = str(datum.get("name"))
            value = _text(datum, "value") if _tag(datum) == "Data" else (datum.text or "")
            properties[key] = _number(value) if key in _NUMBERS else value.strip()
        found: list[RawTable | None] = [
            {"type": _shape(geometry), "coordinates": _coordinates(geometry)}
            for geometry in placemark.iter()
            if _tag(geometry) in _GEOMETRIES and not _is_of_polygon(placemark, geometry)
        ]
        for shape in found or (None,):
            yield {"type": "Feature", "properties": properties, "geometry": shape}


def _tag(element: ElementTree.Element) -> str:
    """Its name without the namespace, which differs between versions of KML."""
    return str(element.tag).rpartition("}")[2]


def _below(element: ElementTree.Element, tag: str) -> list[ElementTree.Element]:
    return [each for each in element.iter() if _tag(each) == tag]


def _text(element: ElementTree.Element, tag: str) -> str:
    return next((each.text or "" for each in element if _tag(each) == tag), "").strip()


def _is_of_polygon(placemark: ElementTree.Element, ring: ElementTree.Element) -> bool:
    """Whether it is an outline of a polygon, and not there for itself."""
    polygons = _below(placemark, "Polygon")
    return _tag(ring) == "LinearRing" and any(ring in list(each.iter()) for each in polygons)


def _shape(geometry: ElementTree.Element) -> str:
    return "Polygon" if _tag(geometry) == "LinearRing" else _tag(geometry)


def _coordinates(geometry: ElementTree.Element) -> list[object]:
    """As GeoJSON has them: a place, or rings of places, the outer one first."""
    rings = [_places(each.text or "") for each in _below(geometry, "coordinates")]
    if _tag(geometry) == "Point":
        return list(rings[0][0]) if rings and rings[0] else []
    return list(rings)


def _places(text: str) -> list[list[object]]:
    return [[_number(number) for number in place.split(",")] for place in text.split()]


def _number(text: str) -> object:
    """The number, or the text, which is refused where a number must be."""
    try:
        return float(text)
    except ValueError:
        return text
