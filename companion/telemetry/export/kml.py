"""KML 2.2 with Google's gx:Track: the flight in Google Earth, with its time slider.

Altitudes are absolute, that is above mean sea level.
"""

from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from companion.geodesy import FloatArray
from companion.mission.state import Phase
from companion.telemetry.export import shapes
from companion.telemetry.export.features import Feature, features_of
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
_FOLDERS: Final = {
    "flown track": ("track",),
    "planned subpaths": ("subpath",),
    "targets": ("target", "rally"),
    "threats as known": ("keep_out", "keep_in", "radar"),
    "holds and events": ("event",),
}
"""And the kinds of features in each, which come in this order."""
_GREY, _PLANNED, _THREAT, _KEEP_IN = "7f7f7f", "ffff00", "ff0000", "00ff00"


def write_kml(flight: RecordedFlight, file: Path) -> None:
    """Write a flight.  Raises OSError if that cannot be done."""
    ET.register_namespace("", KML)
    ET.register_namespace("gx", GX)
    root = ET.Element(_kml("kml"))
    document = _add(root, "Document")
    _add(document, "name", flight.mission.name)
    _add_styles(document)
    folders: dict[str, ET.Element] = {}
    for name, kinds in _FOLDERS.items():
        folder = _add(document, "Folder")
        _add(folder, "name", name)
        folders |= dict.fromkeys(kinds, folder)
    for each in features_of(flight):
        _add_placemark(folders[each.kind], each)
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


def _add_placemark(folder: ET.Element, each: Feature) -> None:
    """The order of what is in it is the schema's: the geometry comes last."""
    mark = _add(folder, "Placemark")
    _add(mark, "name", _name(each))
    if each.kind == "event" and each.times_us is not None:
        _add(_add(mark, "TimeStamp"), "when", shapes.utc_text(each.times_us[0]))
    if (style := _style(each)) is not None:
        _add(mark, "styleUrl", f"#{style}")
    if known := {key: value for key, value in each.facts.items() if value is not None}:
        extended = _add(mark, "ExtendedData")
        for key, value in known.items():
            _add(_add(extended, "Data", name=key), "value", value)
    _add_geometry(mark, each)


def _name(each: Feature) -> str:
    facts = each.facts
    match each.kind:
        case "subpath":
            return f"{each.name}, leg {facts['leg']}" if facts["leg"] else f"{each.name}, not flown"
        case "rally":
            return each.name.replace("rally", "rally point")
        case "event":
            return f"{facts['what']}: {facts['why']}"
        case _:
            return each.name


def _style(each: Feature) -> str | None:
    if each.kind == "track":
        phase = each.name.replace(" ", "-") if each.name in PHASE_COLOURS else "other"
        return f"phase-{phase}"
    styles = {"subpath": "planned", "keep_in": "keep-in", "keep_out": "threat", "radar": "threat"}
    return styles.get(each.kind)


def _add_geometry(mark: ET.Element, each: Feature) -> None:
    if each.kind == "track" and each.times_us is not None:
        track = ET.SubElement(mark, f"{{{GX}}}Track")
        _add(track, "altitudeMode", "absolute")
        for time_us in each.times_us.tolist():
            _add(track, "when", shapes.utc_text(time_us))
        for row in each.points.tolist():
            ET.SubElement(track, f"{{{GX}}}coord").text = _row(row, " ")
    elif each.kind == "subpath":
        line = _add(mark, "LineString")
        _add(line, "altitudeMode", "absolute")
        _add(line, "coordinates", _rows(each.points))
    elif each.kind in ("target", "rally"):  # on the ground, however high that is
        longitude, latitude = each.points[0].tolist()
        _add(_add(mark, "Point"), "coordinates", _row([longitude, latitude, 0.0], ","))
    elif each.kind == "event":
        point = _add(mark, "Point")
        _add(point, "altitudeMode", "absolute")
        _add(point, "coordinates", _rows(each.points))
    else:
        polygon = _add(mark, "Polygon")
        if each.kind != "radar":
            _add(polygon, "extrude", 1)
        _add(polygon, "altitudeMode", "absolute")
        ring = _add(_add(polygon, "outerBoundaryIs"), "LinearRing")
        _add(ring, "coordinates", f"{_rows(each.points)} {_rows(each.points[:1])}")


# --- elements


def _add(parent: ET.Element, tag: str, text: object = None, /, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, _kml(tag), attributes)
    if text is not None:
        element.text = "".join(c if c.isprintable() or c in "\n\t" else " " for c in str(text))
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
