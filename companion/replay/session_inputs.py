"""Feeds recorded inputs to an equal session."""

import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, final

import msgspec
from msgspec import Meta, Struct

from companion.mavlink.link import Input, Output
from companion.mission import checkpoint
from companion.mission.mission import Mission
from companion.mission.start import Resume, Start, SystemId
from companion.planner.request import PlanOutcome, outcome_of
from companion.profiles import PROFILES
from companion.session import Session
from companion.world.known_map import unpacked_map

RUNTIME_RECORDS = frozenset({"unsent", "raised", "held"})
"""Records about a session and its output, which are not fed to the session."""
_Seconds = Annotated[float, Meta(ge=-1e300, le=1e300)]
_ARGUMENTS: Final[dict[str, Any]] = {
    "receive": tuple[bytes, _Seconds | None],
    "run": tuple[()],
    "silence": tuple[_Seconds],
    "deliver": tuple[Any],
    "stop": tuple[()],
    "say_go": tuple[()],
    "complain": tuple[str],
    "part_died": tuple[str, str],
    "recording_stopped": tuple[str],
    "farewell": tuple[()],
}
"""The calls of a session that are inputs."""
SESSION_CALLS = frozenset(_ARGUMENTS)
MissionOf = Callable[[Start], Mission]
"""The mission that a session flew: by its profile, from wherever it is kept."""


class DamagedInputError(Exception):
    """A record is not a valid input of a session."""


@final
class RecordedError(Struct, frozen=True, kw_only=True):
    """An error raised by a session, or by the control loop around it."""

    call: str
    """Of the session: a name among `SESSION_CALLS`, or another; "" if it did not come out of it."""
    error: str
    place: str = ""
    """In the code, if it was raised here."""

    @staticmethod
    def of(call: str, error: Exception) -> "RecordedError":
        """An error that a session has raised just now."""
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).stem}.{last.name}, line {last.lineno}"
        return RecordedError(call=call, error=f"{type(error).__name__}: {error}", place=place)

    def __str__(self) -> str:
        return self.error if not self.place else f"{self.error} ({self.place})"


def start_of(recorded_input: Input) -> Start:
    """What a session was made of, of a recorded input.  DamagedInputError: it is none."""
    try:
        values = recorded_input[1]
        if isinstance(values, dict) and values.get("has_ground") is False:  # of older recordings
            values = {key: value for key, value in values.items() if key != "has_ground"}
        start = msgspec.convert(values, Start)
        msgspec.convert((start.resume or {}).get("system_id"), SystemId | None)
    except (IndexError, msgspec.ValidationError) as error:
        raise DamagedInputError(f"a start that is none ({error})") from error
    if start.profile not in PROFILES:
        raise DamagedInputError(f"a start that is none (profile {start.profile!r:.40})")
    return start


def session_of(start: Start, mission_of: MissionOf) -> Session:
    """Create a session.  DamagedInputError: its checkpoint cannot be read.

    Errors of the session itself are passed on.
    """
    mission = replace(mission_of(start), system_id=start.system_id)
    return Session(
        mission,
        seed=start.seed,
        lockstep=start.lockstep,
        shadow=start.shadow,
        resume=_resume_of(start, mission),
        go=start.go,
        version=start.companion,
    )


def _resume_of(start: Start, mission: Mission) -> Resume | None:
    if start.resume is None:
        return None
    try:
        known = None if start.known is None else unpacked_map(start.known)
        if known is not None:
            known = known.with_what_was_given(checkpoint.blank_map(mission))
        resume = start.resume, known
        checkpoint.initial_state(mission, resume)
    except checkpoint.DECODE_ERRORS as error:
        why = f"{type(error).__name__}: {error}"
        raise DamagedInputError(f"a start that cannot be gone on from ({why})") from error
    return resume


def feed(session: Session, recorded_input: Input) -> Output | None:
    """Feed an input to a session; returns its output, if it was a run.

    DamagedInputError: it is not a valid input.  Errors of the session are passed on.
    """
    call, *given = recorded_input
    try:
        arguments = msgspec.convert(given, _ARGUMENTS.get(call))
    except msgspec.ValidationError as error:
        raise DamagedInputError(f"an input that is none ({call!r:.40})") from error
    if call == "deliver":
        arguments = (answer_of(*arguments),)
    output = getattr(session, call)(*arguments)
    return output if isinstance(output, Output) else None


def answer_of(values: Any) -> PlanOutcome:
    """The answer of the planner that was delivered.  DamagedInputError: it is none."""
    try:
        return outcome_of(values)
    except checkpoint.DECODE_ERRORS as error:
        raise DamagedInputError(f"an answer of the planner that is none ({error!r:.80})") from error
