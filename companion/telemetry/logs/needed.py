"""The messages that the companion needs, and how to get them recorded."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Literal, final

from companion.mavlink.autopilots import ALL, FIRMWARES
from companion.mavlink.dialect import wire

Kind = Literal["tlog", "bin", "ulg"]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Need:
    """One thing that the companion has to hear."""

    any_of: tuple[str, ...]
    without: str
    vital: bool = False
    by_autopilot: bool = False
    """Only of autopilots whose strategies decode it."""
    rows: str = ""
    """Of an ArduPilot .bin: the entries; empty: it has nothing of it."""
    setting: str = ""
    """What has these written; empty: they are always."""
    topics: str = ""
    """Of a PX4 .ulg; empty: it is always written."""


_ESTIMATOR: Final = "whether its estimator may be believed"
_NEEDS: Final = (
    _Need(
        any_of=("HEARTBEAT",),
        without="which autopilot it is, its mode and whether it is armed",
        vital=True,
        rows="MODE, ARM or EV, and MSG or VER",
        topics="vehicle_status",
    ),
    _Need(
        any_of=("GLOBAL_POSITION_INT",),
        without="where the vehicle is: nothing is planned",
        vital=True,
        rows="POS and XKF1",
        setting="LOG_BITMASK bits 0 and 1, attitude, and 2, GPS",
        topics="vehicle_global_position and vehicle_local_position",
    ),
    _Need(
        any_of=("GPS_RAW_INT",),
        without="whether its GPS has a fix",
        vital=True,
        rows="GPS",
        setting="LOG_BITMASK bit 2",
        topics="sensor_gps",
    ),
    _Need(
        any_of=("EKF_STATUS_REPORT",),
        without=_ESTIMATOR,
        vital=True,
        by_autopilot=True,
        rows="XKF4",
        setting="EK3_LOG_LEVEL 0, LOG_BITMASK bits 0 and 1",
    ),
    _Need(
        any_of=("ESTIMATOR_STATUS",),
        without=_ESTIMATOR,
        vital=True,
        by_autopilot=True,
        topics="estimator_status",
    ),
    _Need(
        any_of=("EXTENDED_SYS_STATE",),
        without="whether it stands on the ground",
        rows="EV (copter) or STAT (plane)",
        topics="vehicle_land_detected",
    ),
    _Need(
        any_of=("HOME_POSITION",),
        without="where home is, and how high",
        rows="ORGN",
        topics="home_position",
    ),
    _Need(
        any_of=("GPS_GLOBAL_ORIGIN",),
        without="what its local frame is measured from",
        rows="ORGN",
        topics="vehicle_local_position",
    ),
    _Need(
        any_of=("SYS_STATUS", "BATTERY_STATUS"),
        without="how much battery is left",
        rows="BAT",
        setting="LOG_BITMASK bit 9, with BATT_MONITOR set",
        topics="battery_status",
    ),
    _Need(
        any_of=("PARAM_VALUE",),
        without="its parameters: they are not judged",
        rows="PARM",
    ),
    _Need(
        any_of=("POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_GLOBAL_INT"),
        without="whether it follows what it was told: only of use where it was led",
        topics="vehicle_local_position_setpoint",
    ),
    _Need(any_of=("STATUSTEXT",), without="what it said", rows="MSG"),
)


def missing_of(kind: Kind, autopilot: int | None, heard: Collection[str]) -> tuple[Missing, ...]:
    """What of all that is missing from a log of this kind.

    autopilot: MAV_AUTOPILOT, None if it is not known; heard: MAVLink names that it has.
    """
    found = []
    ways = [each for each in ALL if autopilot in (None, each.firmware.number)]
    decoded = {wire.mavlink_map[number].msgname for each in ways for number in each.decoders}
    for need in _NEEDS:
        other = need.by_autopilot and decoded.isdisjoint(need.any_of)
        if other or any(each in heard for each in need.any_of):
            continue
        found.append(
            Missing(
                message=" or ".join(need.any_of),
                without=need.without,
                remedy=_remedy(kind, need, autopilot),
                vital=need.vital,
            )
        )
    return tuple(found)


def _remedy(kind: Kind, need: _Need, autopilot: int | None) -> str:
    name = need.any_of[0]
    if kind == "bin" and not need.rows:
        return "A .bin has nothing of it: record a .tlog as well"
    if kind == "bin":
        return _logged(need.rows, need.setting)
    if kind == "ulg":
        return _logged(need.topics, "SDLOG_PROFILE bit 0" if need.topics else "")
    if name == "PARAM_VALUE":
        return "Fetch the parameters once while recording (a ground station does when it connects)"
    if name == "STATUSTEXT":
        return "It comes by itself, from PX4 only to a ground station: record there"
    if name == "HEARTBEAT":
        return "It comes by itself: record on a link to the autopilot"
    known = [each for each in FIRMWARES if each.number == autopilot] or FIRMWARES
    said = [how for each in known if (how := each.how_to_record(name))]
    if not said:
        return "Ask for it with SET_MESSAGE_INTERVAL"
    return "; ".join([*said, "any: ask with SET_MESSAGE_INTERVAL"])


def _logged(what: str, setting: str) -> str:
    if setting:
        return f"Have the autopilot log {what} ({setting})"
    return f"The autopilot always logs {what or 'it'}: see whether the log is whole"
