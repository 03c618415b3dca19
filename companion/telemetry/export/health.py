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
        self.setpoints_us = array("q")
        """When the companion sent setpoints, microseconds since 1970."""
        self._gps = array("q")

    def look(self, record: Record) -> None:
        """The next frame of the log."""
        frame, component = record.frame, sender_of(record.frame)[1]
        if component == COMPANION_COMPONENT and number_of(frame) == _SETPOINT:
            self.setpoints_us.append(record.time_us)
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
            said = values[_AT["fix_type"]], values[_AT["satellites_visible"]]
            self._gps.extend((record.time_us, *said))

    @property
    def gps(self) -> tuple[IntArray, IntArray, FloatArray]:
        """When the GPS spoke, fix and satellites each time, three arrays of (M,).

        Microseconds since 1970; GPS_FIX_TYPE, 3 and more: a fix in three dimensions; NaN: not known
        how many.
        """
        time_us, fixes, seen = np.array(self._gps, dtype=np.int64).reshape(-1, 3).T
        return time_us, fixes, np.where(seen == _UNKNOWN, np.nan, seen)
