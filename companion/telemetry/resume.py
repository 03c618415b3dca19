"""Loads the data to resume a flight from its run folder.

The companion may have been restarted by a script while the vehicle is in the air, so damaged files
never prevent a resume.  Unreadable files are reported, renamed and ignored; then the vehicle is
never armed, as it may have flown.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, final

import msgspec
import numpy as np

from companion.mission import checkpoint
from companion.mission.mission import Mission
from companion.mission.start import Resume
from companion.mission.state import IN_AIR
from companion.telemetry.run_folder import known_map, resume_head
from companion.world.known_map import KnownMap

_CHECKPOINT, _MAP = "resume.json", "known.npz"
_FLOWN = [phase.value for phase in IN_AIR]
_KINDS = ("phase", "vehicle found", "arm", "plan asked")
_TELLING = tuple(f'"kind":"{kind}"'.encode() for kind in _KINDS)
_NO_ENTRY = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
_LARGEST_ID, _LARGEST_PLAN = 255, 2**31


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ResumeData:
    """Data to resume from."""

    resume: Resume | None = None
    """None: no flight was begun here."""
    said: tuple[str, ...] = ()
    """What could not be restored, as text for the operator."""
    unreadable: tuple[str, ...] = ()
    """Names of files that must not be overwritten."""


def load_resume_data(folder: Path, mission: Mission) -> ResumeData:
    """The data of a previous companion in the run folder, as far as readable."""
    try:
        values = _values(folder, mission)
    except FileNotFoundError:
        history = _history(folder)
        if not history.flown:
            return ResumeData()
        return _forgotten(history, f"{_CHECKPOINT} is not there")
    except (OSError, ValueError) as error:
        return _forgotten(_history(folder), f"{_CHECKPOINT}: {_why(error)}")
    if mission.near is not None:  # near things may have moved: their map is not kept
        return ResumeData(resume=(values, None))
    try:
        known = known_map(folder)
        blank = checkpoint.blank_map(mission, values)
        _must_fit(known, blank)
    except (OSError, ValueError) as error:
        values = checkpoint.without_map(values, f"{_MAP}: {_why(error)}")
        said = tuple(checkpoint.restore_notes(values))
        return ResumeData(resume=(values, None), said=said, unreadable=(_MAP,))
    return ResumeData(resume=(values, known.with_what_was_given(blank)))


def _values(folder: Path, mission: Mission) -> checkpoint.Values:
    """The checkpoint, after checking that it can be resumed."""
    values: checkpoint.Values = resume_head(folder).values
    try:
        checkpoint.restored(mission, checkpoint.blank_map(mission), values)
    except checkpoint.DECODE_ERRORS as error:
        raise ValueError(f"what it holds is no flight ({type(error).__name__}: {error})") from error
    if not _is_id(values.get("system_id")):
        raise ValueError(f"system id {values.get('system_id')!s:.20}")
    return values


def _is_id(value: Any) -> bool:
    return value is None or (type(value) is int and 1 <= value <= _LARGEST_ID)


def _must_fit(known: KnownMap, blank: KnownMap) -> None:
    """ValueError for a map with other cells, or invalid heights."""
    for name in ("cell_m", "north_min_m", "east_min_m"):
        if getattr(known, name) != getattr(blank, name):
            raise ValueError("its cells are not those of the mission")
    shapes = {known.upper_m.shape, known.seen.shape}
    if shapes != {blank.upper_m.shape} or known.seen.dtype != np.bool_:
        raise ValueError("its cells are not those of the mission")
    bounds = known.upper_m
    if bounds.dtype != np.float64 or np.isnan(bounds).any() or not known.registration_m >= 0.0:
        raise ValueError("its heights are none")


def _why(error: OSError | ValueError) -> str:
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)


# --- without it


class _History(NamedTuple):
    """What the journal says of a flight."""

    flown: bool = False
    system_id: int | None = None
    time_s: float = 0.0
    plan_id: int = 0


def _forgotten(history: _History, why: str) -> ResumeData:
    values = checkpoint.without_checkpoint(
        why, system_id=history.system_id, time_s=history.time_s, plan_id=history.plan_id
    )
    said = tuple(checkpoint.restore_notes(values))
    return ResumeData(resume=(values, None), said=said, unreadable=(_CHECKPOINT, _MAP))


def _history(folder: Path) -> _History:
    """As much as can be read: whether it has flown, which vehicle, and until when."""
    history = _History()
    for entry in _entries(folder / "journal.jsonl"):
        kind, system_id, time_s = entry.get("kind"), entry.get("system_id"), entry.get("t_s")
        if kind == "arm" or (kind == "phase" and entry.get("phase") in _FLOWN):
            history = history._replace(flown=True)
        if kind == "vehicle found" and system_id is not None and _is_id(system_id):
            history = history._replace(system_id=system_id)
        if type(plan_id := entry.get("plan_id")) is int and 0 <= plan_id < _LARGEST_PLAN:
            history = history._replace(plan_id=max(history.plan_id, plan_id))
        if isinstance(time_s, float | int) and 0.0 <= time_s < 1e9:
            history = history._replace(time_s=float(time_s))
    return history


def _entries(journal: Path) -> Iterator[dict[str, Any]]:
    """The relevant entries of the valid lines."""
    with suppress(OSError), journal.open("rb") as file:
        for line in file:
            if any(word in line for word in _TELLING):
                with suppress(*_NO_ENTRY):
                    yield msgspec.json.decode(line, type=dict[str, Any])
