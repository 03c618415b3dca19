"""What a mission chooses of the objective: its weights, and how literally the paper is taken."""

from dataclasses import dataclass
from typing import final

from companion.ranges import NotNegative


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """a_1 .. a_6 of eq. 5; the paper's Fig. 3 (a)."""

    length: NotNegative = 0.1
    height: NotNegative = 0.15
    guide: NotNegative = 0.15
    crash: NotNegative = 0.3
    radar: NotNegative = 0.3
    constraints: NotNegative = 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """How literally the paper is taken."""

    name: str
    samples: int
    """Points of the curve at which the terms are computed (the paper: 10)."""
    margin: float
    """Factor on d_s, on the turn radius and on the steepness that the search aims at."""
    verified: bool
    """Whether a subpath needs a certificate before it is flown."""
    optimiser: str
    """What searches, if the mission does not say."""


PAPER = Profile(name="paper", samples=10, margin=1.0, verified=False, optimiser="improved-de")
FLIGHT = Profile(name="flight", samples=40, margin=1.06, verified=True, optimiser="refined-de")
PROFILES = {profile.name: profile for profile in (FLIGHT, PAPER)}
