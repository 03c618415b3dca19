"""What goes over the wire as pymavlink packs and parses it; places and courses by geodesics.

Independent of `companion.geodesy`, which projects.
"""

import math
from typing import Any

import pyproj
from pymavlink.dialects.v20 import all as wire

from companion.geodesy import LocalFrame

LATITUDE_DEG, LONGITUDE_DEG = 47.0, 8.0
FRAME = LocalFrame(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG)
GEOD = pyproj.Geod(ellps="WGS84")
SYSTEM = 7
_KINDS: dict[str, Any] = {kind.msgname: kind for kind in wire.mavlink_map.values()}


class Speaker:
    """pymavlink as who sends, with signatures of its own; without a key it does not sign."""

    def __init__(
        self, key: bytes | None = None, timestamp: int = 0, *, link: int = 0, seq: int = 0,
        **ids: int,
    ) -> None:  # fmt: skip
        """ids: srcSystem and srcComponent; an autopilot's if they are left out."""
        self.mav = wire.MAVLink(None, **{"srcSystem": 1, "srcComponent": 1, **ids})
        self.mav.signing.secret_key, self.mav.signing.link_id = key, link
        self.mav.signing.timestamp, self.mav.signing.sign_outgoing = timestamp, key is not None
        self.mav.seq = seq

    def frame(self, message: Any, **how: Any) -> bytes:
        """Each has the next sequence number."""
        frame: bytes = message.pack(self.mav, **how)
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame


def over_the_wire(message: Any, source: tuple[int, int] = (1, 1)) -> Any:
    """What the other side reads: packed to bytes by one codec, parsed by another."""
    sender = wire.MAVLink(None, srcSystem=source[0], srcComponent=source[1])
    [parsed] = wire.MAVLink(None).parse_buffer(message.pack(sender))
    return parsed


def heard(name: str, source: tuple[int, int] = (1, 1), **fields: Any) -> Any:
    """A message of a component, as it is read; what is not said of it is 0."""
    kind, values = _KINDS[name], dict(fields)
    for field, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        is_text = kind.fieldtypes[kind.fieldnames.index(field)] == "char"
        values.setdefault(field, b"" if is_text else [0] * length if length else 0)
    return over_the_wire(kind(**values), source)


def geodetic(north_m: float, east_m: float) -> tuple[float, float]:
    """A point of the azimuthal equidistant frame is at its distance and azimuth of the origin."""
    azimuth = math.degrees(math.atan2(east_m, north_m))
    longitude, latitude, _ = GEOD.fwd(
        LONGITUDE_DEG, LATITUDE_DEG, azimuth, math.hypot(north_m, east_m)
    )
    return latitude, longitude


def geodetic_e7(north_m: float, east_m: float) -> tuple[int, int]:
    """The same in the units of the wire."""
    latitude, longitude = geodetic(north_m, east_m)
    return round(latitude * 1e7), round(longitude * 1e7)


def true_course_rad(north_m: float, east_m: float, bearing_rad: float) -> float:
    """Azimuth between two points on the ground, 20 m apart along a bearing of the local frame."""
    step_north, step_east = 10.0 * math.cos(bearing_rad), 10.0 * math.sin(bearing_rad)
    behind = geodetic(north_m - step_north, east_m - step_east)
    ahead = geodetic(north_m + step_north, east_m + step_east)
    azimuth, _, _ = GEOD.inv(behind[1], behind[0], ahead[1], ahead[0])
    return math.radians(azimuth)


def angle_between(a_rad: float, b_rad: float) -> float:
    return abs(math.remainder(a_rad - b_rad, math.tau))


def assert_told(message: Any, kind: str, **expected: Any) -> None:
    """A message of this kind, and these of its fields."""
    assert message.get_type() == kind
    assert {name: getattr(message, name) for name in expected} == expected
