"""What came of one run of a campaign: one row of its Parquet data set."""

import typing
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:
    import pyarrow as pa

TIMING = ("took_s", "cpu_s", "plan_ms_median", "plan_ms_p99", "worker")
"""Columns that differ from machine to machine; all others are a function of the run."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One run: its factors, what came of it, how long it took.  None: it does not apply."""

    run: int
    """Its number in the campaign, from 0."""
    key: str
    """Its factors, by which it is known: `gathered/7/flight/refined-de/seed-3`."""
    seed: int
    """Of search and vehicle; runs that differ in one factor alone have it in common."""

    # factors
    world: str
    family: str | None = None
    """Of random worlds: which; with `family_seed` and `family_index` it is drawn again."""
    family_seed: int | None = None
    family_index: int | None = None
    mission: str | None = None
    vehicle: str | None = None
    """`ardupilot-copter`, ...; of the planner alone: None."""
    profile: str
    optimiser: str
    budget: int
    """Evaluations for one subpath."""
    sensor: str | None = None
    faults: str | None = None
    wind: str | None = None
    noise: str | None = None
    planner: str = "ours"
    """`ours`, or a rival for whole routes."""
    knowledge: str = "scans"
    """What the planner is told: `scans`; `elevation`, a poor file too; `full`, all of it."""
    over: str
    """`process` or `planner`."""

    # results
    outcome: str
    """`arrived`, or how it ended instead; `error` if the run raised."""
    reason: str | None = None
    """Why it did not arrive."""
    arrived: bool
    violations: int | None = None
    """Subpaths that break a bound in the dense check against the true world; with faults, all that
    the companion could know of, and endings that nobody explains (`judge`)."""
    violated: str | None = None
    """Which: `leg 3: terrain clearance; ...`."""
    timeline: str | None = None
    """What went wrong."""
    ending: str | None = None
    """With faults: `arrived`, `held and resumed`, `held for good`, `landed`, `returned`, `let go`,
    `refused`, `fell`, or `unexplained: ...`."""
    excused: str | None = None
    """With faults: what was too near, and why it could not know."""
    position_off_m: float | None = None
    """With faults: the largest error of the position that it was told."""
    silent_s: float | None = None
    """With faults: longest time without a command in guided mode, while somebody could send one."""
    length_m: float | None = None
    """Of what was flown."""
    straight_m: float | None = None
    """Of the straight way from target to target."""
    cost: float | None = None
    """J of eq. 5 along what was flown: the three below together."""
    cost_length: float | None = None
    cost_height: float | None = None
    cost_radar: float | None = None
    clearance_least_m: float | None = None
    """True distance to the ground, at most twice what is required."""
    clearance_least_t_s: float | None = None
    """When, in vehicle time."""
    radar_m: float | None = None
    """Flown inside radar ranges."""
    subpaths: int | None = None
    subpaths_checked: int | None = None
    plans: int | None = None
    """Answers of the planner, refusals too."""
    holds: int | None = None
    """Stops on the way."""
    flight_s: float | None = None
    """Vehicle time from take-off."""
    folder: str | None = None
    """Of the run, within the campaign's; empty if it was not kept."""
    error: str | None = None
    """What the run raised, in one line."""
    version: str

    # timing
    took_s: float
    cpu_s: float
    """Processor time, children included."""
    plan_ms_median: float | None = None
    plan_ms_p99: float | None = None
    worker: str
    """Machine and process."""

    def deterministic(self) -> dict[str, Any]:
        """The columns that are the same however it was run."""
        return {name: value for name, value in asdict(self).items() if name not in TIMING}


def schema() -> "pa.Schema":
    """The columns of the data set, from the fields of `Row`."""
    import pyarrow as pa  # an extra

    of_type = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
    columns = []
    for field in fields(Row):
        kind, *none = typing.get_args(field.type) or (field.type,)
        columns.append(pa.field(field.name, of_type[kind], nullable=bool(none)))
    return pa.schema(columns)
