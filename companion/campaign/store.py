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
import shutil
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, final

import msgspec
from msgspec import Struct

from companion.errors import InputError
from companion.extras import need
from companion.telemetry.run_folder import replacing

if TYPE_CHECKING:
    import polars as pl

Row = dict[str, Any]
"""One run, by the names of COLUMNS: its factors, what came of it, how long it took.

What does not apply is None, or not there."""

COLUMNS: Final[dict[str, type]] = {
    "run": int,  # its number in the campaign, from 0
    "key": str,  # its factors, by which it is known: `gathered/7/flight/refined-de/seed-3`
    "seed": int,  # of search and vehicle; runs that differ in one factor alone have it in common
    # factors
    "world": str,
    "family": str,  # of random worlds: with the next two it is drawn again
    "family_seed": int,
    "family_index": int,
    "mission": str,
    "vehicle": str,  # `ardupilot-copter`, ...; of the planner alone: None
    "profile": str,
    "optimiser": str,
    "budget": int,  # evaluations for one subpath
    "sensor": str,
    "faults": str,
    "wind": str,
    "noise": str,
    "planner": str,  # `ours`, or a rival for whole routes
    "knowledge": str,  # what the planner is told: `scans`, or `full`: all of the ground
    "over": str,  # `process` or `planner`
    # results
    "outcome": str,  # `arrived`, or how it ended instead; `error` if the run raised
    "reason": str,  # why it did not arrive
    "arrived": bool,
    "violations": int,  # subpaths that break a bound in the dense check against the true world;
    # with faults all that the companion could know of, and endings that nobody explains (`judge`)
    "violated": str,  # which: `leg 3: terrain clearance; ...`
    "timeline": str,  # what went wrong
    "ending": str,  # with faults: `arrived`, `held and resumed`, `held for good`, `landed`,
    # `returned`, `on its way back`, `let go`, `refused`, `fell`, or `unexplained: ...`
    "excused": str,  # with faults: what was too near, and why it could not know
    "length_m": float,  # of what was flown
    "straight_m": float,  # of the straight way from target to target
    "cost": float,  # J of eq. 5 along what was flown: the next three together
    "cost_length": float,
    "cost_height": float,
    "cost_radar": float,
    "clearance_least_m": float,  # true distance to the ground, at most twice what is required
    "clearance_least_t_s": float,  # when, in vehicle time
    "subpaths_checked": int,
    "plans": int,  # answers of the planner, refusals too
    "holds": int,  # stops on the way
    "flight_s": float,  # vehicle time from take-off
    "folder": str,  # of the run, within the campaign's; empty if it was not kept
    "error": str,  # what the run raised, in one line
    "version": str,
    # timing
    "took_s": float,
    "cpu_s": float,  # processor time
    "plan_ms_median": float,
    "plan_ms_p99": float,
    "worker": str,  # machine and process
}
TIMING: Final = ("took_s", "cpu_s", "plan_ms_median", "plan_ms_p99", "worker")
"""Columns that differ from machine to machine; all others are a function of the run."""

ROWS: Final = "rows"
_LOCK, _RUNS, _FILE = ".lock", "runs.json", "campaign.toml"
_WRITE_S: Final = 2.0
"""Rows are written when so much time has passed, or so many are there."""
_WRITE_ROWS: Final = 500


class Facts(Struct, frozen=True, kw_only=True):
    """What runs.json says of a campaign; of a folder without it nothing."""

    digest: str = ""
    """Of all runs."""
    runs: int | None = None
    """How many it has in all."""
    source: list[str] = []
    """What names these runs by these numbers again, as arguments of the command."""


@final
class Store:
    """A campaign's folder, open for writing; what has not been written is written at its end."""

    def __init__(self, folder: Path, text: str, facts: Facts) -> None:
        """text: of the campaign's file.

        InputError if the folder holds another campaign, is written to by another process, or
        cannot be written to.
        """
        need("campaign", "companion campaign", str(folder))
        self.folder, self._waiting, self._written_s = folder, list[Row](), time.monotonic()
        with ExitStack() as broken:
            try:
                (folder / ROWS).mkdir(parents=True, exist_ok=True)
                self._lock = broken.enter_context((folder / _LOCK).open("w"))
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not (folder / _RUNS).exists() and not any((folder / ROWS).iterdir()):
                    for name, content in (
                        (_FILE, text.encode()),
                        (_RUNS, msgspec.json.encode(facts)),
                    ):
                        with replacing(folder / name) as file:
                            file.write(content)
                elif facts_of(folder).digest != facts.digest:
                    raise self._refused("it holds another campaign, or the same with other options")
                # what a killed process was writing: it has the lock no more
                for path in (*folder.glob(f"{ROWS}/.*.new"), *folder.glob("runs/.new-*")):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
                self.done = set(read_rows("--out", folder, "run")["run"])
                """The runs whose rows are written."""
            except BlockingIOError:
                raise self._refused("another process is at this campaign") from None
            except OSError as error:
                raise self._refused(f"it cannot be written to ({error.strerror})") from error
            broken.pop_all()

    def _refused(self, rule: str) -> InputError:
        return InputError("--out", str(self.folder), rule, "Give another folder.")

    def add(self, row: Row) -> None:
        """Add a row, to be written with others before long.  OSError if they cannot be."""
        self._waiting.append(row)
        is_late = time.monotonic() - self._written_s >= _WRITE_S
        if is_late or len(self._waiting) >= _WRITE_ROWS:
            self._write()

    def _write(self) -> None:
        """Write what waits, in a part of its own."""
        if self._waiting:
            numbers = {row["run"] for row in self._waiting}
            with replacing(self.folder / ROWS / f"part-{min(numbers):07d}.parquet") as file:
                table(self._waiting).write_parquet(file)
            self.done |= numbers
        self._waiting, self._written_s = [], time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._write()


def table(rows: Sequence[Row]) -> "pl.DataFrame":
    """Rows as the data set has them."""
    import polars as pl  # an extra, and slow to import

    return pl.DataFrame(rows, COLUMNS, orient="row")


def read_rows(field: str, folder: Path, *columns: str) -> "pl.DataFrame":
    """All rows that are there, by their numbers, or some columns of them.

    InputError about the field.
    """
    import polars as pl

    empty = table([])
    # another version may have written some columns more, or not all
    others: Any = {"missing_columns": "insert", "extra_columns": "ignore"}
    frames = [empty.select(columns or [*COLUMNS])]
    for part in sorted((folder / ROWS).glob("*.parquet")):
        try:
            scan = pl.scan_parquet(part, schema=empty.schema, **others)
            frames.append(scan.select(columns or [*COLUMNS]).collect())
        except (OSError, pl.exceptions.PolarsError) as error:
            why = str(error).splitlines()[0].rstrip(".")
            rule = f"its rows cannot be read ({part.name}: {why})"
            remedy = "Remove that part: the command that began the campaign flies its runs again."
            raise InputError(field, str(folder), rule, remedy) from error
    return pl.concat(frames).unique("run", keep="first").sort("run")


def facts_of(folder: Path) -> Facts:
    """What `runs.json` says; nothing, if it cannot be read."""
    try:
        return msgspec.json.decode((folder / _RUNS).read_bytes(), type=Facts)
    except (OSError, ValueError, RecursionError):
        return Facts()
