"""Feeds recorded inputs to an equal session: replay, what-if, report and view are made of this."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Final, final

import msgspec
from msgspec import Meta

from companion.config import elevation_file, load_mission, refuse_older
from companion.errors import InputError
from companion.mavlink.link import Input, Output
from companion.mission import checkpoint
from companion.mission.mission import Mission
from companion.mission.start import Resume, Start, SystemId, terrain_of
from companion.planner.request import PlanOutcome, outcome_of
from companion.profiles import PROFILES
from companion.session import Session
from companion.sources.files import file_of_run
from companion.telemetry.inputs import FILE, InputsFile
from companion.world.known_map import unpacked_map

_Seconds = Annotated[float, Meta(ge=-1e300, le=1e300)]
_CALLS: Final[dict[str, Any]] = {
    "receive": tuple[bytes, _Seconds | None],
    "run": tuple[()],
    "silence": tuple[_Seconds],
    "deliver": tuple[Any],
    "stop": tuple[()],
    "say_go": tuple[()],
    "complain": tuple[str],
    "part_died": tuple[str, str],
    "farewell": tuple[()],
}
"""The calls of a session that are inputs, and their arguments."""
_REMARKS: Final[dict[str, Any]] = {
    "unsent": tuple[list[int]],
    "raised": tuple[str, str],
    "held": tuple[int],
}
"""What the runtime records about a session and its output; it is not fed to the session."""
SESSION_CALLS: Final = frozenset(_CALLS)
RUNTIME_RECORDS: Final = frozenset(_REMARKS)
_NOT_RECORDED: Final = "not recorded any more: "
"""So the runtime complains once a disk fails or stands still (`runtime.loop`)."""
MissionOf = Callable[[Start], Mission]
"""The mission that a session flew: by its profile, from wherever it is kept."""


class DamagedInputError(Exception):
    """A record is not a valid input of a session."""


@final
class Feeder:
    """A session like the one that flew, and one more each time that the companion was resumed."""

    def __init__(self, mission_of: MissionOf) -> None:
        """Nothing is known before the first start."""
        self._mission_of = mission_of
        self._session: Session | None = None

    @property
    def session(self) -> Session:
        """The present one.  DamagedInputError before the first start."""
        if self._session is None:
            raise DamagedInputError("nothing before any start")
        return self._session

    def take(self, call: Input) -> Output | None:
        """Take the next input; what the session gave, if it was a run.

        DamagedInputError: it is not a valid input.  Errors of the session are passed on.
        """
        if call[0] == "start":
            self._session = None
            self._session = _session_of(start_of(call), self._mission_of)
            return None
        if (why := why_not_recorded(call)) is not None:
            call = "complain", f"{_NOT_RECORDED}{why}"
        session, arguments = self.session, arguments_of(call)
        if call[0] in RUNTIME_RECORDS:
            return None
        if call[0] == "deliver":
            arguments = (answer_of(call),)
        output = getattr(session, call[0])(*arguments)
        return output if isinstance(output, Output) else None


def outputs(folder: Path, mission_of: MissionOf) -> Iterator[tuple[Input, Session, Output | None]]:
    """What equal sessions make of a run folder's inputs: each, the session and its output.

    It ends with the recording, or where the session cannot be fed on.  InputError if the folder
    has no inputs, or of another version.
    """
    feeder = Feeder(mission_of)
    for call in InputsFile(folder / FILE):
        try:
            output = feeder.take(call)
        except InputError:
            raise
        except Exception:  # noqa: BLE001 - damage, or the session's own error: the flight's end
            return
        yield call, feeder.session, output


def flown_mission(folder: Path) -> MissionOf:
    """The mission of a run folder, as it was flown.  InputError if its terrain is another now."""
    refuse_older(folder)
    file = file_of_run(folder, "mission.toml", "RUN_DIR|LOG")
    loaded = cache(partial(load_mission, str(file)))

    def mission_of(start: Start) -> Mission:
        mission = loaded(start.profile)
        if start.terrain == terrain_of(mission):
            return mission
        if (elevation := elevation_file(str(file))) is not None:
            rule = "the elevation file has changed since the flight"
            remedy = f"Put the file of the flight there, or name it in {file}."
            raise InputError("terrain.file", elevation, rule, remedy)
        rule = "the terrain that it gives in advance has changed since the flight"
        remedy = "Give the run folder with the mission.toml that was flown."
        raise InputError("terrain", str(file), rule, remedy)

    with suppress(DamagedInputError):  # is found again, at its place
        mission_of(start_of(next(iter(InputsFile(folder / FILE)), ())))
    return mission_of


def arguments_of(recorded: Input) -> tuple[Any, ...]:
    """The arguments of a call, or what a remark says.  DamagedInputError: it is neither."""
    call, *given = recorded
    try:
        arguments: tuple[Any, ...] = msgspec.convert(given, (_CALLS | _REMARKS).get(call))
    except msgspec.ValidationError as error:
        raise DamagedInputError(f"an input that is none ({call!r:.40})") from error
    return arguments


def why_not_recorded(call: Input) -> str | None:
    """Why the recording had stopped, if this input says so: the disk failed, or stood still.

    It was an input of its own in builds before 0.3.0.
    """
    match call:
        case "recording_stopped", str(why):
            return why
        case "complain", str(text) if text.startswith(_NOT_RECORDED):
            return text.removeprefix(_NOT_RECORDED)
        case _:
            return None


def start_of(call: Input) -> Start:
    """What a session was made of, of a recorded input.  DamagedInputError: it is none."""
    try:
        start = msgspec.convert(call[1], Start)
        msgspec.convert((start.resume or {}).get("system_id"), SystemId | None)
    except (IndexError, msgspec.ValidationError) as error:
        raise DamagedInputError(f"a start that is none ({error})") from error
    if start.profile not in PROFILES:
        raise DamagedInputError(f"a start that is none (profile {start.profile!r:.40})")
    return start


def answer_of(call: Input) -> PlanOutcome:
    """The answer of the planner that was delivered.  DamagedInputError: it is none."""
    try:
        return outcome_of(call[1])
    except (IndexError, *checkpoint.DECODE_ERRORS) as error:
        raise DamagedInputError(f"an answer of the planner that is none ({error!r:.80})") from error


def _session_of(start: Start, mission_of: MissionOf) -> Session:
    mission = replace(mission_of(start), system_id=start.system_id)
    resume: Resume | None = None
    if start.resume is not None:
        try:
            known = None if start.known is None else unpacked_map(start.known)
            if known is not None:
                known = known.with_what_was_given(checkpoint.blank_map(mission))
            resume = start.resume, known
            checkpoint.initial_state(mission, resume)
        except checkpoint.DECODE_ERRORS as error:
            why = f"{type(error).__name__}: {error}"
            raise DamagedInputError(f"a start that cannot be gone on from ({why})") from error
    return Session(
        mission,
        seed=start.seed,
        lockstep=start.lockstep,
        shadow=start.shadow,
        resume=resume,
        go=start.go,
        version=start.companion,
    )
