"""What a file is, by its content, where it is not of the kind asked for, and where it belongs."""

import json
import re
from pathlib import Path
from typing import Final, NamedTuple, final

from companion.errors import InputError
from companion.sources.files import answer

_HEAD_BYTES: Final = 4096
_MAX_BYTES: Final = 64_000_000  # as for `files.read_text`
_BOM: Final = b"\xef\xbb\xbf"
_ZONES: Final = 'These are zones: name the file in a mission.toml, threats = "{name}".'
_LOG: Final = "Logs are for companion replay LOG --shadow and companion view LOG."
_SAVE: Final = "Open it in QGroundControl and save it as a .plan."
_PLAN: Final = 'Give it as the mission, or name it in a mission.toml: plan = "{name}".'
_GEOJSON_OF: Final = " GeoJSON of it: ogr2ogr -f GeoJSON zones.geojson {name}"
_FENCE: Final = "Save the fence again with Mission Planner (QGC WPL 110), or draw it as GeoJSON."
_DRAW: Final = "Draw it in QGroundControl, and save it as a .plan."
_TERRAIN: Final = 'Name it in a mission.toml: [terrain] file = "{name}", with vertical_datum.'
_MISSION: Final = "Give a mission.toml, a .plan or a waypoint list."
_PICTURE: Final = ("a picture or a document", "Give the file that it shows.")
_BINARY: Final = {
    b"\x1f\x8b": ("compressed with gzip", "Unpack it: gunzip {name}."),
    b"PK\x03\x04": (
        "a zip archive, as a .kmz is",
        "Unzip it, and give what is in it.",
    ),
    b"7z\xbc\xaf": ("a 7-zip archive", "Unpack it."),
    b"ULog\x01\x12\x35": ("a log of PX4 (.ulg)", _LOG),
    b"\xa3\x95": ("a log of ArduPilot (.bin)", _LOG),
    b"FMT, ": ("a log of ArduPilot as text (.log)", _LOG),
    b"II*\0": ("a TIFF, as elevation files are", _TERRAIN),
    b"MM\0*": ("a TIFF, as elevation files are", _TERRAIN),
    b"\x89PNG": _PICTURE,
    b"\xff\xd8\xff": _PICTURE,
    b"GIF8": _PICTURE,
    b"%PDF": _PICTURE,
    b"\xff\xfe": ("text in UTF-16", "Save it as UTF-8."),
    b"\xfe\xff": ("text in UTF-16", "Save it as UTF-8."),
    b"SQLite format 3\0": (
        "a database, as a GeoPackage is",
        "If it has zones, make" + _GEOJSON_OF + ".",
    ),
    b"\0\0\x27\x0a": ("a shapefile", "If it has zones, make" + _GEOJSON_OF + "."),
    b"version https://git-lfs": ("a pointer of Git LFS, not the file", "Fetch it: git lfs pull."),
}
"""First bytes: what it is, and what to do."""
_TLOG: Final = re.compile(rb"\0[\x03-\x07].{6}[\xfd\xfe]", re.DOTALL)
"""The stamp of a frame, microseconds since 1970 (1998 to 2041), and the frame's first byte."""
_RECORD: Final = b"\x1e"
"""Before each JSON text of a sequence (RFC 7464, RFC 8142)."""
_PLAN_IN_JSON: Final = re.compile(rb'"fileType"\s*:\s*"Plan"')
_TAG: Final = re.compile(r"<\s*(?:\w+:)?([A-Za-z]\w*)")
_PAIR: Final = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?\s+[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")
_PARAMETER: Final = re.compile(
    r"(\d+\s+\d+\s+)?[A-Z][A-Z0-9_]{2,15}[\s,]+[-+]?\d[\d.eE+-]*(\s+\d+)?"
)
_GEOJSON: Final = ("FeatureCollection", "Feature", "GeometryCollection", "Polygon", "MultiPolygon")


@final
class Recognised(NamedTuple):
    """What a file is, as "it is ...", and what to do with it."""

    what: str
    remedy: str
    is_geojson: bool


def is_plan(path: Path) -> bool:
    """Whether the file is a plan of QGroundControl, whatever its name is."""
    content = _content(path)
    return _begin(content).startswith(b"{") and _PLAN_IN_JSON.search(content) is not None


def refuse_other(path: Path, field: str, *, but_geojson: bool = False) -> None:
    """Raise InputError about the field if the file is known to be of another kind than asked for.

    but_geojson: that is asked for, and whoever reads it knows better what is wrong with other JSON.
    """
    found = recognised(path)
    if found is None or (but_geojson and (found.is_geojson or found.remedy == _MISSION)):
        return
    raise InputError(field, str(path), f"it is {found.what}", found.remedy)


def recognised(path: Path) -> Recognised | None:
    """What a file is that is no mission, world or campaign; None: that is not known."""
    content = _content(path)
    is_empty = answer(lambda: path.is_file() and path.stat().st_size == 0)
    found = ("empty", _MISSION) if is_empty else _of_bytes(content) or _of_text(content)
    if found is None:
        return None
    what, remedy = found
    name = "".join(c if c.isprintable() else "?" for c in path.name)
    return Recognised(what, remedy.replace("{name}", name), is_geojson=remedy == _ZONES)


def _content(path: Path) -> bytes:
    def fits() -> bool:
        return path.is_file() and path.stat().st_size <= _MAX_BYTES

    try:
        return path.read_bytes() if answer(fits) else b""
    except OSError:
        return b""


def _begin(content: bytes) -> bytes:
    return content[:_HEAD_BYTES].removeprefix(_BOM).lstrip()


def _of_bytes(content: bytes) -> tuple[str, str] | None:
    for magic, found in _BINARY.items():
        if content.removeprefix(_BOM).startswith(magic):
            return found
    if _TLOG.match(content):
        return "a log of MAVLink frames (.tlog)", _LOG
    if b"\0" in content[:_HEAD_BYTES]:
        return "no text", "Give a text file; see docs/files.md."
    return None


def _of_text(content: bytes) -> tuple[str, str] | None:
    begin = _begin(content)
    if begin.startswith((b"{", _RECORD)):
        return _of_json(content)
    head = begin.decode("utf-8", "replace")
    if head.startswith("<"):
        return _of_xml(head)
    if head.startswith("QGC WPL"):
        return "a list of waypoints or of a fence", _PLAN
    lines = [line.strip() for line in head.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith("#")][:3]
    if not lines:
        return None
    if all(line.upper().split()[0] == "RALLY" for line in lines):
        remedy = (
            "The companion returns along its path: rally points are only drawn, as "
            "[[rally_points]] of a mission.toml."
        )
        return "a list of rally points", remedy
    if all(_PAIR.fullmatch(line) for line in lines):
        return "a fence list of a latitude and a longitude a line, which is not read", _FENCE
    if all(_PARAMETER.fullmatch(line) for line in lines):
        return "a list of an autopilot's parameters", "Load it with a ground station."
    if len(lines) > 1 and all(line.count(",") > 1 and "=" not in line for line in lines):
        return "a table of comma-separated values", _DRAW
    return None


def _of_xml(head: str) -> tuple[str, str]:
    tags = [tag.lower() for tag in _TAG.findall(re.sub(r"<!--.*?-->", "", head, flags=re.DOTALL))]
    root = next(iter(tags), "")
    if root == "kml":
        return "KML, which is not read", f"It may hold zones: make{_GEOJSON_OF}."
    if root == "html" or head.lower().startswith("<!doctype html"):
        return "a web page", "Download the file itself (raw)."
    if root == "gpx":
        return "GPX: tracks and points", _DRAW
    return f"XML (<{root}>)", _MISSION


def _is_sequence(content: bytes) -> bool:
    """Whether the first line is a feature, and more follows: GeoJSONSeq of GDAL."""
    lines = content.removeprefix(_BOM).replace(_RECORD, b"").strip().split(b"\n", 1)
    try:
        first = json.loads(lines[0])
    except (RecursionError, ValueError):
        return False
    return isinstance(first, dict) and first.get("type") == "Feature"


def _of_json(content: bytes) -> tuple[str, str]:
    if _PLAN_IN_JSON.search(content):
        return "a plan of QGroundControl", _PLAN
    try:
        found = json.loads(content)
    except (RecursionError, ValueError):
        found = None
    if found is None and _is_sequence(content):
        return "GeoJSON with a feature a line", f"Make one{_GEOJSON_OF}."
    keys = found if isinstance(found, dict) else {}
    if keys.get("type") in _GEOJSON:
        return "GeoJSON", _ZONES
    if isinstance(keys.get("fileType"), str):
        return f"a {keys['fileType'][:40]!r} file of QGroundControl, not a plan", _SAVE
    if "MAV_AUTOPILOT" in keys or {"items", "complexItems"} & keys.keys():
        return "an old mission of QGroundControl (.mission)", _SAVE
    if keys.get("groundStation") == "QGroundControl":
        return "a file of QGroundControl, but no plan", _SAVE
    return "JSON, not TOML, and no plan of QGroundControl", _MISSION
