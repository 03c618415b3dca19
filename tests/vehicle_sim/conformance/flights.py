"""A recorded flight, what it does not say of itself (flights.toml), and its client flown again."""

import contextlib
import dataclasses
import functools
import lzma
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from harness import Heard, Rig
from numpy.typing import NDArray

from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.parameters import Firmware
from vehicle_sim.world import VehicleKind

_HEARTBEAT, _GLOBAL = 0, 33
_STAMPED = {30, 32, 33}
"""ATTITUDE, LOCAL_POSITION_NED and GLOBAL_POSITION_INT begin with time_boot_ms."""
_FIRMWARES: dict[int, Firmware] = {3: "ardupilot", 12: "px4"}
_FIXED_WING = 1
FloatArray = NDArray[np.float64]


class Side:
    """Everything that one autopilot said, by message."""

    def __init__(self, said: Iterable[Heard]) -> None:
        self._heard = defaultdict[int, list[Heard]](list)
        for one in said:
            self._heard[one.number].append(one)
        self.numbers = {*self._heard}

    def heard(self, number: int) -> Sequence[Heard]:
        return self._heard[number]

    def of(self, number: int) -> Sequence[tuple[float, Any]]:
        """Time and message of each of these."""
        return [(one.at_s, one.message) for one in self._heard[number]]


# --- log time and vehicle time --------------------------------------------------------------------


class Clock:
    """Seconds since the first record of a log <-> seconds since the autopilot's boot.

    A stamp is never older than its record, but it may have waited on the way: in each second of
    the log the one that waited least counts.  Outside of all stamps both clocks run alike.
    """

    def __init__(self, stamps: Iterable[tuple[float, float]]) -> None:
        """Pairs of log time and the vehicle time that the record carries."""
        best = dict[int, tuple[float, float]]()
        for log_s, vehicle_s in stamps:
            known = best.get(int(log_s))
            if known is None or vehicle_s - log_s > known[1] - known[0]:
                best[int(log_s)] = (log_s, vehicle_s)
        self._log_s, told_s = np.array(sorted(best.values()) or [(0.0, 0.0)]).T
        self._told_s = np.maximum.accumulate(told_s)

    def vehicle_s(self, log_s: float) -> float:
        return log_s + float(np.interp(log_s, self._log_s, self._told_s - self._log_s))

    def log_s(self, vehicle_s: float) -> float:
        return vehicle_s + float(np.interp(vehicle_s, self._told_s, self._log_s - self._told_s))


# --- the recording --------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recording:
    name: str
    """Of the file, without folder and .xz."""
    firmware: Firmware
    kind: VehicleKind
    system: int
    sent: Sequence[Heard]
    """By the clients: everything that does not come from the autopilot."""
    side: Side
    """Of the autopilot."""
    begin_s: float
    end_s: float
    clock: Clock


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Microseconds since 1970 and frame of each complete record of a .tlog of MAVLink 2.

    Each is 8 bytes of time, big-endian, and a frame.
    """
    at = 0
    while at + 11 <= len(data):
        end = at + 20 + data[at + 9] + 13 * (data[at + 10] & 1)
        if end <= len(data):
            yield int.from_bytes(data[at : at + 8], "big"), data[at + 8 : end]
        at = end


def read_recording(path: Path) -> Recording:
    """The flight in this file, a .tlog or .tlog.xz.  InputError if it is none."""
    data = path.read_bytes()
    if path.suffix == ".xz":
        with contextlib.suppress(lzma.LZMAError):  # then nobody speaks in it
            data = lzma.decompress(data)
    told = list(records(data))
    raw = [Heard((time_us - told[0][0]) * 1e-6, frame) for time_us, frame in told]
    beats = (one for one in raw if one.number == _HEARTBEAT)
    beat = next((one for one in beats if one.message.autopilot in _FIRMWARES), None)
    if beat is None:
        raise InputError("LOG", str(path), "no autopilot speaks in it", "Name a .tlog or .tlog.xz.")
    clock = Clock(
        # zeros at the end of a payload are left out
        (one.at_s, int.from_bytes(one.frame[10 : 10 + min(4, one.frame[1])], "little") * 1e-3)
        for one in raw
        if one.number in _STAMPED and one.source == beat.source
    )
    timed = [Heard(clock.vehicle_s(one.at_s), one.frame) for one in raw]
    return Recording(
        name=path.name.removesuffix(".xz"),
        firmware=_FIRMWARES[beat.message.autopilot],
        kind="plane" if beat.message.type == _FIXED_WING else "copter",
        system=beat.source[0],
        sent=[one for one in timed if one.source != beat.source],
        side=Side(one for one in timed if one.source == beat.source),
        begin_s=timed[0].at_s,
        end_s=timed[-1].at_s,
        clock=clock,
    )


# --- what it does not say of itself; times are seconds after the first record --------------------


class Span(msgspec.Struct, frozen=True, kw_only=True):
    """Something from one time to another: left out, with why, or a fault, as in a timeline file."""

    begin_s: float
    end_s: float
    why: str = ""
    what: str = ""


class Posts(msgspec.Struct, frozen=True, kw_only=True):
    """Round posts on a square grid, endlessly high."""

    north_m: float
    """Of the first, by the metres below from home, as the next one."""
    east_m: float
    apart_m: float
    count: int
    """A side."""
    radius_m: float
    metres_per_degree: tuple[float, float]
    """Of latitude and of longitude, on the recorded simulator's own flat earth."""

    def places_ne_m(self) -> FloatArray:
        """In those metres.  -> (count^2, 2)."""
        steps = self.apart_m * np.moveaxis(np.indices((self.count, self.count)), 0, -1)
        return np.array((self.north_m, self.east_m)) + steps.reshape(-1, 2)


class Reason(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Why some rows do not agree: regular expressions for the whole of what they say."""

    kind: str
    names: str
    shown: str
    """What the simulated one shows."""
    most: float
    """It explains differences up to so many tolerances."""
    why: str

    def explains(self, row: Any) -> bool:
        told = ((self.kind, row.kind), (self.names, row.name), (self.shown, row.shown[1]))
        return row.difference <= self.most and all(re.fullmatch(*each) for each in told)


class Flight(msgspec.Struct, frozen=True, kw_only=True):
    """The circumstances of one recording."""

    recording: str
    """Name of its file."""
    home: tuple[float, float, float, float]
    """Before it: latitude and longitude in degrees, metres AMSL, the heading in degrees."""
    parameters: Mapping[str, float] = {}
    posts: Posts | None = None
    """What its lidar sees."""
    lidar: Mapping[str, Any] = {}
    """As in a world file."""
    faults: Sequence[Span] = ()
    """Done to the simulator, and not by a client's frame."""
    left_out: Sequence[Span] = ()
    placed_at_s: float | None = None
    """When the simulated vehicle is put where the real one was, with its course and speed."""
    reasons: Sequence[Reason] = ()


@functools.cache
def _known() -> dict[str, Flight]:
    data = Path(__file__).with_name("flights.toml").read_bytes()
    tables = msgspec.toml.decode(data, type=dict[str, list[Flight]])
    return {flight.recording: flight for flight in tables["flights"]}


def flight_of(name: str) -> Flight:
    """What is known of the recording of this name; InputError if that is nothing."""
    if name not in _known():
        rule = "nobody knows where its vehicle stood"
        raise InputError("LOG", name, rule, "Add a [[flights]] with its home to flights.toml.")
    return _known()[name]


# --- the client's half of it into a simulation, in vehicle time -----------------------------------

_POST_M = 1000.0
_INSTANT_S = 1e-6


def play(recording: Recording, flight: Flight) -> list[Heard]:
    """Everything that the simulated vehicle says while the recorded client flies it.

    A frame goes in at the first step that is not before its time.  Before the recording begins
    the vehicle boots alone, and what it says then was not recorded either.
    """
    rig, placed_s = rig_of(recording, flight), math.inf
    if flight.placed_at_s is not None:
        placed_s = recording.clock.vehicle_s(flight.placed_at_s)
    waiting = list(reversed(recording.sent))
    while rig.now_s <= recording.end_s:
        if placed_s <= rig.now_s:
            *_, now = (message for at_s, message in recording.side.of(_GLOBAL) if at_s <= placed_s)
            place = (now.lat / 1e7, now.lon / 1e7, flight.home[2] + now.relative_alt / 1e3)
            rig.put_at(place, complex(now.vx, now.vy) / 1e2)
            placed_s = math.inf
        while waiting and waiting[-1].at_s <= rig.now_s + _INSTANT_S:
            rig.put(waiting.pop().frame)
        rig.step()
    return [each for each in rig.heard if each.link == 0 and each.at_s >= recording.begin_s]


def rig_of(recording: Recording, flight: Flight) -> Rig:
    """A vehicle of that kind at home, with the posts around it."""
    posts, told = flight.posts, dict[str, Any](flight.parameters)
    place, heading_deg = flight.home[:3], flight.home[3]
    if posts is not None:
        at_deg = np.array(place[:2]) + posts.places_ne_m() / posts.metres_per_degree
        frame = LocalFrame(latitude_deg=place[0], longitude_deg=place[1])
        size = {"radius_m": posts.radius_m, "height_m": _POST_M}
        places = zip(*frame.to_local_many(*at_deg.T), strict=True)
        told["trees"] = [{"north_m": float(n), "east_m": float(e)} | size for n, e in places]
        told["lidar"] = flight.lidar
    told |= {"heading_deg": heading_deg, "system_id": recording.system}
    clock, faults = recording.clock, ""
    for each in flight.faults:
        begin_s, end_s = (clock.vehicle_s(t) for t in (each.begin_s, each.end_s))
        faults += f"at {begin_s:.2f} s for {end_s - begin_s:.2f} s: {each.what}\n"
    return Rig(recording.firmware, recording.kind, place, faults=faults, **told)
