"""What came of a campaign's runs: rows of a Parquet data set as they come, none lost, none twice.

    campaign.toml      the file as it was given
    runs.json          how many runs there are, and what they are: who resumes is held to it;
                       and what to ask for to fly one of them again
    rows/*.parquet     parts, each written under another name first: there are only whole ones
    runs/000123/       folders of runs that are kept

A run is done when its row is in a part.  What was flown but not written when the power went is
flown again, and is the same.  Two writers at once are refused.
"""

import fcntl
import json
import shutil
import typing
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, final

from companion.errors import InputError
from companion.extras import need
from companion.telemetry.run_folder import replace_whole

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
    """Processor time."""
    plan_ms_median: float | None = None
    plan_ms_p99: float | None = None
    worker: str
    """Machine and process."""


def schema() -> "pa.Schema":
    """The columns of the data set, from the fields of `Row`."""
    import pyarrow as pa  # an extra

    of_type = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
    columns = []
    for field in fields(Row):
        kind, *none = typing.get_args(field.type) or (field.type,)
        columns.append(pa.field(field.name, of_type[kind], nullable=bool(none)))
    return pa.schema(columns)


# --- their data set

ROWS = "rows"
_LOCK, _RUNS, _FILE = ".lock", "runs.json", "campaign.toml"


@final
class Store:
    """A campaign's folder, open for writing."""

    def __init__(
        self, folder: Path, *, text: str, digest: str, count: int, source: Sequence[str]
    ) -> None:
        """text: of the campaign's file.  digest: of all runs; count: how many.

        source: what names these runs by these numbers again, as arguments of the command.

        InputError if the folder holds another campaign, is written to by another process, or
        cannot be written to.
        """
        need("campaign", "companion campaign", str(folder))
        self.folder = folder
        with ExitStack() as broken:
            try:
                (folder / ROWS).mkdir(parents=True, exist_ok=True)
                self._lock = broken.enter_context((folder / _LOCK).open("w"))
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not (folder / _RUNS).exists() and not any((folder / ROWS).iterdir()):
                    facts = {"digest": digest, "runs": count, "source": [*source]}
                    replace_whole(folder / _FILE, text.encode())
                    replace_whole(folder / _RUNS, json.dumps(facts).encode())
                elif facts_of(folder).get("digest") != digest:
                    raise self._refused("it holds another campaign, or the same with other options")
                # what a killed process was writing: it has the lock no more
                for path in (*folder.glob(f"{ROWS}/.*.new"), *folder.glob("runs/.new-*")):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
                self.done = {row["run"] for row in read_rows("--out", folder, ["run"])}
                """The runs whose rows are there."""
            except BlockingIOError:
                raise self._refused("another process is at this campaign") from None
            except OSError as error:
                raise self._refused(f"it cannot be written to ({error.strerror})") from error
            broken.pop_all()

    def _refused(self, rule: str) -> InputError:
        return InputError("--out", str(self.folder), rule, "Give another folder.")

    def add(self, rows: Sequence[Row]) -> None:
        """Add rows, in a part of their own; those that are there already are left out."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        fresh = {row.run: row for row in rows if row.run not in self.done}
        if not fresh:
            return
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist([*map(asdict, fresh.values())], schema()), sink)
        path = self.folder / ROWS / f"part-{min(fresh):07d}.parquet"
        replace_whole(path, sink.getvalue().to_pybytes())
        self.done |= fresh.keys()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()


def read_rows(field: str, folder: Path, columns: Sequence[str]) -> list[dict[str, Any]]:
    """These columns of all rows that are there, part by part.  InputError about the field."""
    import pyarrow as pa
    import pyarrow.dataset as ds

    parts = [str(part) for part in sorted((folder / ROWS).glob("*.parquet"))]
    try:
        found = ds.dataset(parts, schema=schema()).to_table(columns=[*columns]) if parts else None
    except (OSError, pa.ArrowException) as error:
        rule = f"its rows cannot be read ({str(error).splitlines()[0].rstrip('.')})"
        remedy = "Remove that part: the command that began the campaign flies its runs again."
        raise InputError(field, str(folder), rule, remedy) from error
    return [] if found is None else list(found.to_pylist())


def facts_of(folder: Path) -> dict[str, Any]:
    """What `runs.json` says; nothing, if it cannot be read."""
    try:
        facts = json.loads((folder / _RUNS).read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return facts if isinstance(facts, dict) else {}
