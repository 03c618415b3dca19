"""What a mission chooses of the objective: its weights, and how literally the paper is taken."""

from dataclasses import dataclass
from typing import final

from companion.ranges import NotNegative


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """a_1 .. a_6 of eq. 5, of terms from 0 to about 100; the paper's Fig. 3 (a)."""

    length: NotNegative = 0.1
    """f1: length of the curve, 100 for 2.4 R, and of what a copter would fly in the time that it
    loses in bends; what is left to fly after its end counts as much."""
    height: NotNegative = 0.15
    """f2: mean altitude over the floor, 100 at the ceiling."""
    guide: NotNegative = 0.15
    """f3: angle between the end and the guide, seen from p_scan, 100 for half a turn."""
    crash: NotNegative = 0.3
    """f4: how far it lies too low, 100 for each d_s, and ten samples."""
    radar: NotNegative = 0.3
    """f5: probability of detection (eq. 3), 30 for each radar, and ten samples."""
    constraints: NotNegative = 1.0
    """f6: curvature, steepness, zones and bounds of the map that it breaks."""

    def per_metre(self, scan_range_m: float) -> tuple[float, float, float]:
        """What a metre of a route adds to J (planner-numbers A).

        By its length; by its height, at the ceiling; and to radars, where one surely sees it.
        """
        unit = 100.0 / scan_range_m
        return self.length * unit / 2.4, self.height * unit, 3.0 * self.radar * unit


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
"""With fewer samples up to a third of the subpaths break between them what they keep at them, and
the margin for the rest costs 0.1 % of the way (planner-numbers, D and E)."""
PROFILES = {profile.name: profile for profile in (FLIGHT, PAPER)}
