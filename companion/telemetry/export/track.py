"""The flown track: what the vehicle has said of where it was, from the telemetry log."""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Final, final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, wire
from companion.mavlink.frames import number_of, payload_of, sender_of
from companion.telemetry.logs import Record

IntArray = npt.NDArray[np.int64]

_POSITION: Final = wire.MAVLink_global_position_int_message
_FIELDS = tuple(_POSITION.ordered_fieldnames)
_UNPACK, _BYTES = _POSITION.unpacker.unpack, _POSITION.unpacker.size
_REBOOT_S = 2.0  # as the companion's own clock has it
_NO_HEADING = 65535


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Positions in the order in which they were recorded, N of them; each array is (N,)."""

    time_us: IntArray
    """Microseconds since 1970, of the log."""
    boot: IntArray
    """How often the autopilot had rebooted."""
    t_s: FloatArray
    """Seconds since its boot, as it says."""
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    altitude_amsl_m: FloatArray
    above_home_m: FloatArray
    north_m_s: FloatArray
    """Velocity, true north, east and up."""
    east_m_s: FloatArray
    up_m_s: FloatArray
    heading_deg: FloatArray
    """Clockwise from true north; NaN where it is not known."""
    left_out: int = 0
    """Positions before there was a fix, or that stand alone in time."""

    def __len__(self) -> int:
        return len(self.t_s)

    def part(self, chosen: slice | IntArray) -> "Track":
        """Some of the positions."""
        arrays = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        return Track(**arrays)


_ARRAYS = tuple(each.name for each in fields(Track) if each.name != "left_out")


def track_of(records: Iterable[Record], system_id: int | None) -> Track:
    """The positions of a vehicle's autopilot; of any vehicle's if system_id is None."""
    builder = TrackBuilder(system_id)
    for record in records:
        builder.take(record.time_us, record.frame)
    return builder.track()


@final
class TrackBuilder:
    """Takes frames one by one, for a log that still grows."""

    def __init__(self, system_id: int | None) -> None:
        """system_id: of the vehicle; None: any."""
        self._system_id = system_id
        self._stamps = array("q")
        self._columns: dict[str, array[float]] = {name: array("d") for name in _FIELDS}
        self._appends = [self._columns[name].append for name in _FIELDS]
        self._without = 0

    def take(self, time_us: int, frame: bytes) -> None:
        """A frame, and when it was logged."""
        if number_of(frame) != _POSITION.id:
            return
        system, component = sender_of(frame)
        if component != AUTOPILOT_COMPONENT or self._system_id not in (None, system):
            return
        values = _UNPACK(payload_of(frame, _BYTES)[:_BYTES])
        _, latitude, longitude = values[:3]
        if latitude == longitude == 0 or abs(latitude) > 900_000_000:
            self._without += 1
            return
        self._stamps.append(time_us)
        for append, value in zip(self._appends, values, strict=True):
            append(value)

    def track(self) -> Track:
        """The positions so far."""
        wired = {name: np.array(column) for name, column in self._columns.items()}
        return _track(self._stamps, wired, self._without)


def _track(stamps: "array[int]", wired: dict[str, FloatArray], without: int) -> Track:
    """The wire's integers as metres, seconds and degrees."""
    t_s = wired["time_boot_ms"] * 1e-3
    keeps = ~_strays(t_s)
    boot = np.zeros(len(t_s), dtype=np.int64)
    boot[keeps] = np.cumsum(np.diff(t_s[keeps], prepend=t_s[keeps][:1]) < -_REBOOT_S)
    heading = np.where(wired["hdg"] == _NO_HEADING, np.nan, wired["hdg"] * 1e-2)
    whole = Track(
        time_us=np.array(stamps, dtype=np.int64),
        boot=boot,
        t_s=t_s,
        latitude_deg=wired["lat"] * 1e-7,
        longitude_deg=wired["lon"] * 1e-7,
        altitude_amsl_m=wired["alt"] * 1e-3,
        above_home_m=wired["relative_alt"] * 1e-3,
        north_m_s=wired["vx"] * 1e-2,
        east_m_s=wired["vy"] * 1e-2,
        up_m_s=0.0 - wired["vz"] * 1e-2,
        heading_deg=heading,
    )
    part = whole.part(np.flatnonzero(keeps))
    left_out = without + int(np.count_nonzero(~keeps))
    return Track(**{name: getattr(part, name) for name in _ARRAYS}, left_out=left_out)


def _strays(t_s: FloatArray) -> npt.NDArray[np.bool_]:
    """Which times fall and are at once followed by one that has not: a mistake, no reboot."""
    strays = np.zeros(len(t_s), dtype=bool)
    if len(t_s) > 2:
        before, here, after = t_s[:-2], t_s[1:-1], t_s[2:]
        strays[1:-1] = (here < before - _REBOOT_S) & (after >= before - _REBOOT_S)
    return strays
