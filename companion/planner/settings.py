"""What the planner is told about a mission, and the distances that follow from it."""

import math
from dataclasses import dataclass, field
from typing import final

from companion.objective.scene import FLIGHT, Profile, Weights
from companion.optimise import improved_de
from companion.path.limits import Limits
from companion.world.threats import KeepOut, Radar

_CELLS_PER_RANGE = 80  # design 5.3: cells of R / 80


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerSettings:
    """Distances in metres, times in seconds; letters are the paper's."""

    scan_range_m: float
    """R."""
    safety_distance_m: float
    """d_s."""
    planning_time_s: float
    """T."""
    scan_time_s: float = 4.0
    """Longest time that a scan may take; what has not been answered by then stays unknown."""
    scan_distance_m: float | None = None
    """L, the distance of the scan before the end of the subpath; None: as short as eq. 4 allows."""
    position_period_s: float = 0.1
    """Time between two positions of the vehicle."""
    overlap_m: float = 2000.0
    """d_overlap."""
    evaluations: int = 3000
    """Candidates evaluated for one subpath."""
    profile: Profile = FLIGHT
    weights: Weights = field(default_factory=Weights)
    search: improved_de.Settings = field(default_factory=improved_de.Settings)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """All that is known in advance and that planning depends on."""

    limits: Limits
    settings: PlannerSettings
    radars: tuple[Radar, ...] = ()
    keep_outs: tuple[KeepOut, ...] = ()

    @property
    def cell_m(self) -> float:
        """Size of the cells of the known map: R / 80, in the whole metres of the wire."""
        return float(max(round(self.settings.scan_range_m / _CELLS_PER_RANGE), 1))

    @property
    def tail_m(self) -> float:
        """Length of a subpath beyond p_prog.

        The paper's d_s; in profile `flight` enough to stop in, and never less than 0.15 R
        (design section 6: it takes away most of what goes wrong near the end of sight).
        """
        settings = self.settings
        if not settings.profile.verified:
            return settings.safety_distance_m
        stopping = self.limits.speed_m_s**2 / (2.0 * self.limits.acceleration_m_s2)
        return max(0.15 * settings.scan_range_m, stopping + settings.safety_distance_m)

    @property
    def shortest_scan_distance_m(self) -> float:
        """The least L: V (T + t_scan) and the tail (eq. 4, with the time that a scan takes).

        Scan and plan each end with the next position, so a few periods are added.
        """
        settings = self.settings
        time_s = settings.planning_time_s + settings.scan_time_s + 3.0 * settings.position_period_s
        return self.limits.speed_m_s * time_s + self.tail_m

    @property
    def scan_distance_m(self) -> float:
        """L."""
        return self.settings.scan_distance_m or self.shortest_scan_distance_m

    @property
    def required_clearance_m(self) -> float:
        """What the dense check asks of the curve, so that the vehicle on it keeps d_s."""
        return self.settings.safety_distance_m + self.limits.tracking_error_m

    @property
    def search_clearance_m(self) -> float:
        """What the search aims at: more than the check asks for (in `paper`, d_s itself)."""
        settings = self.settings
        if not settings.profile.verified:
            return settings.safety_distance_m
        least = settings.safety_distance_m + 1.1 * self.limits.tracking_error_m
        return max(settings.safety_distance_m * settings.profile.margin, least)

    @property
    def end_radius_m(self) -> float:
        """Radius of the circle about p_scan on which subpaths end.

        The paper's R; in profile `flight` so much less that the ground within the required
        clearance of the end has been scanned.
        """
        settings = self.settings
        if not settings.profile.verified:
            return settings.scan_range_m
        return settings.scan_range_m - self.search_clearance_m - 2.0 * math.sqrt(2.0) * self.cell_m
