"""Entries of the journal about scans, questions to the planner, and subpaths with their proofs."""

from typing import Annotated, Literal, final

from pydantic import Field

from companion.telemetry.journal_lines import Line, NorthEast, NorthEastAltitude, TimedLine


@final
class ScanAsked(TimedLine):
    """The radar is asked what it sees."""

    kind: Literal["scan"]
    centre_nea_m: NorthEastAltitude
    """From where."""
    blocks: int
    """Of 4 x 4 cells, asked for."""


@final
class ScanDone(TimedLine):
    """The radar has answered as far as it will."""

    kind: Literal["scan done"]
    blocks_asked: int
    """Of 4 x 4 cells."""
    blocks_answered: int
    """The others stay unknown."""
    registration_m: float
    """By how much the cells may lie beside where they belong."""
    cells_seen: int
    """Of the known map, so far."""


@final
class RestOfLeg(Line):
    """What is left of the subpath in flight beyond p_prog: the vehicle can stop at its end."""

    length_m: float
    end_nea_m: NorthEastAltitude


@final
class PlanAsked(TimedLine):
    """The next subpath is asked for."""

    kind: Literal["plan asked"]
    plan_id: int
    """Numbers the questions; the answer names it."""
    due_s: float
    """Vehicle time at which the answer counts, never before."""
    attempt: int
    """How often this was asked in vain."""
    rest: RestOfLeg | None = None
    """The other choice: to fly that, to stop, and to leave from there; null: it stands."""
    from_rest: bool
    """Whether it hovers at the start, and may leave in any direction."""
    scan_nea_m: NorthEastAltitude
    """p_scan, where the vehicle is."""
    start_nea_m: NorthEastAltitude
    """p_prog, where the subpath begins."""
    tangent_nea: NorthEastAltitude
    """Direction of the subpath at its start, unit length."""
    curvature_nea_1_m: NorthEastAltitude
    """How it bends there: derivative of the tangent by the length flown, 1/m."""
    target_ne_m: NorthEast
    """Where to."""
    route_ne_m: tuple[NorthEast, ...]
    """The way to the target that the last plan had in mind."""


@final
class CertificateGiven(Line):
    """What is proven of the whole subpath.  Distances are refined only as far as they matter."""

    clearance_m: float | None
    """At least so far from terrain, in three dimensions."""
    keep_out_m: float | None
    """At least so far from zones, horizontally; null: there are none."""
    dead_man_m: float | None
    """At least so far from both is what is flown if the companion dies."""
    turn_radius_m: float | None
    """Nowhere tighter; null: straight."""
    climb_angle_rad: float | None
    """Nowhere steeper upwards."""
    dive_angle_rad: float | None
    """Nowhere steeper downwards."""
    lowest_amsl_m: float | None
    """Nowhere lower."""
    highest_amsl_m: float | None
    """Nowhere higher."""
    off_map_m: float | None
    """At most so far outside of the map."""
    radar_m: float | None
    """At most so much of it lies within the ranges of radars."""
    detection: float | None
    """At most this probability of detection (eq. 3), anywhere."""
    pieces: int
    """Of the proof."""
    broken: tuple[str, ...]
    """Bounds that could not be proven: in profile `flight` it is not flown then."""


@final
class PlanReady(TimedLine):
    """A subpath was found: the answer to `plan asked`, at the time when it counts."""

    kind: Literal["plan ready"]
    plan_id: int
    """Of the question."""
    kernel: str
    """What computed it: `numba` or `numpy`, and a digest of the arithmetic of this processor."""
    evaluations: int
    """Candidates that were looked at."""
    tries: int
    """Searches, each wider than the one before."""
    rank: int
    """Its place among the candidates by cost; more than 0: better ones could not be proven."""
    cost: float | None
    """Eq. 5."""
    to_go: float | None
    """What is left to fly from its end, in the same currency."""
    terms: dict[str, float | None]
    """The cost's terms, by name, 0 to 100; empty: a way out of trouble, not searched for."""
    guide_rad: float
    """Guide direction: from the local frame's north, clockwise."""
    reaches_target: bool
    """Whether it ends at the target."""
    length_m: float
    """Of the curve."""
    control_nea_m: Annotated[tuple[NorthEastAltitude, ...], Field(min_length=4)]
    """Control points of a clamped cubic B-spline with evenly spaced inner knots."""
    certificate: CertificateGiven
    """What is proven of it."""


@final
class PlanRefused(TimedLine):
    """There is no subpath: the answer to `plan asked`."""

    kind: Literal["plan refused"]
    plan_id: int
    """Of the question."""
    reason: str
    """Name of the refusal: NOTHING_SAFE, ..."""
    broken: tuple[str, ...]
    """Bounds that the best candidate breaks."""
    evaluations: int
    """Candidates that were looked at."""
    place_ne_m: tuple[float, float] | None = None
    """North and east of where the way is closed; with NO_WAY only."""


@final
class PlanLate(TimedLine):
    """A plan was due and not there (in real time)."""

    kind: Literal["plan late"]
    plan_id: int
    """Of the question."""
