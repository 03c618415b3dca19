"""What a run folder tells of a flight, put together for all formats: places, times and reasons.

The journal says what was decided and when by the vehicle's clock, the log where the vehicle was
then: each entry gets its place by its time.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.mission import journal as noted
from companion.mission.journal import Entry, Header, PlanReady
from companion.mission.mission import Mission
from companion.mission.state import Phase as MissionPhase
from companion.path.subpath import Subpath
from companion.telemetry.export.track import IntArray, Track
from companion.world.threats import Zone

_BEFORE = "waiting"
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

    @property
    def subpath(self) -> Subpath:
        """The curve."""
        return Subpath(control_nea_m=np.array(self.plan.control_nea_m, dtype=np.float64))


@final
@dataclass(slots=True, kw_only=True)
class RecordedFlight:
    """A flight, as far as it was recorded."""

    mission: Mission
    track: Track
    targets_ne_m: tuple[tuple[float, float], ...]
    """The newest: the mission's, the vehicle's own, or where it was sent."""
    zones: tuple[Zone, ...]
    """The mission's and the vehicle's own."""
    system_id: int | None = None
    planned: list[PlannedSubpath] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    phases: list[tuple[int, float, str]] = field(default_factory=list)
    """Boot, vehicle time and name of each phase."""
    legs: list[tuple[int, float, int]] = field(default_factory=list)
    """Boot, vehicle time and number of each leg."""
    entries: list[tuple[int, float, Entry]] = field(default_factory=list)
    """Boot, vehicle time and content of each line of the journal."""

    def phase_of_positions(self) -> list[str]:
        """The phase at each position of the track."""
        names = [_BEFORE, *(phase for _, _, phase in self.phases)]
        return [names[at] for at in self._latest([each[:2] for each in self.phases])]

    def leg_of_positions(self) -> list[int]:
        """The leg at each position of the track; 0: none yet."""
        numbers = [0, *(number for _, _, number in self.legs)]
        return [numbers[at] for at in self._latest([each[:2] for each in self.legs])]

    def segments(self) -> list[tuple[str, slice]]:
        """Phases, and the positions in each."""
        names = self.phase_of_positions()
        starts = [at for at, name in enumerate(names) if at == 0 or names[at - 1] != name]
        return [(names[a], slice(a, b)) for a, b in pairwise([*starts, len(names)])]

    def index_at(self, boot: int, t_s: float) -> int | None:
        """The position of the track that is nearest in vehicle time; None without any."""
        if not len(self.track):
            return None
        of_boot = np.flatnonzero(self.track.boot == boot)
        if not len(of_boot):
            return 0 if boot < self.track.boot[0] else len(self.track) - 1
        return int(of_boot[np.argmin(np.abs(self.track.t_s[of_boot] - t_s))])

    def _latest(self, keys: list[tuple[int, float]]) -> IntArray:
        """How many of some moments, boot and vehicle time, each position has behind it."""
        return np.searchsorted(
            _keys(keys), _keys(zip(self.track.boot, self.track.t_s, strict=True)), "right"
        )


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
        self._targets = mission.targets_ne_m
        self._own_zones: tuple[Zone, ...] = ()
        self._keep_outs: tuple[Zone, ...] = ()
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
        match line:
            case noted.VehicleFound():
                self.system_id = line.system_id
            case noted.Targets():
                self._targets = line.targets_ne_m
            case noted.OrderGiven() if (zone := line.keep_out) is not None:
                self._keep_outs = (*self._keep_outs, zone)
            case noted.OrderGiven(target_ne_m=(north_m, east_m)):
                self._targets = ((north_m, east_m),)
            case noted.Fence():
                self._own_zones = line.zones
            case _:
                pass
        self.timed.append((self._boot, line.t_s, line))

    def flight(self, track: Track) -> RecordedFlight:
        """All of it, with the track of the same flight."""
        flight = RecordedFlight(
            mission=self._mission,
            track=track,
            targets_ne_m=self._targets,
            zones=(*self._mission.task.zones, *self._own_zones, *self._keep_outs),
            system_id=self.system_id,
            entries=with_rising_times(self.timed),
        )
        for boot, t_s, entry in flight.entries:
            _add(flight, boot, t_s, entry)
        return flight


_HELD = {MissionPhase.HOLDING.value: "hold", MissionPhase.FAULTED.value: "fault"}


def with_rising_times(timed: list[tuple[int, float, Entry]]) -> list[tuple[int, float, Entry]]:
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
            flight.phases.append((boot, t_s, entry.phase))
            if (what := _HELD.get(entry.phase)) is not None:
                why, code = entry.reason or "", entry.code
                moment = Moment(what=what, why=why, code=code, t_s=t_s, boot=boot)
                flight.moments.append(moment)
        case noted.LegBegun():
            flight.legs.append((boot, t_s, entry.number))
            if flight.planned and flight.planned[-1].leg is None:
                begun = replace(flight.planned[-1], leg=entry.number, begun_s=t_s)
                flight.planned[-1] = begun
        case PlanReady():
            flight.planned.append(PlannedSubpath(plan=entry))
        case _:
            if (words := _words(entry)) is not None:
                what, why = words
                flight.moments.append(Moment(what=what, why=why, t_s=t_s, boot=boot))


def _end_hold(flight: RecordedFlight, boot: int, t_s: float) -> None:
    """Note until when the last hold has lasted, if it still does."""
    for place in range(len(flight.moments) - 1, -1, -1):
        moment = flight.moments[place]
        if moment.what == "hold":
            if moment.until_s is None and moment.boot == boot:
                flight.moments[place] = replace(moment, until_s=t_s)
            return


def _words(entry: Entry) -> tuple[str, str] | None:
    """What has happened, and why or how; None: nothing that is worth a point on the map."""
    match entry:
        case noted.LinkLost(silent_s=silent_s):
            return "link lost", f"nothing was heard for {silent_s:g} s"
        case noted.VehicleRebooted():
            return "reboot", "the autopilot has rebooted"
        case noted.PartDied(error=error):
            return "part died", error
        case noted.StopAsked():
            return "stop asked", "a person asked for the end"
        case noted.Resumed():
            return "resumed", "the companion was started again"
        case noted.End(outcome=outcome, reason=reason):
            return "end", f"{outcome}: {reason}"
        case _:
            return None
