"""What a flight comes to in numbers, from what was recorded: the facts of its report."""

import itertools
import math
import statistics
from array import array
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, final

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mavlink.frames import V2, number_of, payload_of, sender_of
from companion.mission import journal as noted
from companion.mission.state import IN_AIR, Phase, Reason
from companion.telemetry.flight import Flight, IntArray, Moment
from companion.telemetry.logs import Record
from companion.world.columns import distances_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.radars import detection_probability

_ON_THE_WAY = {
    phase.value
    for phase in (*IN_AIR, Phase.SHADOW)
    if phase not in (Phase.TAKING_OFF, Phase.LANDING)
}
_REMEDIES = {reason.text: reason.remedy for reason in Reason}
_ANSWERS = (noted.PlanReady, noted.PlanRefused)
_STEP_S = 1.0  # between the points of a route: finer, and the noise of a hover adds up
_MOST_CELLS = 16  # about a position, in which terrain is looked for
_AT_ONCE = 4000  # positions
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


class Nearest(NamedTuple):
    """Where the vehicle, by its own word, was nearest to terrain on its way."""

    distance_m: float
    is_bound: bool
    """Whether it is farther than that."""
    time_s: float
    place_nea_m: list[float]
    place_deg: tuple[float, float]
    """Latitude and longitude."""


class Exposure(NamedTuple):
    """How long the vehicle was within ranges of radars that the mission knows."""

    length_m: float
    duration_s: float
    detection: float
    """The highest probability of detection at any position (eq. 3)."""
    radar: str
    """Whose that is."""


@final
@dataclass(frozen=True, kw_only=True)  # no slots: what takes time is computed once
class FlightFacts:
    """A recorded flight, and what it comes to; times are the vehicle's, seconds since its boot.

    After a reboot they continue as the log's do.
    """

    flight: Flight
    health: FlightHealth
    known: KnownMap | None
    """The terrain as far as it was known at the end; None: it was not recorded."""
    run: dict[str, Any]
    """What run.json says; empty without it."""
    mission_toml: str
    notes: tuple[str, ...]
    """What is missing, or odd about what was recorded, in words."""

    # --- times and places

    def time_s(self, moment: Moment) -> float:
        """The time of the report of something that happened."""
        at = self.flight.index_at(moment.boot, moment.t_s)
        return moment.t_s if at is None else float(self.times_s[at])

    def log_s(self, time_us: IntArray) -> FloatArray:
        """The time of the report of times of the log.  (N,) -> (N,)."""
        track = self.flight.track
        first_us, first_s = (track.time_us[0], track.t_s[0]) if len(track) else (0, 0.0)
        return np.asarray((time_us - first_us) * 1e-6 + first_s, dtype=np.float64)

    @cached_property
    def times_s(self) -> FloatArray:
        """When the vehicle was at each position.  -> (N,)."""
        return self.log_s(self.flight.track.time_us)

    @cached_property
    def track_nea_m(self) -> FloatArray:
        """All positions.  -> (N, 3)."""
        return self.flight.places_nea_m

    @cached_property
    def on_the_way(self) -> BoolArray:
        """Which positions are in flight, after take-off and before landing.  -> (N,)."""
        known = self.flight.decided_at_positions()
        return np.array([each.phase in _ON_THE_WAY for each in known], dtype=bool)

    @property
    def duration_s(self) -> float:
        """From the first to the last position on the way."""
        return float(np.ptp(self.times_s[self.on_the_way])) if self.on_the_way.any() else 0.0

    @property
    def vehicle(self) -> str:
        """What was flown."""
        found = (e.name for _, _, e in self.flight.entries if isinstance(e, noted.VehicleFound))
        return next(found, "")

    # --- how it ended

    @cached_property
    def end(self) -> noted.End | None:
        """The end of the mission; None: the record ends before."""
        ends = [entry for _, _, entry in self.flight.entries if isinstance(entry, noted.End)]
        return ends[-1] if ends else None

    @property
    def remedy(self) -> str:
        """What to do about a flight that has failed, if that is known."""
        reason = "" if self.end is None else self.end.reason
        return next((_REMEDIES[text] for text in _REMEDIES if reason.startswith(text)), "")

    @property
    def holds(self) -> list[Moment]:
        """When it was held, and why."""
        return [moment for moment in self.flight.moments if moment.what == "hold"]

    @property
    def held_s(self) -> float:
        """For how long in all, as far as it was recorded."""
        last_s = float(self.times_s[-1]) if len(self.times_s) else 0.0
        ends = [last_s if each.until_s is None else each.until_s for each in self.holds]
        return sum(max(end_s - h.t_s, 0.0) for h, end_s in zip(self.holds, ends, strict=True))

    # --- the route

    @cached_property
    def route_nea_m(self) -> FloatArray:
        """Where the vehicle was on its way, once a second.  -> (M, 3)."""
        chosen = np.flatnonzero(self.on_the_way)
        if not len(chosen):
            return np.empty((0, 3))
        seconds = np.floor(self.times_s[chosen] / _STEP_S)
        firsts = np.flatnonzero(np.diff(seconds, prepend=-1.0))
        return self.track_nea_m[chosen[np.union1d(firsts, [len(chosen) - 1])]]

    @property
    def flown_m(self) -> float:
        """How far it flew over ground."""
        return float(np.hypot(*np.diff(self.route_nea_m[:, :2], axis=0).T).sum())

    @cached_property
    def stations_ne_m(self) -> list[tuple[float, float]]:
        """The start of its way, and the targets; none without a way."""
        starts = [(north_m, east_m) for north_m, east_m, _ in self.route_nea_m[:1].tolist()]
        return [*starts, *self.flight.targets_ne_m] if starts else []

    @property
    def straight_m(self) -> float:
        """From the start of its way straight from target to target."""
        return sum(math.dist(a, b) for a, b in itertools.pairwise(self.stations_ne_m))

    @property
    def left_m(self) -> float:
        """Straight from where it was last to the last target."""
        return math.dist(self.route_nea_m[-1, :2], self.stations_ne_m[-1])

    @cached_property
    def clearances_m(self) -> FloatArray:
        """Distance from the known terrain at each position on the way.  -> (K,).

        In three dimensions, from columns as high as their cells; at most `clearance_reach_m`.
        """
        points = self.track_nea_m[self.on_the_way]
        if self.known is None or not len(points):
            return np.full(len(points), np.nan)
        parts = np.array_split(points, max(len(points) // _AT_ONCE, 1))
        reach_m = self.clearance_reach_m
        found = [distances_to_terrain_m(self.known, p, reach_m, seen_only=True) for p in parts]
        return np.concatenate(found)

    @property
    def clearance_reach_m(self) -> float:
        """Farther away terrain is not looked for."""
        task = self.flight.mission.task
        cell_m = task.cell_m if self.known is None else self.known.cell_m
        return max(min(8.0 * task.required_clearance_m, _MOST_CELLS * cell_m), 2.0 * cell_m)

    @cached_property
    def nearest(self) -> Nearest | None:
        """Where the way was nearest to terrain; None: no terrain or no way was recorded."""
        if not len(self.clearances_m) or math.isnan(self.clearances_m[0]):
            return None
        least = int(np.argmin(self.clearances_m))
        at = int(np.flatnonzero(self.on_the_way)[least])
        distance_m, track = float(self.clearances_m[least]), self.flight.track
        return Nearest(
            distance_m=distance_m,
            is_bound=distance_m >= self.clearance_reach_m,
            time_s=float(self.times_s[at]),
            place_nea_m=self.track_nea_m[at].tolist(),
            place_deg=(float(track.latitude_deg[at]), float(track.longitude_deg[at])),
        )

    @cached_property
    def exposure(self) -> Exposure:
        """Within radar ranges, on the way."""
        points, inside = self.track_nea_m, np.zeros(len(self.track_nea_m), dtype=bool)
        highest, whose = 0.0, ""
        for radar in self.flight.mission.task.radars:
            distances_m = radar.distance_m(points)
            inside |= distances_m <= radar.range_m
            detection = detection_probability(distances_m, radar.range_m)[self.on_the_way]
            if (most := float(detection.max(initial=0.0))) > highest:
                highest, whose = most, radar.name
        counts = (inside & self.on_the_way)[:-1] & self.on_the_way[1:]
        steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return Exposure(
            length_m=float(steps_m[counts].sum()),
            duration_s=float(np.diff(self.times_s)[counts].sum()),
            detection=highest,
            radar=whose,
        )

    # --- the plans

    @cached_property
    def legs_nea_m(self) -> tuple[FloatArray, ...]:
        """The subpaths that were begun, each as far as its successor.  -> (S, 3) each."""
        return tuple(self.flight.legs_nea_m())

    @property
    def planning_s(self) -> tuple[float, float] | None:
        """How long plans took, median and longest, wall time; None: that was not recorded."""
        told = self.run.get("planning_s")
        took_s = [t for t in told if isinstance(t, int | float)] if isinstance(told, list) else []
        return (statistics.median(took_s), max(took_s)) if took_s else None

    def count(self, kind: str) -> int:
        """How many entries of a kind the journal has."""
        return sum(entry.kind == kind for _, _, entry in self.flight.entries)

    @property
    def out_of_time(self) -> int:
        """How many plans were cut by time, found or not."""
        plans = (e for _, _, e in self.flight.entries if isinstance(e, _ANSWERS))
        return sum(plan.out_of_time for plan in plans)

    # --- link and GPS

    @property
    def setpoint_gap_s(self) -> float:
        """The longest time between two setpoints in one stretch of flying; 0: there are none."""
        sent_us, time_us, longest_us = self.health.setpoints_us, self.flight.track.time_us, 0
        for phase, part in self.flight.segments() if len(time_us) else ():
            if phase == Phase.FLYING.value:
                begin, end = np.searchsorted(sent_us, time_us[[part.start, part.stop - 1]])
                longest_us = max(longest_us, int(np.diff(sent_us[begin:end]).max(initial=0)))
        return longest_us * 1e-6

    @property
    def without_fix_s(self) -> float:
        """How long the GPS said that it had no fix in three dimensions, after its first one."""
        time_us, fixes, _ = self.health.gps
        at_s = self.log_s(time_us)
        lacks = (fixes < 3) & (np.cumsum(fixes >= 3) > 0)
        return float(np.diff(at_s, append=at_s[-1:])[lacks].sum())

    @property
    def fewest_satellites(self) -> float:
        """That the GPS saw after its first fix; NaN: it did not say."""
        _, fixes, seen = self.health.gps
        return float(np.fmin.reduce(seen[np.cumsum(fixes >= 3) > 0], initial=np.nan))
