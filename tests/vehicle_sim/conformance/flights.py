"""What the recordings do not say of themselves, and why rows differ: flights.toml, read once.

A row that does not agree and has no reason fails the suite, and so does a reason that no row of a
recording needs.
"""

import dataclasses
import fnmatch
import functools
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import msgspec
import numpy as np

from conformance.log import Place, Recording, TimedFrame, decoded, heard
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import LidarTable, Tree, World, flat_world

_FILE = Path(__file__).with_name("flights.toml")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExcludedSpan:
    """Seconds after the first record that are not compared."""

    begin_s: float
    end_s: float
    why: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """The simulated vehicle is put where the real one was, with its course and speed, once."""

    at_s: float
    """Seconds after the first record."""
    why: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Something that was done to the simulator and not by a client's frame."""

    begin_s: float
    """Seconds after the first record, as is the end."""
    end_s: float
    what: str
    """As in a timeline file (faults/timeline.py)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Posts:
    """Round posts on a square grid, endlessly high."""

    north_m: float
    """Of the first, by the metres below from home, as the next one."""
    east_m: float
    apart_m: float
    count: int
    """A side."""
    radius_m: float
    metres_per_latitude: float
    """The recorded simulator's own flat earth."""
    metres_per_longitude: float

    def places_ne_m(self) -> list[tuple[float, float]]:
        """In those metres."""
        steps = [k * self.apart_m for k in range(self.count)]
        return [(self.north_m + north, self.east_m + east) for north in steps for east in steps]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """Why some rows of some recordings do not agree."""

    recordings: str
    """Shell pattern of the file's name."""
    kind: str
    """Regular expression for the whole kind of the row."""
    names: str
    """The same for its name."""
    why: str
    shown: str = ".*"
    """The same for what the simulated one shows."""
    most: float = math.inf
    """It explains differences up to so many tolerances."""

    def explains(self, kind: str, name: str, simulated: str, difference: float) -> bool:
        """Whether such a row of its recordings is one of them."""
        return (
            re.fullmatch(self.kind, kind) is not None
            and re.fullmatch(self.names, name) is not None
            and re.fullmatch(self.shown, simulated) is not None
            and difference <= self.most
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """The circumstances of one recording."""

    home: Place
    recording: str = ""
    """Name of its file."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    posts: Posts | None = None
    """What its lidar sees."""
    lidar: Mapping[str, Any] = field(default_factory=dict)
    """As in a world file."""
    faults: tuple[Fault, ...] = ()
    left_out: tuple[ExcludedSpan, ...] = ()
    placements: tuple[Placement, ...] = ()
    reasons: tuple[Reason, ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """The whole file."""

    flights: tuple[Flight, ...]
    reasons: tuple[Reason, ...]


@functools.cache
def _known() -> _Known:
    return msgspec.convert(tomllib.loads(_FILE.read_text(encoding="utf-8")), _Known)


def flight_of(recording: Recording) -> Flight:
    """What is known of this recording; of a strange one, what it says of itself."""
    known = _known()
    name = recording.name
    strange = Flight(home=recording.home, recording=name)
    flight = next((each for each in known.flights if each.recording == name), strange)
    reasons = tuple(r for r in known.reasons if fnmatch.fnmatchcase(name, r.recordings))
    return replace(flight, reasons=reasons)


# --- The client's half of a recorded flight into a simulation, in vehicle time.  No I/O -----------

_LINK = 0
_POST_M = 1000.0
_ATTITUDE, _GLOBAL = 30, 33


def play(recording: Recording, flight: Flight, *, seed: int = 0) -> list[TimedFrame]:
    """Everything that the simulated vehicle says while the recorded client flies it."""
    return played(simulation_of(recording, flight, seed=seed), recording, flight)


def played(flying: Simulation, recording: Recording, flight: Flight) -> list[TimedFrame]:
    """Everything that this one says then.

    A frame goes in at the first step that is not before its time.  Before the recording begins
    the vehicle boots alone, and what it says then was not recorded either.
    """
    begin_us, end_us = (round(t * 1e6) for t in (recording.begin_s, recording.end_s))
    waiting = [(round(h.time_s * 1e6), h.frame) for h in reversed(recording.sent)]
    placed_us = [round(recording.clock.vehicle_s(p.at_s) * 1e6) for p in flight.placements]
    back = list[TimedFrame]()

    def take() -> None:
        for link, frame in flying.take_frames():
            if link == _LINK and flying.now_us >= begin_us:
                back.append(heard(flying.now_us * 1e-6, frame))

    while flying.now_us <= end_us:
        if placed_us and placed_us[0] <= flying.now_us:
            _place(flying.vehicle, recording, flight, placed_us.pop(0) * 1e-6)
        while waiting and waiting[-1][0] <= flying.now_us:
            flying.receive(_LINK, waiting.pop()[1])
            take()
        flying.step()
        take()
    return back


def _place(vehicle: Vehicle, recording: Recording, flight: Flight, at_s: float) -> None:
    """Put the vehicle where the real one was at this vehicle time."""
    newest = {h.number: h for h in recording.said if h.time_s <= at_s}
    position, attitude = decoded(newest[_GLOBAL]), decoded(newest[_ATTITUDE])
    vehicle.latitude_deg, vehicle.longitude_deg = position.lat / 1e7, position.lon / 1e7
    vehicle.altitude_amsl_m = flight.home.altitude_amsl_m + position.relative_alt / 1e3
    vehicle.velocity_north_m_s, vehicle.velocity_east_m_s = position.vx / 1e2, position.vy / 1e2
    vehicle.velocity_up_m_s = -position.vz / 1e2
    vehicle.airspeed_m_s = math.hypot(position.vx, position.vy) / 1e2
    vehicle.heading_rad = math.atan2(position.vy, position.vx) % math.tau
    vehicle.roll_rad = attitude.roll


# --- The simulated vehicle that takes the place of the recorded one -------------------------------


def simulation_of(recording: Recording, flight: Flight, *, seed: int = 0) -> Simulation:
    """A vehicle of the recorded kind, where it stood, with its parameters and its faults."""
    return Simulation(world_of(recording, flight), seed=seed, faults=timeline(recording, flight))


def world_of(recording: Recording, flight: Flight) -> World:
    """Level ground at home, with the posts around it."""
    home = flight.home
    world = flat_world(
        recording.kind,
        recording.firmware,
        latitude_deg=home.latitude_deg,
        longitude_deg=home.longitude_deg,
        altitude_amsl_m=home.altitude_amsl_m,
        heading_deg=home.heading_deg,
        system_id=recording.system,
    )
    vehicle = dataclasses.replace(world.vehicle, parameters=dict(flight.parameters))
    world = dataclasses.replace(world, vehicle=vehicle)
    if flight.posts is None:
        return world
    posts = flight.posts
    places = np.array(posts.places_ne_m()) / (posts.metres_per_latitude, posts.metres_per_longitude)
    north_m, east_m = world.frame.to_local_many(
        home.latitude_deg + places[:, 0], home.longitude_deg + places[:, 1]
    )
    trees = tuple(
        Tree(north_m=north, east_m=east, radius_m=posts.radius_m, height_m=_POST_M)
        for north, east in zip(north_m.tolist(), east_m.tolist(), strict=True)
    )
    return dataclasses.replace(world, trees=trees, lidar=LidarTable(**flight.lidar))


def timeline(recording: Recording, flight: Flight) -> str:
    """The flight's faults as lines of a timeline file, in vehicle time."""
    lines = []
    for fault in flight.faults:
        begin_s, end_s = (recording.clock.vehicle_s(t) for t in (fault.begin_s, fault.end_s))
        lines.append(f"at {begin_s:.2f} s for {end_s - begin_s:.2f} s: {fault.what}\n")
    return "".join(lines)
