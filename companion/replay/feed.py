"""Feeds recorded inputs to an equal session: replay, what-if, report and view are made of this."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, final

import msgspec
from msgspec import Meta

from companion.config import read_mission, refuse_older
from companion.errors import InputError
from companion.mavlink.link import Input, Output
from companion.mission import checkpoint
from companion.mission.mission import Mission
from companion.mission.start import Resume, Start, SystemId, terrain_of
from companion.planner.request import outcome_of
from companion.profiles import PROFILES
from companion.session import Session
from companion.sources.files import file_of_run
from companion.telemetry.inputs import FILE, InputsFile
from companion.world.known_map import unpacked_map

_Seconds = Annotated[float, Meta(ge=-1e300, le=1e300)]
_CALLS: Final[dict[str, Any]] = {
    "start": tuple[Start],
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
"""The calls of a session that are inputs, and their arguments; the first makes it."""
_REMARKS: Final[dict[str, Any]] = {
    "unsent": tuple[list[int]],
    "raised": tuple[str, str],
    "held": tuple[int],
}
"""What the runtime records about a session and its output; it is not fed to the session."""
SESSION_CALLS: Final = frozenset(_CALLS)
RUNTIME_RECORDS: Final = frozenset(_REMARKS)
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
        name, arguments = call[0], arguments_of(call)
        if name == "start":
            self._session = None
            self._session = _session_of(arguments[0], self._mission_of)
            return None
        session = self.session
        output = None if name in RUNTIME_RECORDS else getattr(session, name)(*arguments)
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
    read = read_mission(str(file))
    loaded = cache(read.mission)

    def mission_of(start: Start) -> Mission:
        mission = loaded(start.profile)
        if start.terrain == terrain_of(mission):
            return mission
        if (elevation := read.elevation_file) is not None:
            rule = "the elevation file has changed since the flight"
            remedy = f"Put the file of the flight there, or name it in {file}."
            raise InputError("terrain.file", str(elevation), rule, remedy)
        rule = "the terrain that it gives in advance has changed since the flight"
        remedy = "Give the run folder with the mission.toml that was flown."
        raise InputError("terrain", str(file), rule, remedy)

    first: Input = next(iter(InputsFile(folder / FILE)), ("",))
    if first[0] == "start":
        with suppress(DamagedInputError):  # is found again, at its place
            mission_of(*arguments_of(first))
    return mission_of


def arguments_of(recorded: Input) -> tuple[Any, ...]:
    """The arguments of a call, or what a remark says.  DamagedInputError: it is neither.

    Of a start its `Start`, of a deliver the planner's answer.
    """
    name, *given = recorded
    try:
        arguments: tuple[Any, ...] = msgspec.convert(given, (_CALLS | _REMARKS).get(name))
        if name == "start":
            _check(*arguments)
        return (outcome_of(*arguments),) if name == "deliver" else arguments
    except checkpoint.DECODE_ERRORS as error:
        words = {"start": "a start", "deliver": "an answer of the planner"}
        what = words.get(name, f"an input {name!r:.40}")
        raise DamagedInputError(f"{what} that is none ({error!r:.80})") from error


def _check(start: Start) -> None:
    """What the types do not say.  ValueError."""
    msgspec.convert((start.resume or {}).get("system_id"), SystemId | None)
    if start.profile not in PROFILES:
        raise ValueError(f"profile {start.profile!r:.40}")


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
