"""A recorded flight, over or still growing: what report, view and exports read.

The journal says what was decided and when by the vehicle's clock, the log where the vehicle was
then: each entry gets its place by its time.  The vehicle's clock begins again when its autopilot
reboots, so the flight has a clock of its own: seconds since the first position, which go on.
"""

import math
from array import array
from bisect import bisect_right
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import V2, decoded, number_of, payload_of, sender_of
from companion.mission import events
from companion.mission import journal as noted
from companion.mission.journal import Entry, Header, PlanReady
from companion.mission.mission import Mission
from companion.mission.state import Phase as MissionPhase
from companion.path.subpath import Subpath
from companion.world.zones import Zone

IntArray = npt.NDArray[np.int64]

_POSITION: Final = wire.MAVLink_global_position_int_message
_COLUMNS: Final = ("time_us", *_POSITION.ordered_fieldnames)
_GPS: Final = wire.MAVLink_gps_raw_int_message
_SETPOINT: Final = wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
_NO_HEADING: Final = 65535
_POLE: Final = 900_000_000
"""The greatest latitude, as the wire has it."""
_REBOOT_S: Final = 2.0  # as the companion's own clock has it
_RESTARTED_S: Final = 60.0
"""An autopilot that was restarted while no companion ran has a clock that fell by more."""
_NEW_BOOT_S: Final = 1.0
"""Shown between the last position before a reboot and the first after it."""
_SAME_S: Final = 1e-6
"""Times that are no farther apart are one."""
_LEG_POINTS: Final = 2001
_HELD: Final = {MissionPhase.HOLDING.value: "hold", MissionPhase.FAULTED.value: "fault"}
_MOMENTS: Final[dict[type[Entry], tuple[str, str]]] = {
    events.LinkLost: ("link lost", "nothing was heard for {0.silent_s:g} s"),
    events.Rebooted: ("reboot", "the autopilot has rebooted"),
    events.PlannerDied: ("part died", "{0.error}"),
    events.StopAsked: ("stop asked", "a person asked for the end"),
    noted.Resumed: ("resumed", "the companion was started again"),
    events.End: ("end", "{0.outcome.value}: {0.reason}"),
}
"""What else is worth a point on the map, and why it happened, or how."""


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

    @staticmethod
    def of(positions: IntArray) -> "Track":
        """Of the log's stamps and the wire's integers, (N, 10).

        A time that falls and is at once followed by one that has not is a mistake, no reboot.
        What was sent without a fix tells of reboots, too, and is left out then.
        """
        t_s = np.asarray(positions[:, 1] * 1e-3, dtype=np.float64)
        strays = np.zeros(len(t_s), dtype=bool)
        if len(t_s) > 2:
            before, now, after = t_s[:-2], t_s[1:-1], t_s[2:]
            strays[1:-1] = (now < before - _REBOOT_S) & (after >= before - _REBOOT_S)
        positions, t_s = positions[~strays], t_s[~strays]
        boot: IntArray = np.cumsum(np.diff(t_s, prepend=t_s[:1]) < -_REBOOT_S, dtype=np.int64)
        places = positions[:, _COLUMNS.index("lat") : _COLUMNS.index("lon") + 1]
        has_fix = places.any(axis=1) & (abs(places[:, 0]) <= _POLE)
        wired = dict(zip(_COLUMNS, positions[has_fix].T, strict=True))
        return Track(
            time_us=wired["time_us"],
            boot=boot[has_fix],
            t_s=t_s[has_fix],
            latitude_deg=wired["lat"] * 1e-7,
            longitude_deg=wired["lon"] * 1e-7,
            altitude_amsl_m=wired["alt"] * 1e-3,
            above_home_m=wired["relative_alt"] * 1e-3,
            north_m_s=wired["vx"] * 1e-2,
            east_m_s=wired["vy"] * 1e-2,
            up_m_s=0.0 - wired["vz"] * 1e-2,
            heading_deg=np.where(wired["hdg"] == _NO_HEADING, np.nan, wired["hdg"] * 1e-2),
        )

    def __len__(self) -> int:
        return len(self.t_s)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Something worth a point on the map."""

    what: str
    """hold, fault, link lost, reboot, part died, stop asked, resumed or end."""
    why: str
    t_s: float
    """Vehicle time."""
    time_s: float
    """Since the first position."""
    code: str | None = None
    """The reason's name, if it has one."""
    until_s: float | None = None
    """Vehicle time when a hold or fault was over; None: with the flight."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedSubpath:
    """A subpath and what was proven of it."""

    plan: PlanReady
    leg: int | None = None
    """Its number; None: it was never begun."""
    begun_s: float | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Decided:
    """What the journal has said up to some moment."""

    phase: str = "waiting"
    reason: str = ""
    leg: PlanReady | None = None
    """The subpath that is flown,"""
    leg_before: PlanReady | None = None
    """and the one before it."""
    leg_number: int = 0
    asked: noted.PlanAsked | None = None
    """The newest question to the planner,"""
    ready: PlanReady | None = None
    """and its newest answer."""
    targets_ne_m: tuple[tuple[float, float], ...] = ()
    vehicle_zones: tuple[Zone, ...] = ()
    warning: str = ""

    def after(self, entry: Entry) -> "Decided":
        """What is decided once an entry has been noted."""
        match entry:
            case noted.Phase():
                return replace(self, phase=entry.phase, reason=entry.reason or "")
            case noted.LegBegun():
                return replace(self, leg=self.ready, leg_before=self.leg, leg_number=entry.number)
            case noted.PlanAsked():
                return replace(self, asked=entry)
            case PlanReady():
                return replace(self, ready=entry)
            case events.FenceChanged():
                return replace(self, vehicle_zones=entry.zones)
            case events.TargetsChanged():
                return replace(self, targets_ne_m=entry.targets_ne_m)
            case noted.OrderGiven(target_ne_m=(north_m, east_m)):
                return replace(self, targets_ne_m=((north_m, east_m),))
            case events.StatusText(warning=True) | noted.VehicleSays():
                return replace(self, warning=entry.text)
            case _:
                return self


@final
class Flight:
    """A flight as far as it is recorded; `settle` brings up to date what follows from that."""

    def __init__(
        self, mission: Mission | None, system_id: int | None = None, keeps: Collection[int] = ()
    ) -> None:
        """mission: as flown; None: of a log alone.  system_id: of the vehicle; None: any.

        keeps: numbers of messages of the autopilot that are kept (`newest`).
        """
        self._mission = mission
        self.system_id = system_id
        self.left_out = 0
        """Positions since the first fix that are without one, or stand alone in time."""
        self.heard = array("q")
        """Of each frame of the autopilot: microseconds since 1970, and its sequence number."""
        self.gps = array("q")
        """Of each GPS_RAW_INT: microseconds since 1970, GPS_FIX_TYPE and satellites."""
        self.setpoints_us = array("q")
        """When the companion sent setpoints, microseconds since 1970."""
        self._positions = array("q")
        self._kept: dict[int, list[tuple[int, bytes]]] = {number: [] for number in keeps}
        self._timed: list[tuple[int, Entry]] = []
        """Each entry of the journal, and how often the autopilot had rebooted then."""
        self._boot, self._last_s, self._restarted = 0, -math.inf, False
        self.settle()

    # --- what is recorded

    def take(self, line: Header | Entry) -> None:
        """The next line of the journal."""
        if isinstance(line, Header):
            self._restarted = line.resumed is not None
            return
        fell = self._restarted and line.t_s < self._last_s - _RESTARTED_S
        self._boot += fell or isinstance(line, events.Rebooted)
        self._restarted, self._last_s = False, line.t_s
        if isinstance(line, noted.VehicleFound):
            self.system_id = line.system_id
        self._timed.append((self._boot, line))

    def look(self, time_us: int, frame: bytes) -> None:
        """The next frame of the log, and when it was logged."""
        number, (system, component) = number_of(frame), sender_of(frame)
        is_ours = component == AUTOPILOT_COMPONENT and self.system_id in (None, system)
        if component == COMPANION_COMPONENT and number == _SETPOINT:
            self.setpoints_us.append(time_us)
        if number in self._kept and (is_ours or number == wire.MAVLINK_MSG_ID_OBSTACLE_DISTANCE):
            self._kept[number].append((time_us, frame))  # a lidar speaks for itself
        if not is_ours:
            return
        self.heard.extend((time_us, frame[4] if frame[0] == V2 else frame[2]))
        if number == _GPS.id:
            fields = dict(zip(_GPS.ordered_fieldnames, _unpacked(_GPS, frame), strict=True))
            self.gps.extend((time_us, fields["fix_type"], fields["satellites_visible"]))
        elif number == _POSITION.id:
            self._positions.extend((time_us, *_unpacked(_POSITION, frame)))

    def settle(self) -> None:
        """Bring all that is derived up to date."""
        positions = np.array(self._positions, dtype=np.int64).reshape(-1, len(_COLUMNS))
        track = self.track = Track.of(positions)
        since_us = track.time_us.min(initial=np.iinfo(np.int64).max)
        self.left_out = int((positions[:, 0] >= since_us).sum()) - len(track)
        self._begins_s = self._begins_of_boots_s()
        self.times_s: FloatArray = track.t_s + np.array(self._begins_s)[track.boot]
        """Of each position since the first one; it goes on across reboots.  (N,)"""
        places = (track.latitude_deg, track.longitude_deg)
        ne_m = self.frame.to_local_m(*places) if len(track) else places
        self.places_nea_m: FloatArray = np.column_stack([*ne_m, track.altitude_amsl_m])
        """All positions in the local frame.  (N, 3) north, east, altitude AMSL."""
        self.entries = self._with_rising_times()
        """Each entry of the journal, and its time since the first position."""
        known = Decided(targets_ne_m=self.mission.targets_ne_m if self.has_mission else ())
        self.states = [(0.0, known)]
        """Times from which on something was decided, and what; there is one."""
        self.planned: list[PlannedSubpath] = []
        for time_s, entry in self.entries:
            if (after := known.after(entry)) is not known:
                known = after
                self.states.append((time_s, known))
            if isinstance(entry, PlanReady):
                self.planned.append(PlannedSubpath(plan=entry))
            elif isinstance(entry, noted.LegBegun) and known.ready is not None:
                begun = PlannedSubpath(plan=known.ready, leg=entry.number, begun_s=entry.t_s)
                if self.planned[-1].leg is None:  # else one of the way back, which was not planned
                    self.planned[-1] = begun
        self.moments = sorted(_moments(self.entries), key=lambda moment: moment.time_s)

    def _begins_of_boots_s(self) -> list[float]:
        """Of each boot, when its clock began; one without positions follows the one before it."""
        begins, next_s, track = list[float](), -math.inf, self.track
        for boot in range(max(self._boot, *track.boot[-1:].tolist(), 0) + 1):
            t_s = track.t_s[track.boot == boot]
            begins.append(next_s)
            if len(t_s):
                begins[-1] = max(next_s, 0.0) - float(t_s[0])
                next_s = begins[-1] + float(t_s[-1]) + _NEW_BOOT_S
        return begins

    def _with_rising_times(self) -> list[tuple[float, Entry]]:
        """Entries with times that never fall within a boot: the first may be another clock's."""
        least, risen = dict[int, float](), list[tuple[float, Entry]]()
        for boot, entry in reversed(self._timed):
            least[boot] = min(entry.t_s, least.get(boot, math.inf))
            risen.append((self.time_of(boot, least[boot]), entry))
        return risen[::-1]

    # --- where it was

    @property
    def has_mission(self) -> bool:
        """Whether it is of a run folder, not of a log alone."""
        return self._mission is not None

    @property
    def mission(self) -> Mission:
        """The mission as flown.  ValueError: of a log alone it is not known."""
        if self._mission is None:
            raise ValueError("a log alone does not say what the mission was")
        return self._mission

    @property
    def frame(self) -> LocalFrame:
        """The mission's local frame; of a log alone about its first position: there is one."""
        if self._mission is not None:
            return self._mission.frame
        first = (self.track.latitude_deg[0], self.track.longitude_deg[0])
        return LocalFrame(latitude_deg=float(first[0]), longitude_deg=float(first[1]))

    def time_of(self, boot: int, t_s: float) -> float:
        """A vehicle time as seconds since the first position; 0 before that."""
        return max(t_s + self._begins_s[min(boot, len(self._begins_s) - 1)], 0.0)

    def row_at(self, time_s: float) -> int:
        """The position that was the newest, so many seconds after the first; there is one."""
        return max(int(np.searchsorted(self.times_s, time_s + _SAME_S, "right")) - 1, 0)

    def heading_rad(self, row: int) -> float:
        """Where the nose points at a position, or it moves to, clockwise from true north."""
        track, heading_rad = self.track, math.radians(float(self.track.heading_deg[row]))
        if math.isnan(heading_rad):
            return math.atan2(float(track.east_m_s[row]), float(track.north_m_s[row]))
        return heading_rad

    def kept(self, number: int) -> Iterator[tuple[float, Message]]:
        """All messages of a kind that is kept, with the log's seconds since the first position."""
        for time_us, frame in self._kept[number]:
            began_us = int(self.track.time_us[0])
            yield max(time_us - began_us, 0) * 1e-6, decoded(frame, wire.mavlink_map[number])

    def newest(self, number: int, row: int, within_s: float = math.inf) -> Message | None:
        """The newest message of a kind that is kept, at a position; none if it is older."""
        time_us, kept = int(self.track.time_us[row]), self._kept[number]
        at = bisect_right(kept, time_us, key=lambda stamped: stamped[0]) - 1
        if at < 0 or time_us - kept[at][0] > 1e6 * within_s:
            return None
        return decoded(kept[at][1], wire.mavlink_map[number])

    # --- what was decided

    @property
    def decided(self) -> Decided:
        """What is decided in the end."""
        return self.states[-1][1]

    def zones_of(self, decided: Decided) -> tuple[Zone, ...]:
        """The mission's, and the vehicle's own at some moment."""
        own = self.mission.task.zones if self.has_mission else ()
        return (*own, *decided.vehicle_zones)

    def decided_at(self, times_s: FloatArray) -> list[Decided]:
        """What was decided so many seconds after the first position.  (N,)."""
        begins_s = [begin_s for begin_s, _ in self.states]
        rows = np.searchsorted(begins_s, times_s + _SAME_S, "right")
        return [self.states[max(at - 1, 0)][1] for at in rows.tolist()]

    def segments(self) -> list[tuple[str, slice]]:
        """Phases, and the positions in each."""
        names = [decided.phase for decided in self.decided_at(self.times_s)]
        starts = [at for at, name in enumerate(names) if at == 0 or names[at - 1] != name]
        return [(names[a], slice(a, b)) for a, b in pairwise([*starts, len(names)])]

    def legs_nea_m(self) -> list[FloatArray]:
        """The subpaths that were begun, each up to where the next one begins.  -> (S, 3) each."""
        return joined_nea_m(
            [planned.plan.subpath for planned in self.planned if planned.leg is not None]
        )


def joined_nea_m(subpaths: Iterable[Subpath]) -> list[FloatArray]:
    """Subpaths, each up to where the next one begins.  -> (S, 3) each."""
    lines = [b.points_nea_m(np.linspace(0.0, b.length_m, _LEG_POINTS)) for b in subpaths]
    for at, successor in enumerate(lines[1:]):
        nearest = int(np.argmin(np.linalg.norm(lines[at] - successor[0], axis=1)))
        lines[at] = lines[at][: nearest + 1]
    return lines


def _moments(entries: Sequence[tuple[float, Entry]]) -> Iterator[Moment]:
    """Holds, each up to the next phase, and what else is worth a point on the map."""
    phases = [(time_s, entry) for time_s, entry in entries if isinstance(entry, noted.Phase)]
    ends_s = [*(after.t_s for _, after in phases[1:]), None]
    for (time_s, held), until_s in zip(phases, ends_s, strict=False):
        if (what := _HELD.get(held.phase)) is not None:
            why, t_s = held.reason or "", held.t_s
            moment = Moment(what=what, why=why, code=held.code, t_s=t_s, time_s=time_s)
            yield replace(moment, until_s=until_s)
    for time_s, entry in entries:
        if (words := _MOMENTS.get(type(entry))) is not None:
            what, why = words[0], words[1].format(entry)
            yield Moment(what=what, why=why, t_s=entry.t_s, time_s=time_s)


def _unpacked(kind: Any, frame: bytes) -> tuple[Any, ...]:
    """The numbers of a whole frame of a kind, in the order of the wire; signed or not."""
    size = kind.unpacker.size
    return tuple(kind.unpacker.unpack(payload_of(frame, size)[:size]))
