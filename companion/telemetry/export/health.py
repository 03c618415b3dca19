"""How link and GPS were in a flight, from the telemetry log, frame by frame."""

from array import array
from typing import Final, final

import numpy as np

from companion.geodesy import FloatArray
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mavlink.frames import V2, number_of, payload_of, sender_of
from companion.telemetry.flight import IntArray
from companion.telemetry.logs import Record

_GPS: Final = wire.MAVLink_gps_raw_int_message
_AT: Final = {name: at for at, name in enumerate(_GPS.ordered_fieldnames)}
_UNPACK, _BYTES = _GPS.unpacker.unpack, _GPS.unpacker.size
_SETPOINT: Final = wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
_OLD: Final = 128  # a sequence number so far ahead is one that comes late, or twice
_UNKNOWN: Final = 255


@final
class FlightHealth:
    """Counts frames and gaps, and keeps what the GPS has said."""

    def __init__(self) -> None:
        self.heard = 0
        """Frames of the autopilot."""
        self.lost = 0
        """Frames of the autopilot that are missing, by their sequence numbers."""
        self.silence_us = 0
        """The longest time without a frame of the autopilot, microseconds."""
        self._sequence: int | None = None
        self._heard_us = 0
        self._setpoints_us = array("q")
        self._gps_us, self._fixes, self._satellites = array("q"), array("B"), array("B")

    def look(self, record: Record) -> None:
        """The next frame of the log."""
        frame, component = record.frame, sender_of(record.frame)[1]
        if component == COMPANION_COMPONENT and number_of(frame) == _SETPOINT:
            self._setpoints_us.append(record.time_us)
        if component != AUTOPILOT_COMPONENT:
            return
        sequence = frame[4] if frame[0] == V2 else frame[2]
        if self._sequence is not None:
            missing = (sequence - self._sequence - 1) % 256
            self.lost += missing if missing < _OLD else 0
            self.silence_us = max(self.silence_us, record.time_us - self._heard_us)
        self._sequence, self._heard_us = sequence, record.time_us
        self.heard += 1
        if number_of(frame) == _GPS.id:
            values = _UNPACK(payload_of(frame, _BYTES)[:_BYTES])
            self._gps_us.append(record.time_us)
            self._fixes.append(values[_AT["fix_type"]])
            self._satellites.append(values[_AT["satellites_visible"]])

    @property
    def setpoints_us(self) -> IntArray:
        """When the companion sent setpoints, microseconds since 1970.  -> (N,)."""
        return np.array(self._setpoints_us, dtype=np.int64)

    @property
    def gps_us(self) -> IntArray:
        """When the GPS said something, likewise.  -> (N,)."""
        return np.array(self._gps_us, dtype=np.int64)

    @property
    def fix_types(self) -> IntArray:
        """GPS_FIX_TYPE then; 3 and more: a fix in three dimensions.  -> (N,)."""
        return np.array(self._fixes, dtype=np.int64)

    @property
    def satellites(self) -> FloatArray:
        """Satellites seen then; NaN: not known.  -> (N,)."""
        seen = np.array(self._satellites, dtype=np.float64)
        return np.where(seen == _UNKNOWN, np.nan, seen)
