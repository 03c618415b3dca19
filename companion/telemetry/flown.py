"""A flight as it is seen from outside the session: what was planned, flown and how long it took."""

import math
from dataclasses import dataclass, field
from typing import final

from companion.mission.events import End, Vector
from companion.planner.request import Planned
from companion.session import Session


@final
@dataclass(slots=True, kw_only=True)
class Flown:
    """Grows while a flight is flown; times without a name of their own are wall seconds."""

    session: Session
    plans: list[Planned] = field(default_factory=list)
    plans_s: list[float] = field(default_factory=list)
    """How long each plan took."""
    track_nea_m: list[Vector] = field(default_factory=list)
    """Positions that the vehicle reported, twice a second of its time."""
    scans_nea_m: list[Vector] = field(default_factory=list)
    heard: bool = False
    """Whether there ever was a vehicle."""
    elapsed_s: float = 0.0
    """Since the vehicle was first heard."""
    end: End | None = None

    @property
    def to_go_m(self) -> float | None:
        """Horizontal distance from the vehicle to its target."""
        state = self.session.state
        here = state.vehicle.position_nea_m
        target = self.session.mission.targets_ne_m[state.flight.target]
        return None if here is None else math.dist(here[:2], target)

    @property
    def times_real_time(self) -> float:
        """Vehicle time over wall time."""
        return self.session.now_s / max(self.elapsed_s, 1e-6)
