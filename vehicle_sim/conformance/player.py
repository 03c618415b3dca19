"""The client's half of a recorded flight into a simulation, in vehicle time.  No I/O."""

import math
from collections.abc import Iterator, Sequence
from typing import Protocol, final

from vehicle_sim.conformance.flights import Flight
from vehicle_sim.conformance.log import Recording, heard
from vehicle_sim.conformance.messages import Heard, decoded
from vehicle_sim.dynamics import Vehicle

_LINK = 0
_ATTITUDE, _GLOBAL = 30, 33


class Flying(Protocol):
    """What the player needs of a simulation."""

    @property
    def now_us(self) -> int:
        """Vehicle time."""
        ...

    def step(self) -> object:
        """Fly for one step."""
        ...

    def receive(self, link: int, data: bytes, /) -> None:
        """Handle what came in by a link."""
        ...

    @property
    def vehicle(self) -> Vehicle:
        """What flies."""
        ...

    def take_frames(self) -> Sequence[tuple[int, bytes]]:
        """What goes out, each with its link."""
        ...


@final
class Player:
    """Plays one recording.

    A frame goes in at the first step that is not before its time.  Before the recording begins
    the vehicle boots alone, and what it says then was not recorded either.
    """

    def __init__(self, flying: Flying, recording: Recording, flight: Flight) -> None:
        self._flying = flying
        self._recording = recording
        self._flight = flight

    def run(self) -> Iterator[Heard]:
        """Fly the whole recording; yields what comes back."""
        flying, recording = self._flying, self._recording
        begin_us, end_us = (round(t * 1e6) for t in (recording.begin_s, recording.end_s))
        waiting = [(round(h.time_s * 1e6), h.frame) for h in reversed(recording.sent)]
        placed_us = [
            round(recording.clock.vehicle_s(p.at_s) * 1e6) for p in self._flight.placements
        ]
        while flying.now_us <= end_us:
            if placed_us and placed_us[0] <= flying.now_us:
                self._place(placed_us.pop(0) * 1e-6)
            while waiting and waiting[-1][0] <= flying.now_us:
                flying.receive(_LINK, waiting.pop()[1])
                yield from self._out(begin_us)
            flying.step()
            yield from self._out(begin_us)

    def _place(self, at_s: float) -> None:
        """Put the vehicle where the real one was at this vehicle time."""
        newest = {h.number: h for h in self._recording.said if h.time_s <= at_s}
        position, attitude = decoded(newest[_GLOBAL]), decoded(newest[_ATTITUDE])
        vehicle = self._flying.vehicle
        vehicle.latitude_deg = position.lat / 1e7
        vehicle.longitude_deg = position.lon / 1e7
        vehicle.altitude_amsl_m = self._flight.home.altitude_amsl_m + position.relative_alt / 1e3
        vehicle.velocity_north_m_s = position.vx / 1e2
        vehicle.velocity_east_m_s = position.vy / 1e2
        vehicle.velocity_up_m_s = -position.vz / 1e2
        vehicle.airspeed_m_s = math.hypot(position.vx, position.vy) / 1e2
        vehicle.heading_rad = math.atan2(position.vy, position.vx) % math.tau
        vehicle.roll_rad = attitude.roll

    def _out(self, begin_us: int) -> Iterator[Heard]:
        now_us = self._flying.now_us
        for link, frame in self._flying.take_frames():
            if link == _LINK and now_us >= begin_us:
                yield heard(now_us * 1e-6, frame)
