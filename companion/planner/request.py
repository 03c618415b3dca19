"""The plan request and its possible answers, also as plain values."""

import enum
from dataclasses import dataclass, field
from typing import Any, Final, final

import msgspec
import numpy as np

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate
from companion.path.subpath import Pose, Subpath
from companion.planner.progress import NO_PROGRESS, Progress
from companion.planner.settings import Place, Task
from companion.world.known_map import KnownMap

REACH = 1.1  # of R about p_scan: what lies farther out counts as unknown
_STREAM_PLAN = 1  # the planner's random stream among those of one seed
_MORE, _PATIENT_S = 3.0, 3.0  # T for each failed attempt, and at most, where it hovers anyway


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlownSegment:
    """A flown part of a subpath: its control points, and start and end length."""

    control_nea_m: FloatArray  # (points, 3)
    from_m: float
    until_m: float
    speed_m_s: float | None = None  # at which it was flown at most; None: V


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """The rest of the current leg beyond p_prog: at its end the vehicle can stop."""

    length_m: float
    end_nea_m: tuple[float, float, float]
    speed_m_s: float | None = None
    """At p_prog, at most: the next leg is proven for no less.  None: V."""


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanRequest:
    """A plan request: everything that the answer depends on."""

    plan_id: int
    seed: int
    task: Task
    known: KnownMap
    scan_nea_m: tuple[float, float, float]  # p_scan
    start: Pose  # p_prog, the tangent and the curvature there
    from_rest: bool
    """Whether the vehicle hovers at the start, so that the path may leave in any direction."""
    target_ne_m: Place
    progress: Progress = NO_PROGRESS  # as of the last plan on the way to the target
    rest: Rest | None = None  # of the current leg; None: the vehicle is at rest, or there is no leg
    flown: tuple[FlownSegment, ...] | None = None
    """The flown segments, to request a backtrack; None: the next subpath is requested."""
    attempt: int = 0
    """Number of failed attempts before; each time there is more time, and more is evaluated."""

    @property
    def around(self) -> KnownMap:
        """The known map, for a plane dilated by its loiter circle."""
        return self.known.grown(self.task.limits.loiter_radius_m)

    def rng(self, search: int) -> np.random.Generator:
        """The chance of one of the searches of this plan."""
        return np.random.default_rng([self.seed, _STREAM_PLAN, self.plan_id, self.attempt, search])

    @property
    def time_s(self) -> float:
        """How long the answer may take: T; at rest more with each attempt."""
        time_s = self.task.settings.planning_time_s
        if not self.from_rest:
            return time_s
        return max(time_s, min((1.0 + _MORE * self.attempt) * time_s, _PATIENT_S))

    def refused(
        self, refusal: "Refusal", broken: tuple[str, ...] = (), place_ne_m: Place | None = None
    ) -> "NotPlanned":
        """The answer that there is no subpath."""
        return NotPlanned(
            plan_id=self.plan_id, refusal=refusal, broken=broken, place_ne_m=place_ne_m
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planned:
    """The next subpath."""

    plan_id: int
    kernel: str  # the kernel that computed it, for replay
    subpath: Subpath
    reaches_target: bool
    cost: float = 0.0  # eq. 5
    to_go: float = 0.0  # cost-to-go from the end, in the same unit
    terms: dict[str, float] = field(default_factory=dict)  # none of what no search has made
    certificate: Certificate
    guide_rad: float = 0.0
    route_ne_m: tuple[Place, ...] = ()
    """The way to the target, by guidance; an escape has asked for none."""
    progress: Progress = NO_PROGRESS
    evaluations: int = 0  # of all searches of the plan, as `tries`
    rank: int = 0
    """Rank by cost in its search: 0 is the cheapest, more if cheaper ones could not be proven."""
    tries: int = 0  # how many searches there were, whichever found it
    speed_m_s: float | None = None  # the highest speed that it is proven for; None: V
    stopped_after: int | None = None
    """How often the search was continued before its time was up; None: it never was.

    Repeated with the same number, it gives the same result."""

    @property
    def is_escape(self) -> bool:
        """Whether it is a straight escape path or way out, not the result of a search."""
        return not self.terms


def _text(text: str) -> str:
    """A text of several lines in one."""
    return " ".join(text.split())


class Refusal(enum.Enum):
    """Why there is no subpath, and the remedy."""

    NOTHING_SAFE = _text("""no candidate subpath could be proven safe; relax what it broke, lower
        planner.safety_distance_m or raise planner.evaluations""")
    OUT_OF_TIME = _text("""time was up before all searches for it were done; raise
        planner.planning_time_s, or use a faster computer""")
    BETTER_TO_STOP = _text("""every subpath that goes on from here costs more than to stop at the
        end of this one, look again, and leave in any direction; nothing needs to be done""")
    BETTER_TO_TURN = _text("""every subpath that goes on from here costs more than to stop, and the
        rest of this one leads away from the target, so it stops at once; nothing needs to be
        done""")
    START_IN_KEEP_OUT = _text("""the vehicle is where a zone forbids to be, or too near to it, and
        no way out could be proven; fly it out by hand, or remove the zone""")
    START_NEAR_TERRAIN = _text("""the vehicle is too near to the terrain, and no way out could be
        proven; climb by hand, or lower planner.safety_distance_m""")
    START_NEAR_THINGS = _text("""what the sensor has not shown to be free comes too near to the
        vehicle (something stands there, or it does not see all round), and no way out could be
        proven; fly it by hand to an open place, check what preflight says of the sensor, or lower
        planner.safety_distance_m""")
    START_OUTSIDE = _text("""the vehicle is outside the map or the altitude band; fly it back by
        hand, or widen [area] or [altitude]""")
    TARGET_IN_TERRAIN = _text("""the terrain at the target leaves no room below the ceiling; move
        the target, or raise altitude.ceiling_amsl_m""")
    TARGET_IN_KEEP_OUT = _text("""the target is where a zone forbids to be (inside a keep-out,
        outside a keep-in), or too near to it; move the target, or remove the zone""")
    NO_WAY = _text("""what is known of terrain and zones leaves no way to the target; move the
        target, raise altitude.ceiling_amsl_m, or lower planner.safety_distance_m""")
    NO_WAY_PROVEN = _text("""no way on was found: since the vehicle was last nearer to the target,
        going on has cost more than a way all round what it sees; the way that the map shows may be
        narrower than can be proven: lower planner.safety_distance_m, raise
        altitude.ceiling_amsl_m, or lead it past by targets""")
    START_NEAR_UNKNOWN = _text("""the ground near the vehicle is unknown, or the map ends there; fly
        it to where its radar sees, or widen [area]""")
    TARGET_AT_EDGE = _text("""the target is off the map, or nearer to its edge than the required
        clearance; move the target, or widen [area]""")
    NO_QUESTION = _text("""the request holds a number that is not finite, or a band that leaves
        nothing to plan; check [altitude] and the vehicle's position""")
    NOTHING_SEEN = _text("""nothing around the vehicle has been seen; check that the radar answers,
        or climb to where it sees""")
    TOO_MANY_LEGS = _text("""the target was not reached with as many legs as are allowed without a
        vehicle; look at its path for a trap, or allow more (most_legs)""")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NotPlanned:
    """No subpath: the reason, and which bounds the best candidate broke."""

    plan_id: int
    refusal: Refusal
    broken: tuple[str, ...] = ()
    place_ne_m: Place | None = None  # where all routes are blocked (`NO_WAY`)
    evaluations: int = 0
    tries: int = 0  # how many searches there were
    stopped_after: int | None = None  # as of Planned

    @property
    def why(self) -> str:
        """The reason, and the remedy."""
        return f"{self.refusal.name}: {self.refusal.value}"


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Backtrack:
    """The backtrack along the flown path, as far as it is proven; may be empty."""

    plan_id: int
    subpaths: tuple[Subpath, ...]
    through: tuple[bool, ...]
    """For each, whether the next one continues it, to be entered at full speed."""
    reaches_start: bool
    speeds_m_s: tuple[float | None, ...] = ()
    """The highest speed that each is proven for; None, or none at all: V."""


PlanOutcome = Planned | NotPlanned | Backtrack


# --- answers in files, exact: a decoded subpath has the same control points

Values = dict[str, Any]
_KINDS: Final = {"planned": Planned, "not planned": NotPlanned, "way back": Backtrack}
_NAMES: Final[dict[type, str]] = {kind: name for name, kind in _KINDS.items()}


def values_of(outcome: PlanOutcome) -> Values:
    """An answer as numbers, texts, lists and dictionaries."""
    values: Values = {"kind": _NAMES[type(outcome)]}
    values |= msgspec.to_builtins(outcome, enc_hook=np.ndarray.tolist)
    match outcome:
        case Planned():
            values["control_nea_m"] = values.pop("subpath")["control_nea_m"]
        case NotPlanned():
            values["refusal"] = outcome.refusal.name
        case Backtrack():
            values["control_nea_m"] = [
                subpath["control_nea_m"] for subpath in values.pop("subpaths")
            ]
    return values


def outcome_of(values: Values) -> PlanOutcome:
    """Decode an answer.  KeyError, TypeError, ValueError: invalid values."""
    kind, values = _KINDS[values["kind"]], dict(values)
    if kind is Planned:
        values["subpath"] = {"control_nea_m": values.pop("control_nea_m")}
    elif kind is NotPlanned:
        values["refusal"] = Refusal[values["refusal"]].value
    else:
        values["subpaths"] = [{"control_nea_m": rows} for rows in values.pop("control_nea_m")]
    return msgspec.convert(
        values, kind, strict=False, dec_hook=lambda _, rows: control_points(rows)
    )


def control_points(rows: list[list[float]]) -> FloatArray:
    """The control points of a subpath.  ValueError: invalid values."""
    control = np.array(rows, dtype=np.float64)
    if control.ndim != 2 or control.shape[1] != 3 or len(control) < 4:
        raise ValueError("control points are rows of north, east, altitude")
    if not np.isfinite(control).all():
        raise ValueError("control points are finite")
    return control
