"""What a file is, by its content, where it is not of the kind asked for, and where it belongs."""

import re
from pathlib import Path
from typing import Final, NamedTuple, final

from companion.errors import InputError
from companion.sources.files import MAX_BYTES, answer

_BOM: Final = b"\xef\xbb\xbf"
_LOG: Final = "Logs are for companion replay LOG --shadow and companion view LOG."
_MISSION: Final = "Give a mission.toml, a .plan or a waypoint list."
_GEOJSON_OF: Final = "make GeoJSON of it: ogr2ogr -f GeoJSON zones.geojson {name}."


@final
class Kind(NamedTuple):
    """A kind of file: how its content begins, what it is, and what to do with it."""

    begins: bytes
    """A regular expression, behind white space and a byte order mark."""
    what: str
    remedy: str


PLAN: Final = Kind(
    rb'\{.*?"fileType"\s*:\s*"Plan"',
    "a plan of QGroundControl",
    'Give it as the mission, or name it in a mission.toml: plan = "{name}".',
)
WAYPOINTS: Final = Kind(rb"QGC WPL", "a list of waypoints or of a fence", PLAN.remedy)
GEOJSON: Final = Kind(
    rb'\{.*?"type"\s*:\s*"(Feature|FeatureCollection|GeometryCollection|(Multi)?Polygon)"',
    "GeoJSON",
    'These are zones: name the file in a mission.toml, threats = "{name}".',
)
JSON: Final = Kind(rb"\{", "JSON, not TOML, and no plan of QGroundControl", _MISSION)
_KINDS: Final = (
    Kind(rb"\Z", "empty", _MISSION),
    Kind(rb"\x1f\x8b", "compressed with gzip", "Unpack it: gunzip {name}."),
    Kind(rb"PK\x03\x04", "a zip archive, as a .kmz is", "Unzip it, and give what is in it."),
    Kind(rb"ULog\x01\x12\x35", "a log of PX4 (.ulg)", _LOG),
    Kind(rb"\xa3\x95|FMT, ", "a log of ArduPilot", _LOG),
    # the stamp of a frame, microseconds since 1970 (1998 to 2041), and the frame's first byte
    Kind(rb"\0[\x03-\x07].{6}[\xfd\xfe]", "a log of MAVLink frames (.tlog)", _LOG),
    Kind(
        rb"II\*\0|MM\0\*",
        "a TIFF, as elevation files are",
        'Name it in a mission.toml: [terrain] file = "{name}", with vertical_datum.',
    ),
    Kind(rb"\x89PNG|\xff\xd8\xff|GIF8|%PDF", "a picture or a document", _MISSION),
    Kind(rb"\xff\xfe|\xfe\xff", "text in UTF-16", "Save it as UTF-8."),
    Kind(
        rb"SQLite format 3\0|\0\0\x27\x0a",
        "a GeoPackage, or a shapefile",
        f"If it has zones, {_GEOJSON_OF}",
    ),
    Kind(
        rb"version https://git-lfs",
        "a pointer of Git LFS, not the file",
        "Fetch it: git lfs pull.",
    ),
    Kind(rb"(<[?!].*?>\s*)*<(\w+:)?kml", "KML, which is not read", f"For its zones, {_GEOJSON_OF}"),
    Kind(rb"<", "a web page or other XML", _MISSION),
    WAYPOINTS,
    PLAN,
    GEOJSON,
    JSON,
    Kind(rb".{,4096}\0", "no text", "Give a text file; see docs/files.md."),
)
"""The first that fits is the one."""


def kind_of(path: Path) -> Kind | None:
    """What a file is that is no mission, world or campaign; None: that is not known."""

    def fits() -> bool:
        return path.is_file() and path.stat().st_size <= MAX_BYTES

    try:
        if not answer(fits):
            return None
        content = path.read_bytes().removeprefix(_BOM).lstrip()
    except OSError:
        return None
    return next((kind for kind in _KINDS if re.match(kind.begins, content, re.DOTALL)), None)


def refuse_other(path: Path, field: str, *taken: Kind) -> None:
    """Raise InputError about the field if the file is known to be of a kind that is not taken."""
    kind = kind_of(path)
    if kind is not None and kind not in taken:
        name = "".join(c if c.isprintable() else "?" for c in path.name)
        raise InputError(field, str(path), f"it is {kind.what}", kind.remedy.format(name=name))
