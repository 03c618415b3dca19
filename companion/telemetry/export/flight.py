"""What a run folder tells of a flight, put together for all formats: places, times and reasons.

The journal says what was decided and when by the vehicle's clock, the log where the vehicle was
then: each entry gets its place by its time.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.mission import journal as noted
from companion.mission.journal import Entry, Header, PlanReady
from companion.mission.mission import Mission
from companion.mission.state import Phase as MissionPhase
from companion.telemetry.export.track import Track
from companion.world.zones import Zone

_LEG_POINTS = 2001
_LATER_S = 60.0  # an autopilot that was restarted while no companion ran has a clock that fell


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

    def zones_of(self, mission: Mission) -> tuple[Zone, ...]:
        """The mission's, and the vehicle's own."""
        return (*mission.task.zones, *self.vehicle_zones)


def decided(
    mission: Mission, timed: list[tuple[int, float, Entry]]
) -> Iterator[tuple[int, float, Entry, Decided]]:
    """Each entry with its boot and vehicle time, and what is decided from then on."""
    known = Decided(targets_ne_m=mission.targets_ne_m)
    for boot, t_s, entry in _with_rising_times(timed):
        known = known.after(entry)
        yield boot, t_s, entry, known


@final
@dataclass(slots=True, kw_only=True)
class RecordedFlight:
    """A flight, as far as it was recorded."""

    mission: Mission
    track: Track
    system_id: int | None = None
    planned: list[PlannedSubpath] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    states: list[tuple[int, float, Decided]]
    """Boot and vehicle time from which on something was decided, and what; there is one."""
    entries: list[tuple[int, float, Entry]] = field(default_factory=list)
    """Boot, vehicle time and content of each line of the journal."""

    @property
    def targets_ne_m(self) -> tuple[tuple[float, float], ...]:
        """The newest: the mission's, the vehicle's own, or where it was sent."""
        return self.states[-1][2].targets_ne_m

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The mission's, the vehicle's own, and those ordered in flight."""
        return self.states[-1][2].zones_of(self.mission)

    def decided_at_positions(self) -> list[Decided]:
        """What was decided at each position of the track."""
        begins = _keys((boot, t_s) for boot, t_s, _ in self.states)
        places = _keys(zip(self.track.boot, self.track.t_s, strict=True))
        return [self.states[at - 1][2] for at in np.searchsorted(begins, places, "right")]

    def phase_of_positions(self) -> list[str]:
        """The phase at each position of the track."""
        return [each.phase for each in self.decided_at_positions()]

    def segments(self) -> list[tuple[str, slice]]:
        """Phases, and the positions in each."""
        names = self.phase_of_positions()
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

    def index_at(self, boot: int, t_s: float) -> int | None:
        """The position of the track that is nearest in vehicle time; None without any."""
        if not len(self.track):
            return None
        of_boot = np.flatnonzero(self.track.boot == boot)
        if not len(of_boot):
            return 0 if boot < self.track.boot[0] else len(self.track) - 1
        return int(of_boot[np.argmin(np.abs(self.track.t_s[of_boot] - t_s))])


def _keys(moments: Iterable[tuple[int, float]]) -> FloatArray:
    """Numbers that rise as boots and vehicle times do."""
    return np.array([boot * 1e9 + t_s for boot, t_s in moments], dtype=np.float64)


@final
class FlightBuilder:
    """Takes the lines of a journal one by one; needs the track only at the end."""

    def __init__(self, mission: Mission) -> None:
        self.system_id: int | None = None
        """Of the vehicle that was found."""
        self._mission = mission
        self.timed: list[tuple[int, float, Entry]] = []
        """Each entry with its vehicle time, and how often the autopilot had rebooted."""
        self._boot, self._last_s = 0, -math.inf
        self._restarted = False

    def take(self, line: Header | Entry) -> None:
        """The next line."""
        if isinstance(line, Header):
            self._restarted = line.resumed is not None
            return
        fell = self._restarted and line.t_s < self._last_s - _LATER_S
        self._boot += fell or isinstance(line, noted.VehicleRebooted)
        self._restarted, self._last_s = False, line.t_s
        if isinstance(line, noted.VehicleFound):
            self.system_id = line.system_id
        self.timed.append((self._boot, line.t_s, line))

    def flight(self, track: Track) -> RecordedFlight:
        """All of it, with the track of the same flight."""
        flight = RecordedFlight(
            mission=self._mission,
            track=track,
            system_id=self.system_id,
            states=[(0, -math.inf, Decided(targets_ne_m=self._mission.targets_ne_m))],
        )
        for boot, t_s, entry, after in decided(self._mission, self.timed):
            flight.entries.append((boot, t_s, entry))
            if after is not flight.states[-1][2]:
                flight.states.append((boot, t_s, after))
            _add(flight, boot, t_s, entry)
        return flight


_HELD = {MissionPhase.HOLDING.value: "hold", MissionPhase.FAULTED.value: "fault"}
_MOMENTS: dict[type[Entry], tuple[str, str]] = {
    noted.LinkLost: ("link lost", "nothing was heard for {0.silent_s:g} s"),
    noted.VehicleRebooted: ("reboot", "the autopilot has rebooted"),
    noted.PartDied: ("part died", "{0.error}"),
    noted.StopAsked: ("stop asked", "a person asked for the end"),
    noted.Resumed: ("resumed", "the companion was started again"),
    noted.End: ("end", "{0.outcome}: {0.reason}"),
}
"""What else is worth a point on the map, and why it happened, or how."""


def _with_rising_times(timed: list[tuple[int, float, Entry]]) -> list[tuple[int, float, Entry]]:
    """The same with times that never fall within a boot: the first ones may be another clock's."""
    least: dict[int, float] = {}
    for place in range(len(timed) - 1, -1, -1):
        boot, t_s, entry = timed[place]
        least[boot] = min(t_s, least.get(boot, math.inf))
        timed[place] = (boot, least[boot], entry)
    return timed


def _add(flight: RecordedFlight, boot: int, t_s: float, entry: Entry) -> None:
    match entry:
        case noted.Phase():
            _end_hold(flight, boot, t_s)
            if (what := _HELD.get(entry.phase)) is not None:
                why, code = entry.reason or "", entry.code
                moment = Moment(what=what, why=why, code=code, t_s=t_s, boot=boot)
                flight.moments.append(moment)
        case noted.LegBegun():
            if flight.planned and flight.planned[-1].leg is None:
                begun = replace(flight.planned[-1], leg=entry.number, begun_s=t_s)
                flight.planned[-1] = begun
        case PlanReady():
            flight.planned.append(PlannedSubpath(plan=entry))
        case _:
            if (words := _MOMENTS.get(type(entry))) is not None:
                what, why = words[0], words[1].format(entry)
                flight.moments.append(Moment(what=what, why=why, t_s=t_s, boot=boot))


def _end_hold(flight: RecordedFlight, boot: int, t_s: float) -> None:
    """Note until when the last hold has lasted, if it still does."""
    for place in range(len(flight.moments) - 1, -1, -1):
        moment = flight.moments[place]
        if moment.what == "hold":
            if moment.until_s is None and moment.boot == boot:
                flight.moments[place] = replace(moment, until_s=t_s)
            return
