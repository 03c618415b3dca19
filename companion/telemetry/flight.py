"""A recorded flight, over or still growing: what report, view and exports read.

The journal says what was decided and when by the vehicle's clock, the log where the vehicle was
then: each entry gets its place by its time.  The vehicle's clock begins again when its autopilot
reboots: a moment is a boot and the seconds since then.
"""

import math
from array import array
from bisect import bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, Final, final

import numpy as np
import numpy.typing as npt

from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import V2, decoded, number_of, payload_of, sender_of
from companion.mission import journal as noted
from companion.mission.journal import Entry, Header, PlanReady
from companion.mission.mission import Mission
from companion.mission.state import Phase as MissionPhase
from companion.world.zones import Zone

IntArray = npt.NDArray[np.int64]

_POSITION: Final = wire.MAVLink_global_position_int_message
_COLUMNS: Final = ("time_us", *_POSITION.ordered_fieldnames)
_GPS: Final = wire.MAVLink_gps_raw_int_message
_SETPOINT: Final = wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
_NO_HEADING: Final = 65535
_REBOOT_S: Final = 2.0  # as the companion's own clock has it
_RESTARTED_S: Final = 60.0
"""An autopilot that was restarted while no companion ran has a clock that fell by more."""
_NEW_BOOT_S: Final = 1.0
"""Shown between the last position before a reboot and the first after it."""
_LEG_POINTS: Final = 2001
_HELD: Final = {MissionPhase.HOLDING.value: "hold", MissionPhase.FAULTED.value: "fault"}
_MOMENTS: Final[dict[type[Entry], tuple[str, str]]] = {
    noted.LinkLost: ("link lost", "nothing was heard for {0.silent_s:g} s"),
    noted.VehicleRebooted: ("reboot", "the autopilot has rebooted"),
    noted.PartDied: ("part died", "{0.error}"),
    noted.StopAsked: ("stop asked", "a person asked for the end"),
    noted.Resumed: ("resumed", "the companion was started again"),
    noted.End: ("end", "{0.outcome.value}: {0.reason}"),
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
        """
        t_s = np.asarray(positions[:, 1] * 1e-3, dtype=np.float64)
        strays = np.zeros(len(t_s), dtype=bool)
        if len(t_s) > 2:
            before, here, after = t_s[:-2], t_s[1:-1], t_s[2:]
            strays[1:-1] = (here < before - _REBOOT_S) & (after >= before - _REBOOT_S)
        positions, t_s = positions[~strays], t_s[~strays]
        wired = dict(zip(_COLUMNS, positions.T, strict=True))
        return Track(
            time_us=wired["time_us"],
            boot=np.cumsum(np.diff(t_s, prepend=t_s[:1]) < -_REBOOT_S),
            t_s=t_s,
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

    def part(self, chosen: slice | IntArray) -> "Track":
        """Some of the positions."""
        return Track(**{each.name: getattr(self, each.name)[chosen] for each in fields(Track)})


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Something worth a point on the map."""

    what: str
    """hold, fault, link lost, reboot, part died, stop asked, resumed or end."""
    why: str
    t_s: float
    boot: int
    code: str | None = None
    """The reason's name, if it has one."""
    until_s: float | None = None
    """When a hold was over; None: with the flight."""


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
    round_trip_s: float | None = None
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
            case noted.Fence():
                return replace(self, vehicle_zones=entry.zones)
            case noted.Targets():
                return replace(self, targets_ne_m=entry.targets_ne_m)
            case noted.OrderGiven(target_ne_m=(north_m, east_m)):
                return replace(self, targets_ne_m=((north_m, east_m),))
            case noted.LinkDelay():
                return replace(self, round_trip_s=entry.round_trip_s)
            case noted.Said(warning=True) | noted.VehicleSays():
                return replace(self, warning=entry.text)
            case _:
                return self


@final
class Flight:
    """A flight as far as it is recorded; `settle` brings up to date what follows from that."""

    def __init__(
        self,
        mission: Mission | None,
        system_id: int | None = None,
        keeps: Collection[int] = (),
    ) -> None:
        """mission: as flown; None: of a log alone.  system_id: of the vehicle; None: any.

        keeps: numbers of messages of the autopilot that are kept (`newest`).
        """
        self._mission = mission
        self.system_id = system_id
        self.track = Track.of(np.empty((0, len(_COLUMNS)), dtype=np.int64))
        self.left_out = 0
        """Positions before there was a fix, or that stand alone in time."""
        self.heard = array("q")
        """Of each frame of the autopilot: microseconds since 1970, and its sequence number."""
        self.gps = array("q")
        """Of each GPS_RAW_INT: microseconds since 1970, GPS_FIX_TYPE and satellites."""
        self.setpoints_us = array("q")
        """When the companion sent setpoints, microseconds since 1970."""
        self.entries: list[tuple[int, float, Entry]] = []
        """Boot, vehicle time and content of each line of the journal."""
        self.planned: list[PlannedSubpath] = []
        self.moments: list[Moment] = []
        self.states: list[tuple[int, float, Decided]] = []
        """Boot and vehicle time from which on something was decided, and what; there is one."""
        self.times_s: FloatArray = np.empty(0)
        """Of each position since the first one; it goes on across reboots.  (N,)"""
        self._places_nea_m: FloatArray = np.empty((0, 3))
        self._begins_s: FloatArray = np.zeros(1)
        """Of each boot, what its clock is behind."""
        self._state_times_s: list[float] = []
        self._positions = array("q")
        self._without_fix = 0
        self._kept: dict[int, tuple[list[float], list[bytes]]] = {each: ([], []) for each in keeps}
        self._timed: list[tuple[int, float, Entry]] = []
        self._boot, self._last_s, self._restarted = 0, -math.inf, False
        self.settle()

    # --- what is recorded

    def take(self, line: Header | Entry) -> None:
        """The next line of the journal."""
        if isinstance(line, Header):
            self._restarted = line.resumed is not None
            return
        fell = self._restarted and line.t_s < self._last_s - _RESTARTED_S
        self._boot += fell or isinstance(line, noted.VehicleRebooted)
        self._restarted, self._last_s = False, line.t_s
        if isinstance(line, noted.VehicleFound):
            self.system_id = line.system_id
        self._timed.append((self._boot, line.t_s, line))

    def look(self, time_us: int, frame: bytes) -> None:
        """The next frame of the log, and when it was logged."""
        number, (system, component) = number_of(frame), sender_of(frame)
        is_ours = component == AUTOPILOT_COMPONENT and self.system_id in (None, system)
        if number in self._kept and (is_ours or number == wire.MAVLINK_MSG_ID_OBSTACLE_DISTANCE):
            stamps, frames = self._kept[number]
            stamps.append(time_us * 1e-6)
            frames.append(frame)
        if is_ours:
            self.heard.extend((time_us, frame[4] if frame[0] == V2 else frame[2]))
        elif component == COMPANION_COMPONENT and number == _SETPOINT:
            self.setpoints_us.append(time_us)
        if is_ours and number == _GPS.id:
            told = dict(zip(_GPS.ordered_fieldnames, _unpacked(_GPS, frame), strict=True))
            self.gps.extend((time_us, told["fix_type"], told["satellites_visible"]))
        elif is_ours and number == _POSITION.id:
            values = _unpacked(_POSITION, frame)
            if values[1] == values[2] == 0 or abs(values[1]) > 900_000_000:
                self._without_fix += 1
            else:
                self._positions.extend((time_us, *values))

    def settle(self) -> None:
        """Bring all that is derived up to date."""
        positions = np.array(self._positions, dtype=np.int64).reshape(-1, len(_COLUMNS))
        before, self.track = len(self.track), Track.of(positions)
        self.left_out = self._without_fix + len(positions) - len(self.track)
        # of the last ones one may have been a stray
        self._places_nea_m = self._places_nea_m[: max(min(before, len(self.track)) - 2, 0)]
        t_s, boots = self.track.t_s, np.flatnonzero(np.diff(self.track.boot, prepend=-1))
        begins = [-float(t_s[0])] if len(t_s) else [0.0]
        for row in boots[1:].tolist():
            begins.append(float(t_s[row - 1]) + begins[-1] + _NEW_BOOT_S - float(t_s[row]))
        self._begins_s = np.array(begins)
        self.times_s = t_s + self._begins_s[self.track.boot]
        known = Decided(targets_ne_m=self.mission.targets_ne_m if self.has_mission else ())
        self.states, self.planned, self.moments = [(0, -math.inf, known)], [], []
        self.entries = self._with_rising_times()
        for boot, t, entry in self.entries:
            if (after := known.after(entry)) is not known:
                known = after
                self.states.append((boot, t, known))
            self._note(boot, t, entry)
        self._state_times_s = [self.time_of(boot, t) for boot, t, _ in self.states]

    def _with_rising_times(self) -> list[tuple[int, float, Entry]]:
        """Entries with times that never fall within a boot: the first may be another clock's."""
        least, risen = dict[int, float](), list[tuple[int, float, Entry]]()
        for boot, t_s, entry in reversed(self._timed):
            least[boot] = min(t_s, least.get(boot, math.inf))
            risen.append((boot, least[boot], entry))
        return risen[::-1]

    def _note(self, boot: int, t_s: float, entry: Entry) -> None:
        match entry:
            case noted.Phase():
                self._end_hold(boot, t_s)
                if (what := _HELD.get(entry.phase)) is not None:
                    why, code = entry.reason or "", entry.code
                    self.moments.append(Moment(what=what, why=why, code=code, t_s=t_s, boot=boot))
            case noted.LegBegun():
                if self.planned and self.planned[-1].leg is None:
                    self.planned[-1] = replace(self.planned[-1], leg=entry.number, begun_s=t_s)
            case PlanReady():
                self.planned.append(PlannedSubpath(plan=entry))
            case _:
                if (words := _MOMENTS.get(type(entry))) is not None:
                    what, why = words[0], words[1].format(entry)
                    self.moments.append(Moment(what=what, why=why, t_s=t_s, boot=boot))

    def _end_hold(self, boot: int, t_s: float) -> None:
        """Note until when the last hold has lasted, if it still does."""
        holds = [at for at, moment in enumerate(self.moments) if moment.what == "hold"]
        last = self.moments[holds[-1]] if holds else None
        if last is not None and last.until_s is None and last.boot == boot:
            self.moments[holds[-1]] = replace(last, until_s=t_s)

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

    @property
    def places_nea_m(self) -> FloatArray:
        """All positions in the local frame.  -> (N, 3) north, east, altitude AMSL."""
        if len(self._places_nea_m) < len(self.track):
            frame, fresh = self.frame, self.track.part(slice(len(self._places_nea_m), None))
            degrees = zip(fresh.latitude_deg.tolist(), fresh.longitude_deg.tolist(), strict=True)
            ne_m = np.array([frame.to_local_m(*each) for each in degrees]).reshape(-1, 2)
            places = np.column_stack([ne_m, fresh.altitude_amsl_m])
            self._places_nea_m = np.concatenate([self._places_nea_m, places])
        return self._places_nea_m

    def index_at(self, boot: int, t_s: float) -> int | None:
        """The position of the track that is nearest in vehicle time; None without any."""
        if not len(self.track):
            return None
        of_boot = np.flatnonzero(self.track.boot == boot)
        if not len(of_boot):
            return 0 if boot < self.track.boot[0] else len(self.track) - 1
        return int(of_boot[np.argmin(np.abs(self.track.t_s[of_boot] - t_s))])

    def time_of(self, boot: int, t_s: float) -> float:
        """A vehicle time as seconds since the first position."""
        return max(t_s + float(self._begins_s[min(boot, len(self._begins_s) - 1)]), 0.0)

    def row_at(self, time_s: float) -> int:
        """The position that was the newest, so many seconds after the first; there is one."""
        return max(int(np.searchsorted(self.times_s, time_s, "right")) - 1, 0)

    def heading_rad(self, row: int) -> float:
        """Where the nose points at a position, or it moves to, clockwise from true north."""
        track, heading_rad = self.track, math.radians(float(self.track.heading_deg[row]))
        if math.isnan(heading_rad):
            return math.atan2(float(track.east_m_s[row]), float(track.north_m_s[row]))
        return heading_rad

    def newest(self, number: int, time_s: float) -> tuple[float, Message] | None:
        """The newest message of a kind that is kept, and how old it was then, seconds."""
        stamps, frames = self._kept[number]
        row = self.row_at(time_s)
        now_s = self.track.time_us[row] * 1e-6 + (time_s - self.times_s[row])
        at = bisect_right(stamps, now_s) - 1
        if at < 0:
            return None
        return now_s - stamps[at], decoded(frames[at], wire.mavlink_map[number])

    def kept(self, number: int) -> Iterator[tuple[float, Message]]:
        """All messages of a kind that is kept, with the log's seconds since the first position."""
        began_s = self.track.time_us[0] * 1e-6
        for at_s, frame in zip(*self._kept[number], strict=True):
            yield max(at_s - began_s, 0.0), decoded(frame, wire.mavlink_map[number])

    # --- what was decided

    @property
    def targets_ne_m(self) -> tuple[tuple[float, float], ...]:
        """The newest: the mission's, the vehicle's own, or where it was sent."""
        return self.states[-1][2].targets_ne_m

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The mission's, and the vehicle's own."""
        return self.zones_of(self.states[-1][2])

    def zones_of(self, decided: Decided) -> tuple[Zone, ...]:
        """Likewise at some moment."""
        own = self.mission.task.zones if self.has_mission else ()
        return (*own, *decided.vehicle_zones)

    def decided_at(self, time_s: float) -> Decided:
        """What was decided so many seconds after the first position."""
        return self.states[max(bisect_right(self._state_times_s, time_s) - 1, 0)][2]

    def decided_at_positions(self) -> list[Decided]:
        """What was decided at each position of the track."""
        begins = np.array([boot * 1e9 + t_s for boot, t_s, _ in self.states])
        places = self.track.boot * 1e9 + self.track.t_s
        return [self.states[at - 1][2] for at in np.searchsorted(begins, places, "right")]

    def segments(self) -> list[tuple[str, slice]]:
        """Phases, and the positions in each."""
        names = [each.phase for each in self.decided_at_positions()]
        starts = [at for at, name in enumerate(names) if at == 0 or names[at - 1] != name]
        return [(names[a], slice(a, b)) for a, b in pairwise([*starts, len(names)])]

    def legs_nea_m(self) -> list[FloatArray]:
        """The subpaths that were begun, each up to where the next one begins.  -> (S, 3) each."""
        begun = [each.plan.subpath for each in self.planned if each.leg is not None]
        lines = [b.points_nea_m(np.linspace(0.0, b.length_m, _LEG_POINTS)) for b in begun]
        for at, successor in enumerate(lines[1:]):
            nearest = int(np.argmin(np.linalg.norm(lines[at] - successor[0], axis=1)))
            lines[at] = lines[at][: nearest + 1]
        return lines


def _unpacked(kind: Any, frame: bytes) -> tuple[Any, ...]:
    """The numbers of a whole frame of a kind, in the order of the wire; signed or not."""
    size = kind.unpacker.size
    return tuple(kind.unpacker.unpack(payload_of(frame, size)[:size]))
