"""ArduPilot's .bin, looked through once: whose it is, when it was, and what it has."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, final

from companion.mavlink.dialect import wire
from companion.telemetry.logs import dataflash
from companion.telemetry.logs.ardupilot_rows import ROWS, ArduPilotRows, Vehicle
from companion.telemetry.logs.findings import Findings, Oddity
from companion.telemetry.logs.timeline import YEAR_2000_US, YEAR_2100_US, earliest
from companion.telemetry.logs.translated import Row, Source
from companion.telemetry.logs.window import Window

_GPS_EPOCH_US: Final = 315_964_800_000_000
"""6 January 1980, in microseconds since 1970."""
_WEEK_US: Final = 7 * 86_400 * 1_000_000
_LEAP_US: Final = 18_000_000
"""GPS time is so far ahead of UTC, since 2017."""
_SAMPLE: Final = 100
_STATISTICS: Final = "DSF"
"""Of the logger itself; Dp counts what it could not write."""
_TELLING: Final = frozenset({"GPS", "MSG", "PARM", "VER"})
"""Entries that tell of the whole log."""
_SYSTEM_IDS: Final = ("MAV_SYSID", "SYSID_THISMAV")
_FRAME_TYPES: Final = {
    1: wire.MAV_TYPE_QUADROTOR,
    2: wire.MAV_TYPE_HEXAROTOR,
    3: wire.MAV_TYPE_OCTOROTOR,
    4: wire.MAV_TYPE_OCTOROTOR,
    5: wire.MAV_TYPE_HEXAROTOR,
    6: wire.MAV_TYPE_HELICOPTER,
    7: wire.MAV_TYPE_TRICOPTER,
    8: wire.MAV_TYPE_COAXIAL,
    9: wire.MAV_TYPE_COAXIAL,
    11: wire.MAV_TYPE_HELICOPTER,
    12: wire.MAV_TYPE_DODECAROTOR,
    13: wire.MAV_TYPE_HELICOPTER,
    14: wire.MAV_TYPE_DECAROTOR,
}
"""FRAME_CLASS of a copter."""
_WORDS: Final = {
    "ArduCopter": wire.MAV_TYPE_QUADROTOR,
    "APM:Copter": wire.MAV_TYPE_QUADROTOR,  # 3.3 to 3.5
    "ArduPlane": wire.MAV_TYPE_FIXED_WING,
    "ArduRover": wire.MAV_TYPE_GROUND_ROVER,
    "APMrover2": wire.MAV_TYPE_GROUND_ROVER,
    "ArduSub": wire.MAV_TYPE_SUBMARINE,
    "Blimp": wire.MAV_TYPE_AIRSHIP,
    "AntennaTracker": wire.MAV_TYPE_ANTENNA_TRACKER,
}
"""What VER.FWS, and the greeting in MSG, begin with."""


def look(path: Path) -> Source:
    """Look through a log once."""
    looked = _Look()
    with Window(path) as window:
        for row in dataflash.rows(window, Findings(), _TELLING, looked.counts):
            looked.at_row(row)
    counts = looked.counts
    vehicle = Vehicle(
        mav_type=looked.mav_type,
        has_position=counts["POS"] > 0,
        has_velocity=counts["XKF1"] + counts["NKF1"] > 0,
        has_ekf3=counts["XKF1"] > 0,
        parameters=len(looked.parameters),
    )
    return Source(
        kind="bin",
        autopilot=int(wire.MAV_AUTOPILOT_ARDUPILOTMEGA),
        system_id=looked.system_id,
        entries=sum(counts[name] for name in ROWS),
        epoch_us=looked.epoch_us,
        start_us=earliest(looked.times_us) if looked.times_us else 0,
        substitutes=tuple(_substitutes(looked, vehicle)),
        rows=_rows,
        translator=lambda: ArduPilotRows(vehicle, looked.epoch_us).on_row,
    )


def _rows(window: Window, findings: Findings) -> Iterator[Row]:
    """What is translated; what the logger could not write is noted."""
    dropped = 0
    for row in dataflash.rows(window, findings, ROWS | {_STATISTICS}):
        if row.name != _STATISTICS:
            yield row
            continue
        count = row.values.get("Dp")
        if isinstance(count, int) and count > dropped:
            findings.note(Oddity.LOST_ENTRIES, row.byte, None, count - dropped)
            dropped = count


def _substitutes(looked: "_Look", vehicle: Vehicle) -> Iterator[str]:
    counts = looked.counts
    if vehicle.mav_type is None:
        yield "no entry (VER, MSG) tells which kind of vehicle it is: no HEARTBEAT is made"
    if counts["GPS"] and not looked.times_us:
        yield "no entry tells the time since boot: all of it is told at one time"
    if not counts["ARM"] and not counts["EV"] and not counts["STAT"]:
        yield "no entry (ARM, EV, STAT) tells whether it is armed: taken for disarmed"
    if counts["GPS"] and not vehicle.has_position:
        yield "positions are those of the GPS: there is no POS"
    if counts["GPS"] and not vehicle.has_velocity:
        yield "velocities are those of the GPS: there is no XKF1"


@final
class _Look:
    """What one pass through the file has told."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.system_id = 1
        """ArduPilot's default, until a parameter says otherwise."""
        self.epoch_us: int | None = None
        self.mav_type: int | None = None
        self.parameters: set[str] = set()
        self.times_us: list[int] = []
        """Of the first entries."""
        self._frame_class = 0

    def at_row(self, row: Row) -> None:
        """One more entry."""
        if row.time_us is not None and len(self.times_us) < _SAMPLE:
            self.times_us.append(row.time_us)
        values = row.values
        try:
            match row.name:
                case "GPS" if self.epoch_us is None:
                    self.epoch_us = _epoch_us(row)
                case "PARM":
                    self._on_parameter(values["Name"], values["Value"])
                case "VER":
                    self._on_text(values.get("FWS", ""))
                case "MSG" if self.mav_type is None:
                    self._on_text(values["Message"])
        except (KeyError, TypeError, ValueError, OverflowError):
            return  # damaged: the second pass says so

    def _on_parameter(self, name: str, value: float) -> None:
        self.parameters.add(name)
        if name in _SYSTEM_IDS and 1 <= value <= 255:
            self.system_id = int(value)
        elif name == "FRAME_CLASS":
            self._frame_class = int(value)
            self._take_type(self.mav_type)

    def _on_text(self, text: str) -> None:
        for word, mav_type in _WORDS.items():
            if text.startswith(word):
                self._take_type(mav_type)

    def _take_type(self, mav_type: int | None) -> None:
        if mav_type == wire.MAV_TYPE_QUADROTOR:
            mav_type = _FRAME_TYPES.get(self._frame_class, mav_type)
        if mav_type is not None:
            self.mav_type = mav_type


def _epoch_us(row: Row) -> int | None:
    """When the vehicle booted, by a GPS entry with a fix."""
    values: Mapping[str, Any] = row.values
    old = "Week" in values  # until 3.2
    week, of_week_ms = (values[each] for each in (("Week", "TimeMS") if old else ("GWk", "GMS")))
    if values["Status"] < wire.GPS_FIX_TYPE_3D_FIX or row.time_us is None or not week:
        return None
    gps_us = week * _WEEK_US + of_week_ms * 1000
    epoch_us = int(_GPS_EPOCH_US + gps_us - _LEAP_US - row.time_us)
    return epoch_us if YEAR_2000_US <= epoch_us < YEAR_2100_US else None
