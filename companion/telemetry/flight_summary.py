"""Summary of a flight for progress display and reports: plans, track, times."""

import math
from dataclasses import dataclass, field
from typing import final

from companion.mission.events import End, Vector
from companion.mission.state import Reason
from companion.planner.request import Planned
from companion.session import Session

_NOT_DECIDED = (Reason.NO_VEHICLE, Reason.NOT_READY, Reason.LINK_LOST, Reason.PLANNER_DIED)


@final
@dataclass(slots=True, kw_only=True)
class FlightSummary:
    """Updated during a flight; times are wall seconds unless named otherwise.

    Of a resumed flight only the part since then.
    """

    session: Session
    resumed: bool = False
    """Whether another companion has flown a part of it."""
    plans: list[Planned] = field(default_factory=list)
    plans_s: list[float] = field(default_factory=list)
    """How long each plan took."""
    out_of_time: int = 0
    """Plans that were cut by time, found or not."""
    track_nea_m: list[Vector] = field(default_factory=list)
    """Positions that the vehicle reported, twice a second of its time."""
    scans_nea_m: list[Vector] = field(default_factory=list)
    heard: bool = False
    """Whether the vehicle was ever heard."""
    elapsed_s: float = 0.0
    """Since the vehicle was first heard."""
    passed_m: float = math.inf
    """The nearest that a plane was to its last target, horizontally: it circles it afterwards."""
    end: End | None = None
    loads: bool = False
    """Whether the planner is still being loaded."""
    asks_here: bool = False
    """Whether somebody can say go in the terminal."""
    died: bool = False
    """Whether a part of the companion did."""
    _target: tuple[tuple[float, float], ...] = ()

    @property
    def to_go_m(self) -> float | None:
        """Horizontal distance from the vehicle to its target."""
        state = self.session.state
        position = state.vehicle.position_nea_m
        targets = state.targets_ne_m[state.flight.target :]
        return math.dist(position[:2], targets[0]) if position is not None and targets else None

    def note_passing(self) -> None:
        """Take account of the newest position."""
        state, to_go_m = self.session.state, self.to_go_m
        ahead = state.targets_ne_m[state.flight.target :]
        if ahead[:1] != self._target:
            self._target, self.passed_m = ahead[:1], math.inf
        if to_go_m is not None:
            self.passed_m = min(self.passed_m, to_go_m)

    @property
    def may_go_on(self) -> bool:
        """Whether a failed flight may be resumed.

        That is, the vehicle was in the air, and the mission did not decide to end.
        """
        state = self.session.state
        flew = state.airborne and not self.session.context.shadow
        return flew and (self.died or state.reason in _NOT_DECIDED)

    @property
    def times_real_time(self) -> float:
        """Vehicle time over wall time, while the vehicle was heard."""
        return self.session.clock.passed_s / max(self.elapsed_s, 1e-6)
