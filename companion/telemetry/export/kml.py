"""KML 2.2 with Google's gx:Track: the flight in Google Earth, with its time slider.

Altitudes are absolute, that is above mean sea level.
"""

from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from companion.geodesy import FloatArray
from companion.mission.state import Phase
from companion.telemetry.export import shapes
from companion.telemetry.export.facts import (
    Facts,
    drawn_track,
    moment_facts,
    plain,
    plan_facts,
    radar_facts,
    zone_facts,
)
from companion.telemetry.export.flight import RecordedFlight

KML: Final = "http://www.opengis.net/kml/2.2"
GX: Final = "http://www.google.com/kml/ext/2.2"

PHASE_COLOURS: Final = {
    Phase.TAKING_OFF.value: "1f77b4",
    Phase.FLYING.value: "2ca02c",
    Phase.HOLDING.value: "d62728",
    Phase.ARRIVED.value: "17becf",
    Phase.RETURNING.value: "ff7f0e",
    Phase.LANDING.value: "9467bd",
    Phase.SHADOW.value: "8c564b",
    Phase.FAULTED.value: "e377c2",
}
"""Red, green, blue; phases on the ground are grey."""
_GREY, _PLANNED, _THREAT, _KEEP_IN = "7f7f7f", "ffff00", "ff0000", "00ff00"


def write_kml(flight: RecordedFlight, file: Path) -> None:
    """Write a flight.  Raises OSError if that cannot be done."""
    ET.register_namespace("", KML)
    ET.register_namespace("gx", GX)
    root = ET.Element(_kml("kml"))
    document = _add(root, "Document")
    _add(document, "name", flight.mission.name)
    _add_styles(document)
    _add_track(document, flight)
    _add_planned(document, flight)
    _add_places(document, flight)
    _add_threats(document, flight)
    _add_moments(document, flight)
    ET.indent(root, " ")
    ET.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)


# --- parts of a document


def _add_styles(document: ET.Element) -> None:
    colours = {f"phase-{name.replace(' ', '-')}": each for name, each in PHASE_COLOURS.items()}
    for name, colour in {**colours, "phase-other": _GREY, "planned": _PLANNED}.items():
        style = _add(document, "Style", id=name)
        line = _add(style, "LineStyle")
        _add(line, "color", _abgr(colour, "ff" if name != "planned" else "a0"))
        _add(line, "width", 3 if name != "planned" else 2)
    for name, colour in {"threat": _THREAT, "keep-in": _KEEP_IN}.items():
        style = _add(document, "Style", id=name)
        _add(_add(style, "LineStyle"), "color", _abgr(colour, "ff"))
        _add(_add(style, "PolyStyle"), "color", _abgr(colour, "30" if name == "threat" else "00"))


def _add_track(document: ET.Element, flight: RecordedFlight) -> None:
    folder = _folder(document, "flown track")
    for phase, piece, facts in drawn_track(flight):
        style = phase.replace(" ", "-") if phase in PHASE_COLOURS else "other"
        mark = _placemark(folder, phase, facts, style=f"phase-{style}")
        track = ET.SubElement(mark, f"{{{GX}}}Track")
        _add(track, "altitudeMode", "absolute")
        for time_us in piece.time_us.tolist():
            _add(track, "when", shapes.utc_text(time_us))
        for row in shapes.of_track(piece).tolist():
            ET.SubElement(track, f"{{{GX}}}coord").text = _row(row, " ")


def _add_planned(document: ET.Element, flight: RecordedFlight) -> None:
    folder = _folder(document, "planned subpaths")
    for each in flight.planned:
        name = f"plan {each.plan.plan_id}" + (f", leg {each.leg}" if each.leg else ", not flown")
        mark = _placemark(folder, name, plan_facts(each), style="planned")
        line = _add(mark, "LineString")
        _add(line, "altitudeMode", "absolute")
        _add(line, "coordinates", _rows(shapes.of_subpath(each.subpath, flight.mission.frame)))


def _add_places(document: ET.Element, flight: RecordedFlight) -> None:
    folder, frame = _folder(document, "targets"), flight.mission.frame
    kinds = {"target": flight.targets_ne_m, "rally point": flight.mission.rally_ne_m}
    for kind, places in kinds.items():
        for number, (north_m, east_m) in enumerate(places, start=1):
            mark = _placemark(folder, f"{kind} {number}", {})
            _add_point(mark, frame.to_geodetic_deg(north_m, east_m), None)


def _add_threats(document: ET.Element, flight: RecordedFlight) -> None:
    folder, frame = _folder(document, "threats as known"), flight.mission.frame
    ceiling_m = flight.mission.task.limits.ceiling_amsl_m
    for zone in flight.zones:
        style = "keep-in" if zone.keep_in else "threat"
        mark = _placemark(folder, zone.name, zone_facts(zone), style=style)
        _add_polygon(mark, shapes.of_zone(zone, frame, ceiling_m), extrude=True)
    for radar in flight.mission.task.radars:
        mark = _placemark(folder, radar.name, radar_facts(radar), style="threat")
        _add_polygon(mark, shapes.of_radar(radar, frame), extrude=False)


def _add_moments(document: ET.Element, flight: RecordedFlight) -> None:
    folder, track = _folder(document, "holds and events"), flight.track
    for moment in flight.moments:
        at = flight.index_at(moment.boot, moment.t_s)
        if at is None:
            continue
        name = f"{moment.what}: {moment.why}"
        mark = _placemark(folder, name, moment_facts(moment), time_us=int(track.time_us[at]))
        place = float(track.latitude_deg[at]), float(track.longitude_deg[at])
        _add_point(mark, place, float(track.altitude_amsl_m[at]))


# --- elements


def _folder(document: ET.Element, name: str) -> ET.Element:
    folder = _add(document, "Folder")
    _add(folder, "name", name)
    return folder


def _placemark(
    folder: ET.Element,
    name: str,
    facts: Facts,
    *,
    style: str | None = None,
    time_us: int | None = None,
) -> ET.Element:
    """A placemark without its geometry, which the schema wants last."""
    mark = _add(folder, "Placemark")
    _add(mark, "name", name)
    if time_us is not None:
        _add(_add(mark, "TimeStamp"), "when", shapes.utc_text(time_us))
    if style is not None:
        _add(mark, "styleUrl", f"#{style}")
    known = {key: value for key, value in facts.items() if value is not None}
    if known:
        extended = _add(mark, "ExtendedData")
        for key, value in known.items():
            _add(_add(extended, "Data", name=key), "value", value)
    return mark


def _add_point(
    mark: ET.Element, place_deg: tuple[float, float], altitude_amsl_m: float | None
) -> None:
    """A point at latitude and longitude; on the ground if its altitude is not known."""
    point = _add(mark, "Point")
    if altitude_amsl_m is not None:
        _add(point, "altitudeMode", "absolute")
    latitude_deg, longitude_deg = place_deg
    _add(point, "coordinates", _row([longitude_deg, latitude_deg, altitude_amsl_m or 0.0], ","))


def _add_polygon(mark: ET.Element, edge: FloatArray, *, extrude: bool) -> None:
    polygon = _add(mark, "Polygon")
    if extrude:
        _add(polygon, "extrude", 1)
    _add(polygon, "altitudeMode", "absolute")
    ring = _add(_add(polygon, "outerBoundaryIs"), "LinearRing")
    _add(ring, "coordinates", f"{_rows(edge)} {_rows(edge[:1])}")


def _add(parent: ET.Element, tag: str, text: object = None, /, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, _kml(tag), attributes)
    if text is not None:
        element.text = plain(str(text))
    return element


def _kml(name: str) -> str:
    return f"{{{KML}}}{name}"


def _rows(points: FloatArray) -> str:
    return " ".join(_row(point, ",") for point in points.tolist())


def _row(point: list[float], mark: str) -> str:
    longitude_deg, latitude_deg, altitude_amsl_m = point
    return mark.join((f"{longitude_deg:.7f}", f"{latitude_deg:.7f}", f"{altitude_amsl_m:.3f}"))


def _abgr(rgb: str, alpha: str) -> str:
    """A colour as KML has it: opacity, blue, green, red."""
    return f"{alpha}{rgb[4:6]}{rgb[2:4]}{rgb[0:2]}"
