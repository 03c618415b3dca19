"""The question that a plan answers, and the answers that there are."""

import enum
from dataclasses import dataclass
from typing import final

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate
from companion.path.subpath import Pose, Subpath
from companion.planner.settings import Task
from companion.world.known_map import KnownMap


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretch:
    """A part of a subpath that was flown: its control points, and the lengths between which."""

    control_nea_m: FloatArray  # (points, 3)
    from_m: float
    until_m: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """What is left of the leg in flight beyond p_prog: at its end the vehicle can stop."""

    length_m: float
    end_nea_m: tuple[float, float, float]


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanRequest:
    """The question: everything that the answer depends on."""

    plan_id: int
    seed: int
    task: Task
    known: KnownMap
    scan_nea_m: tuple[float, float, float]
    """p_scan."""
    start: Pose
    """p_prog, the tangent and the curvature there."""
    from_rest: bool
    """Whether the vehicle hovers at the start, so that the path may leave in any direction."""
    target_ne_m: tuple[float, float]
    route_ne_m: tuple[tuple[float, float], ...] = ()
    """The way to the target that the last plan had in mind: not left for a trifle."""
    rest: Rest | None = None
    """Of the leg in flight; None: the vehicle stands, or nothing is known of it."""
    flown: tuple[Stretch, ...] | None = None
    """What was flown: the way back along it is asked for; None: the next subpath."""
    attempt: int = 0
    """How often this question has been asked in vain; each time the search is wider."""

    @property
    def around(self) -> KnownMap:
        """The known map; of a plane, as its circle is near to it."""
        return self.known.grown(self.task.limits.loiter_radius_m)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planned:
    """The next subpath."""

    plan_id: int
    kernel: str
    """What computed it: replay needs to know."""
    subpath: Subpath
    reaches_target: bool
    cost: float
    """Eq. 5."""
    to_go: float
    """What is left to fly from the end, in the same currency."""
    terms: dict[str, float]
    certificate: Certificate
    guide_rad: float
    route_ne_m: tuple[tuple[float, float], ...]
    evaluations: int
    rank: int
    """Position among the candidates by cost: 0 is the best, more if better ones were unproven."""
    tries: int
    stopped_after: int | None = None
    """How often the search was allowed to go on before its time was up; None: it never was.

    Asked again with the same patience, it finds the same."""

    @property
    def is_escape(self) -> bool:
        """Whether it is the straight way out of trouble, which nobody searched for."""
        return not self.terms


class Refusal(enum.Enum):
    """Why there is no subpath, and what helps."""

    NOTHING_SAFE = (
        "no candidate subpath could be proven safe; "
        "lower planner.safety_distance_m or raise planner.evaluations"
    )
    BETTER_TO_STOP = (
        "every subpath that goes on from here costs more than to stop at the end of this one, "
        "look again, and leave in any direction; nothing needs to be done"
    )
    START_IN_KEEP_OUT = (
        "the vehicle is where a zone forbids to be, or too near to it, and no way out could be "
        "proven; fly it out by hand, or remove the zone"
    )
    START_NEAR_TERRAIN = (
        "the vehicle is too near to the terrain, and no way out could be proven; "
        "climb by hand, or lower planner.safety_distance_m"
    )
    START_OUTSIDE = (
        "the vehicle is outside the map or the altitude band; fly it back by hand, or widen [area] "
        "or [altitude]"
    )
    TARGET_IN_TERRAIN = (
        "the terrain at the target leaves no room below the ceiling; "
        "move the target, or raise altitude.ceiling_amsl_m"
    )
    TARGET_IN_KEEP_OUT = (
        "the target is where a zone forbids to be (inside a keep-out, outside a keep-in), or too "
        "near to it; move the target, or remove the zone"
    )
    NO_WAY = (
        "what is known of terrain and zones leaves no way to the target; "
        "move the target, raise altitude.ceiling_amsl_m, or lower planner.safety_distance_m"
    )
    START_NEAR_UNKNOWN = (
        "the ground near the vehicle is unknown, or the map ends there; "
        "fly it to where its radar sees, or widen [area]"
    )
    TARGET_AT_EDGE = (
        "the target is off the map, or nearer to its edge than the required clearance; "
        "move the target, or widen [area]"
    )
    NO_QUESTION = (
        "the request holds a number that is not finite, or a limit that leaves nothing to plan; "
        "check the mission's limits and the vehicle's position"
    )
    NOTHING_SEEN = (
        "nothing around the vehicle has been seen; check that the radar answers, "
        "or climb to where it sees"
    )
    NO_ROOM_TO_TURN = (
        "a turn of vehicle.turn_radius_m does not fit into planner.scan_range_m; "
        "lower the one or raise the other"
    )
    TOO_MANY_LEGS = (
        "the target was not reached with as many legs as are allowed without a vehicle; "
        "look at its path for a trap, or allow more (most_legs)"
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NotPlanned:
    """No subpath: the reason, and which bounds the best candidate broke."""

    plan_id: int
    refusal: Refusal
    broken: tuple[str, ...] = ()
    place_ne_m: tuple[float, float] | None = None
    """Where it is closed, if it is (`NO_WAY`)."""
    evaluations: int = 0
    stopped_after: int | None = None
    """As of Planned."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WayBack:
    """The way back along what was flown, as far as it is proven; none if nothing is."""

    plan_id: int
    subpaths: tuple[Subpath, ...]
    through: tuple[bool, ...]
    """Whether the next one begins at the very end of each, to be flown into at full speed."""
    reaches_start: bool


PlanOutcome = Planned | NotPlanned | WayBack
