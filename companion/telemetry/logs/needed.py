"""The messages that the companion needs, and how to get them recorded (docs/logs.md)."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, final

from companion.mavlink.autopilots import ALL
from companion.mavlink.dialect import wire

Kind = Literal["tlog", "bin", "ulg"]


@final
@dataclass(frozen=True, slots=True)
class Missing:
    """A message that the companion needs and a log lacks."""

    message: str
    """Its MAVLink name; of several that serve alike, joined by "or"."""
    without: str
    """What is impossible without it."""
    remedy: str
    """How to get it recorded."""
    vital: bool
    """Whether the companion needs it to fly."""

    def __str__(self) -> str:
        return f"{self.message} is missing: {self.without}. {self.remedy}"


class _Need(NamedTuple):
    """One thing that the companion has to hear."""

    message: str
    without: str
    entries: str
    """Of an ArduPilot .bin, and what has them written; empty: it has nothing of it."""
    topics: str
    """Of a PX4 .ulg; empty: it is always written."""
    vital: bool = False


_ESTIMATOR: Final = "whether its estimator may be believed"
_NEEDS: Final = (
    _Need(
        "HEARTBEAT",
        "which autopilot it is, its mode and whether it is armed",
        "MODE, ARM or EV, and MSG or VER",
        "vehicle_status",
        vital=True,
    ),
    _Need(
        "GLOBAL_POSITION_INT",
        "where the vehicle is: nothing is planned",
        "POS and XKF1 (LOG_BITMASK bits 0 and 1, attitude, and 2, GPS)",
        "vehicle_global_position and vehicle_local_position",
        vital=True,
    ),
    _Need(
        "GPS_RAW_INT", "whether its GPS has a fix", "GPS (LOG_BITMASK bit 2)", "sensor_gps", True
    ),
    _Need(
        "EKF_STATUS_REPORT",
        _ESTIMATOR,
        "XKF4 (EK3_LOG_LEVEL 0, LOG_BITMASK bits 0 and 1)",
        "",
        vital=True,
    ),
    _Need("ESTIMATOR_STATUS", _ESTIMATOR, "", "estimator_status", vital=True),
    _Need(
        "EXTENDED_SYS_STATE",
        "whether it stands on the ground",
        "EV (copter) or STAT (plane)",
        "vehicle_land_detected",
    ),
    _Need("HOME_POSITION", "where home is, and how high", "ORGN", "home_position"),
    _Need(
        "GPS_GLOBAL_ORIGIN",
        "what its local frame is measured from",
        "ORGN",
        "vehicle_local_position",
    ),
    _Need(
        "SYS_STATUS or BATTERY_STATUS",
        "how much battery is left",
        "BAT (LOG_BITMASK bit 9, with BATT_MONITOR set)",
        "battery_status",
    ),
    _Need("PARAM_VALUE", "its parameters: they are not judged", "PARM", ""),
    _Need("STATUSTEXT", "what it said", "MSG", ""),
)
_OF_ITSELF: Final = {
    "PARAM_VALUE": "Fetch the parameters once while recording (a ground station does when it "
    "connects)",
    "STATUSTEXT": "It comes by itself, from PX4 only to a ground station: record there",
    "HEARTBEAT": "It comes by itself: record on a link to the autopilot",
}
"""What nobody has to ask for, on a link."""


def missing_of(kind: Kind, autopilot: int | None, heard: Collection[str]) -> tuple[Missing, ...]:
    """What of all that is missing from a log of this kind.

    autopilot: MAV_AUTOPILOT, None if it is not known; heard: MAVLink names that it has.
    """
    ways = [each for each in ALL if autopilot in (None, each.firmware.number)]
    decoded = {wire.mavlink_map[number].msgname for each in ways for number in each.decoders}
    return tuple(
        Missing(need.message, need.without, _remedy(kind, need), need.vital)
        for need in _NEEDS
        if not any(each in heard for each in need.message.split(" or "))
        and (need.without != _ESTIMATOR or need.message in decoded)
    )


def _remedy(kind: Kind, need: _Need) -> str:
    name = need.message.split(" or ")[0]
    if kind == "bin" and not need.entries:
        return "A .bin has nothing of it: record a .tlog as well"
    if kind != "tlog":
        topics = need.topics and f"{need.topics} (SDLOG_PROFILE bit 0)"
        how = need.entries if kind == "bin" else topics
        if how.endswith(")"):
            return f"Have the autopilot log {how}"
        return f"The autopilot always logs {how or 'it'}: see whether the log is whole"
    return _OF_ITSELF.get(name, "Record it: the stream rates are in docs/logs.md")
