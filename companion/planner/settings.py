"""Planner settings and task, and the distances derived from them."""

import hashlib
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, final

import numpy as np
from annotated_types import Ge, Le

from companion.optimise.registry import Maker
from companion.path import envelope as moves
from companion.path.envelope import COPTER, PLANE, Envelope, Handling
from companion.path.limits import Limits
from companion.path.proof import Surroundings
from companion.profiles import FLIGHT, Profile, Weights
from companion.ranges import NotNegative, Positive
from companion.world.columns import pack_columns
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
from companion.world.zones import Zone, packed

Place = tuple[float, float]  # north and east in the local frame, metres
CELLS_PER_RANGE = 80  # design 5.3: cells of R / 80
_AIMS = 1.1  # errors that the search keeps beyond d_s: a proof needs a little to spare


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerSettings:
    """Distances in metres, times in seconds; letters are the paper's."""

    scan_range_m: Positive
    """R."""
    safety_distance_m: Positive
    """d_s."""
    planning_time_s: Positive
    """T."""
    scan_time_s: Positive = 4.0
    """Time-out of a scan; cells without an answer stay unknown."""
    scan_distance_m: Positive | None = None
    """L, the distance of the scan before the end of the subpath; None: as short as eq. 4 allows."""
    position_period_s: float = 0.1
    """Time between two positions of the vehicle."""
    overlap_m: NotNegative = 2000.0
    """d_overlap."""
    evaluations: Annotated[int, Ge(60), Le(200_000)] = 1500
    """Candidates evaluated for one subpath."""
    profile: Profile = FLIGHT
    weights: Weights = field(default_factory=Weights)
    optimiser: str | Maker | None = None
    """What searches, or its name in `optimise.registry`; None: the profile's."""
    cell_m: Positive | None = None
    """Size of the cells of the known map; None: R / 80, in the whole metres of TERRAIN_REQUEST."""

    @property
    def is_near(self) -> bool:
        """Whether it flies among near things, whose map has cells of its own."""
        return self.cell_m is not None


@final
@dataclass(frozen=True, kw_only=True)  # no slots: what is asked for with every position is kept
class Task:
    """Everything known in advance that planning depends on."""

    limits: Limits
    settings: PlannerSettings
    handling: Handling | None = None
    """How its autopilot flies setpoints."""
    convergence_rad: float = 0.0
    """By how much true north turns on the map, at most."""
    radars: tuple[Radar, ...] = ()
    zones: tuple[Zone, ...] = ()
    stated_ground_amsl_m: float | None = None
    """Upper bound of the ground for flights without a scanner; None: not stated."""

    @cached_property
    def digest(self) -> str:
        """Digest that identifies the task in files."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    @cached_property
    def envelope(self) -> Envelope:
        """How the vehicle moves on legs that are planned by this task."""
        handling = self.handling or (COPTER if self.limits.hovers else PLANE)
        return moves.envelope_of(self.limits, handling, self.convergence_rad)

    @property
    def cell_m(self) -> float:
        """Size of the cells of the known map."""
        settings = self.settings
        return settings.cell_m or float(max(round(settings.scan_range_m / CELLS_PER_RANGE), 1))

    def radars_near(self, place_ne_m: Place, reach_m: float) -> tuple[Radar, ...]:
        """The radars whose range comes within reach of a place."""
        return tuple(
            radar
            for radar in self.radars
            if math.dist(radar.centre_nea_m[:2], place_ne_m) <= radar.range_m + reach_m
        )

    # --- what is kept: what certificates ask for, and what the search aims at, a little more
    #
    #              proven                  aimed at (in `paper`, d_s itself)
    #   terrain    required_clearance_m    search_clearance_m
    #   zones      zone_clearance_m        zone_search_clearance_m
    #
    # A plane's circle keeps these distances, too: the terrain is grown by it, the zones are not.

    @property
    def error_m(self) -> float:
        """Allowed distance of the vehicle from the path: tracking and navigation error."""
        return self.envelope.error_m

    @property
    def required_clearance_m(self) -> float:
        """d_s and the vehicle's errors."""
        return self.settings.safety_distance_m + self.error_m

    @property
    def search_clearance_m(self) -> float:
        """A little more."""
        d_s, profile = self.settings.safety_distance_m, self.settings.profile
        return max(d_s * profile.margin, d_s + _AIMS * self.error_m) if profile.verified else d_s

    @property
    def zone_clearance_m(self) -> float:
        """`required_clearance_m`, and the circle of a plane."""
        return self.required_clearance_m + self.envelope.loiter_m

    @property
    def zone_search_clearance_m(self) -> float:
        """`search_clearance_m`, and the circle of a plane."""
        return self.search_clearance_m + self.envelope.loiter_m

    @property
    def band_amsl_m(self) -> tuple[float, float]:
        """Floor and ceiling to plan for, so that the vehicle on the path stays in the band."""
        aims_m = _AIMS * self.error_m if self.settings.profile.verified else 0.0
        return self.limits.inner_band_amsl_m(aims_m)

    @cached_property
    def take_off_amsl_m(self) -> float:
        """Where the climb-out ends and the first path begins: no lower than paths are planned."""
        return max(self.limits.floor_amsl_m + 2.0 * self.envelope.tube_m, self.band_amsl_m[0])

    def surroundings(
        self,
        known: KnownMap,
        centre_ne_m: Place,
        reach_m: float,
        *,
        clearance_m: float | None = None,
    ) -> Surroundings:
        """What certificates of its paths are about; made once per plan.

        The curves keep a clearance (None: the required one) from terrain and zones, and so much of
        the altitude band that the vehicle stays in it.  They stay within reach of a place (their
        straight dead-man stretches may leave it): what lies farther out counts as terrain without a
        top.  The vehicle stops at the end of a curve.
        """
        limits, motion = self.limits, self.envelope
        clearance_m = self.required_clearance_m if clearance_m is None else clearance_m
        farther_m = moves.flown_on_m(motion, motion.speed_m_s) + 3.0 * clearance_m
        registration_m = known.registration_m + motion.loiter_m
        (south_m, north_m), (west_m, east_m) = limits.north_m, limits.east_m
        low_m, high_m = limits.inner_band_amsl_m(motion.error_m)
        circles = [(*radar.centre_nea_m, radar.range_m) for radar in self.radars]
        return Surroundings(
            columns=pack_columns(
                known,
                centre_ne_m=centre_ne_m,
                reach_m=reach_m + farther_m + registration_m,
                block=max(2, min(16, round(0.75 * clearance_m / known.cell_m))),
                registration_m=registration_m,
            ),
            zones=packed(self.zones),
            radars=np.array(circles, dtype=np.float64).reshape(-1, 4),
            clearance_m=float(clearance_m),
            contact_m=float(motion.contact_m),
            motion=motion,
            stops=True,
            lowest_nea_m=(float(south_m), float(west_m), float(low_m)),
            highest_nea_m=(float(north_m), float(east_m), float(high_m)),
        )

    @cached_property
    def tail_m(self) -> float:
        """Length of a subpath beyond p_prog.

        The paper's d_s; in `flight` the dead-man reach, enough to stop in (for a plane: the lead
        and d_s), and 0.15 R (design 6: most of what goes wrong at the end of sight does not then).
        """
        settings, motion, speed = self.settings, self.envelope, self.limits.speed_m_s
        if not settings.profile.verified:
            return settings.safety_distance_m
        stop_m = moves.stopping_m(motion, speed) + motion.lead_m + settings.safety_distance_m
        return max(0.15 * settings.scan_range_m, stop_m, moves.flown_on_m(motion, speed))

    @property
    def stop_m(self) -> float:
        """The time for a stop, a scan and a plan from rest, as distance at cruise speed."""
        motion, settings = self.envelope, self.settings
        time_s = 0.5 * motion.speed_m_s * (1.0 / motion.braking_m_s2 + 1.0 / motion.gaining_m_s2)
        time_s += motion.settling_s + settings.scan_time_s + settings.planning_time_s
        return motion.speed_m_s * time_s

    @cached_property
    def shortest_scan_distance_m(self) -> float:
        """The least L: V (T + t_scan) and the tail (eq. 4, with the time that a scan takes).

        Scan and plan each end with the next position, so a few periods are added.  A plane is sent
        to points that lie ahead of it: they must not be beyond p_prog when the plan is there.
        """
        settings = self.settings
        time_s = settings.planning_time_s + settings.scan_time_s + 3.0 * settings.position_period_s
        return self.limits.speed_m_s * time_s + self.envelope.lead_m + self.tail_m

    @cached_property
    def scan_distance_m(self) -> float:
        """L."""
        return self.settings.scan_distance_m or self.shortest_scan_distance_m

    @property
    def end_radius_m(self) -> float:
        """Radius of the circle about p_scan on which subpaths end.

        The paper's R; in `flight` less, so that the ground is scanned within the required clearance
        of the end and of the dead-man reach from there.
        """
        settings, motion = self.settings, self.envelope
        if not settings.profile.verified:
            return settings.scan_range_m
        beyond = moves.beyond_m(motion) if self.limits.hovers else 0.0
        reserve = max(self.zone_search_clearance_m, beyond + motion.contact_m)
        return settings.scan_range_m - (reserve + 2.0 * math.sqrt(2.0) * self.cell_m)

    # --- the same task, a little otherwise

    @cached_property
    def _at_speeds(self) -> "dict[float, Task]":
        """Kept by `at_speed`: they are asked for with every position."""
        return {}

    def at_speed(self, speed_m_s: float | None) -> "Task":
        """The task of a leg that is flown more slowly than V; None: at V.

        A copter turns with the lateral acceleration V^2 / turn_radius_m, so its turns are the
        tighter the slower it is, and so are its tail, L and dead-man reach the shorter.
        """
        limits, known = self.limits, self._at_speeds
        if speed_m_s is None or speed_m_s >= limits.speed_m_s or not limits.hovers:
            return self
        if speed_m_s not in known:
            radius_m = limits.turn_radius_m * (speed_m_s / limits.speed_m_s) ** 2
            slow = replace(limits, speed_m_s=speed_m_s, turn_radius_m=radius_m)
            known[speed_m_s] = replace(self, limits=slow)
        return known[speed_m_s]

    def unruled(self) -> "Task":
        """The task without zones and band: of a leg of which nobody knows what it was held to."""
        limits = replace(self.limits, floor_amsl_m=-math.inf, ceiling_amsl_m=math.inf)
        return replace(self, limits=limits, zones=())

    def no_lower_than(self, amsl_m: float) -> "Task":
        """The task with this, if it is higher, as the lowest altitude to plan for."""
        raised_m = self.limits.floor_amsl_m + max(amsl_m - self.band_amsl_m[0], 0.0)
        return replace(self, limits=replace(self.limits, floor_amsl_m=raised_m))
