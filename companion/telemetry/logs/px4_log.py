"""PX4's .ulg, looked through once: whose it is, when it was, and what it has."""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final, final

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.telemetry.logs import ulog
from companion.telemetry.logs.findings import Findings
from companion.telemetry.logs.px4_rows import TOPICS, Px4Rows, Vehicle
from companion.telemetry.logs.timeline import YEAR_2000_US, YEAR_2100_US, earliest
from companion.telemetry.logs.translated import LONGEST_US, Row, Source
from companion.telemetry.logs.window import Window

_FLAGS_AT: Final = ulog.HEADER_BYTES + 3
_APPENDED: Final = 0x01
"""The one flag that changes nothing here: data follows that was written after a crash."""
_SAMPLE: Final = 200
_TELLING: Final = frozenset({"sensor_gps", "vehicle_gps_position", "vehicle_status"})
"""Topics that tell of the whole log, or when it began."""


def look(path: Path) -> Source:
    """Look through a log once.  InputError if it is of a later format."""
    looked = _Look()
    with Window(path) as window:
        window.more(0)
        _check_flags(path, window.data)
        begun_us = int.from_bytes(window.data[8:16].ljust(8, b"\0"), "little")
        for row in ulog.rows(window, Findings(), _TELLING, looked.counts):
            looked.at_row(row)
    times = sorted(looked.times_us)
    sane = bool(times) and 0 <= times[len(times) // 2] - begun_us < LONGEST_US
    fallback_us = earliest(looked.times_us) if times else 0
    start_us = begun_us if sane else fallback_us
    # what the vehicle's clock says at the time that is taken for its boot
    zero_us = start_us if start_us >= YEAR_2000_US else 0
    epoch_us = looked.epoch_us
    if zero_us and epoch_us is None:
        epoch_us = zero_us
    counts = looked.counts
    vehicle = Vehicle(
        has_global_position=counts["vehicle_global_position"] > 0,
        has_sensor_gps=counts["sensor_gps"] > 0,
        has_estimator_status=counts["estimator_status"] > 0,
        parameters=len(looked.parameters),
    )

    def rows(window: Window, findings: Findings) -> Iterator[Row]:
        """What was published before the log began is told at its beginning."""
        for row in ulog.rows(window, findings, TOPICS):
            if row.time_us is None or not (zero_us or row.time_us < start_us):
                yield row
            else:
                early = row.time_us < start_us
                yield row._replace(time_us=None if early else row.time_us - zero_us)

    return Source(
        kind="ulg",
        autopilot=int(wire.MAV_AUTOPILOT_PX4),
        system_id=looked.system_id,
        entries=sum(counts[name] for name in TOPICS),
        epoch_us=epoch_us,
        start_us=start_us - zero_us,
        substitutes=tuple(_substitutes(counts, vehicle, has_date=bool(zero_us))),
        rows=rows,
        translator=lambda: Px4Rows(vehicle, epoch_us).on_row,
    )


def _substitutes(counts: Counter[str], vehicle: Vehicle, *, has_date: bool) -> Iterator[str]:
    if has_date:
        yield "the vehicle's clock is a date: its boot is taken to be the log's beginning"
    if counts["vehicle_local_position"]:
        if not vehicle.has_global_position:
            yield "positions are those of vehicle_local_position, about its origin"
        if not vehicle.has_estimator_status:
            yield (
                "ESTIMATOR_STATUS is made of vehicle_local_position and "
                "estimator_status_flags: there is no estimator_status"
            )
    if counts["vehicle_gps_position"] and not vehicle.has_sensor_gps:
        yield "GPS_RAW_INT is made of vehicle_gps_position: there is no sensor_gps"


def _check_flags(path: Path, head: bytes) -> None:
    """InputError if the log says that it cannot be read like this."""
    flags = head[_FLAGS_AT + 8 : _FLAGS_AT + 16]
    if head[_FLAGS_AT - 1 : _FLAGS_AT] == b"B" and (any(flags[1:]) or flags[:1] > b"\x01"):
        rule = f"its flags {flags.hex()} say that it must not be read by who does not know them"
        raise InputError("log", str(path), rule, "Convert it to the present ULog format.")


@final
class _Look:
    """What one pass through the file has told."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.system_id = 1
        """PX4's default, until the log says otherwise."""
        self.epoch_us: int | None = None
        self.parameters: set[str] = set()
        self.times_us: list[int] = []
        self._has_gps_time = False

    def at_row(self, row: Row) -> None:
        """One more entry."""
        if row.name in (ulog.PARAMETER, ulog.TEXT):
            self.counts[row.name] += 1
        if row.time_us is not None and len(self.times_us) < _SAMPLE:
            self.times_us.append(row.time_us)
        try:
            match row.name:
                case ulog.PARAMETER:
                    self.parameters.add(row.values["key"])
                    if row.values["key"] == "MAV_SYS_ID" and 1 <= row.values["value"] <= 255:
                        self.system_id = int(row.values["value"])
                case ulog.INFORMATION:
                    if row.values["key"] == "boot_time_utc_us" and not self._has_gps_time:
                        self._take_epoch(row.values["value"])
                case "sensor_gps" | "vehicle_gps_position" if not self._has_gps_time:
                    unix_us = row.values["time_utc_usec"]
                    self._has_gps_time = self._take_epoch(unix_us - row.values["timestamp"])
        except (KeyError, TypeError, ValueError, OverflowError, struct.error):
            return  # damaged: the second pass says so

    def _take_epoch(self, epoch_us: float) -> bool:
        if not YEAR_2000_US <= epoch_us < YEAR_2100_US:
            return False
        self.epoch_us = int(epoch_us)
        return True
