"""Loads the data to resume a flight from its run folder.

The companion may have been restarted by a script while the vehicle is in the air, so damaged files
never prevent a resume.  Unreadable files are reported and ignored; then the vehicle is never armed,
as it may have flown.
"""

from contextlib import suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, Struct

from companion.mission import checkpoint
from companion.mission.mission import Mission
from companion.mission.start import Resume, SystemId
from companion.mission.state import IN_AIR
from companion.telemetry.run_folder import known_map, resume_head
from companion.world.known_map import KnownMap

_CHECKPOINT, _MAP = "resume.json", "known.npz"
_FLOWN = [phase.value for phase in IN_AIR]


class ResumeData(NamedTuple):
    """Data to resume from."""

    resume: Resume | None = None
    """None: no flight was begun here."""
    said: tuple[str, ...] = ()
    """What could not be restored, as text for the operator."""


def load_resume_data(folder: Path, mission: Mission) -> ResumeData:
    """The data of a previous companion in the run folder, as far as readable."""
    try:
        values = _values(folder, mission)
    except (OSError, ValueError) as error:
        has_flown, last = _history(folder)
        why = f"{_CHECKPOINT}: {_why(error)}"
        if isinstance(error, FileNotFoundError):
            if not has_flown:
                return ResumeData()
            why = f"{_CHECKPOINT} is not there"
        values = checkpoint.without_checkpoint(
            why, system_id=last.system_id, time_s=last.t_s, plan_id=last.plan_id
        )
        return _without(values)
    if mission.near is not None:  # near things may have moved: their map is not kept
        return ResumeData(resume=(values, None))
    try:
        known, blank = known_map(folder), checkpoint.blank_map(mission)
        _must_fit(known, blank)
    except (OSError, ValueError) as error:
        return _without(checkpoint.without_map(values, f"{_MAP}: {_why(error)}"))
    return ResumeData(resume=(values, known.with_what_was_given(blank)))


def _values(folder: Path, mission: Mission) -> checkpoint.Values:
    """The checkpoint, after checking that it can be resumed."""
    values: checkpoint.Values = resume_head(folder).values
    try:
        checkpoint.restored(mission, checkpoint.blank_map(mission), values)
        msgspec.convert(values.get("system_id"), SystemId | None)
    except checkpoint.DECODE_ERRORS as error:
        raise ValueError(f"what it holds is no flight ({type(error).__name__}: {error})") from error
    return values


def _must_fit(known: KnownMap, blank: KnownMap) -> None:
    """ValueError for a map with other cells, or invalid heights."""
    lattice = ("cell_m", "north_min_m", "east_min_m", "shape")
    is_alike = all(getattr(known, name) == getattr(blank, name) for name in lattice)
    if not is_alike or known.seen.shape != blank.shape or known.seen.dtype != np.bool_:
        raise ValueError("its cells are not those of the mission")
    bounds = known.upper_m
    if bounds.dtype != np.float64 or np.isnan(bounds).any() or not known.registration_m >= 0.0:
        raise ValueError("its heights are none")


def _why(error: OSError | ValueError) -> str:
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)


def _without(values: checkpoint.Values) -> ResumeData:
    """What can be resumed without a map; the values say what is lost."""
    return ResumeData(resume=(values, None), said=tuple(checkpoint.restore_notes(values)))


# --- without a checkpoint


class _Entry(Struct):
    """What an entry of the journal tells of how far the flight had come."""

    kind: str
    phase: str = ""
    t_s: Annotated[float, Meta(ge=0.0, lt=1e9)] = 0.0
    system_id: SystemId | None = None
    plan_id: Annotated[int, Meta(ge=0, lt=2**31)] = 0


def _history(folder: Path) -> tuple[bool, _Entry]:
    """Whether it has flown, and the last of all else, from the lines that can be read."""
    has_flown, last = False, _Entry(kind="")
    with suppress(OSError), (folder / "journal.jsonl").open("rb") as file:
        for line in file:
            with suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                entry = msgspec.json.decode(line, type=_Entry)
                has_flown |= entry.kind == "arm" or entry.phase in _FLOWN
                last.system_id = entry.system_id or last.system_id
                last.t_s, last.plan_id = entry.t_s, max(entry.plan_id, last.plan_id)
    return has_flown, last
