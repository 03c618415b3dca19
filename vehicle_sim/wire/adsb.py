"""Scripted aircraft, as an ADS-B receiver hears them: ADSB_VEHICLE once a second.

The receiver is wired to the autopilot, which keeps its frames off other links and sends what it has
heard as its own (ArduPilot, PX4): so here they come from the autopilot's component.
"""

import math
from collections.abc import Sequence
from typing import final

from vehicle_sim.geodesy import WGS84, LocalFrame
from vehicle_sim.wire.dialect import Prepared, make
from vehicle_sim.wire.radio import Radio
from vehicle_sim.world import Aircraft

_PERIOD_US = 1_000_000
_BASELINE_M = 100.0
_FIRST_US = 250_000  # not with everything else
_GEOMETRIC, _LIGHT, _ALL_VALID = 1, 1, 0x9F  # coordinates, altitude, course, both speeds, callsign


@final
class AdsbReceiver:
    """Hears all scripted aircraft, at any distance."""

    def __init__(self, aircraft: Sequence[Aircraft], frame: LocalFrame, radio: Radio) -> None:
        self._aircraft, self._frame, self._radio = aircraft, frame, radio
        self.due_us = _FIRST_US

    def step(self, now_us: int) -> None:
        """Say where they are now."""
        self.due_us += _PERIOD_US
        for each in self._aircraft:
            self._radio.broadcast(self._report(each, now_us * 1e-6))

    def _report(self, aircraft: Aircraft, now_s: float) -> Prepared:
        course_rad, flown_m = math.radians(aircraft.course_deg), aircraft.speed_m_s * now_s
        (latitude_deg, longitude_deg), ahead = (
            self._frame.to_geographic(
                aircraft.north_m + along_m * math.cos(course_rad),
                aircraft.east_m + along_m * math.sin(course_rad),
            )
            for along_m in (flown_m, flown_m + _BASELINE_M)
        )
        true_course_deg, _, _ = WGS84.inv(longitude_deg, latitude_deg, *ahead[::-1])
        altitude_m = aircraft.altitude_amsl_m + aircraft.climb_m_s * now_s
        return make(
            "ADSB_VEHICLE",
            ICAO_address=aircraft.icao_address,
            lat=round(latitude_deg * 1e7),
            lon=round(longitude_deg * 1e7),
            altitude_type=_GEOMETRIC,
            altitude=round(altitude_m * 1e3),
            heading=round(true_course_deg * 100.0) % 36_000,
            hor_velocity=round(aircraft.speed_m_s * 100.0),
            ver_velocity=round(aircraft.climb_m_s * 100.0),
            callsign=aircraft.callsign.encode("ascii"),
            emitter_type=_LIGHT,
            tslc=1,
            flags=_ALL_VALID,
        )
