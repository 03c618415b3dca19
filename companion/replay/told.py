"""A recorded flight told again: the inputs of a session, handed to a session like it."""

from collections.abc import Callable

from companion.mavlink.outbox import Input, Output
from companion.mission import checkpoint
from companion.mission.mission import Mission
from companion.mission.renewed import replace
from companion.mission.start import Start
from companion.planner.outcomes import outcome_of
from companion.session import Session
from companion.world.packed_map import unpacked_map

OUTSIDE = frozenset({"unsent", "held"})
"""Inputs that say what became of a session's output: the session is not told of them."""


MissionOf = Callable[[Start], Mission]
"""The mission that a session flew: by its profile, from wherever it is kept."""


class TornError(Exception):
    """What was recorded is not what a session can be told."""


def start_of(told: Input) -> Start:
    """What a session was made of, of a recorded input.  TornError: it is none."""
    try:
        return Start(**told[1])
    except (IndexError, TypeError) as error:
        raise TornError(f"a start that is none ({error})") from error


def session_of(start: Start, mission_of: MissionOf) -> Session:
    """A session like that.  TornError: what it went on from cannot be read."""
    mission = replace(mission_of(start), system_id=start.system_id)
    try:
        resume = None
        if start.resume is not None:
            known = None if start.known is None else unpacked_map(start.known)
            if known is not None:
                known = replace(known, given=checkpoint.blank(mission).given)
            resume = start.resume, known
        return Session(
            mission,
            seed=start.seed,
            lockstep=start.lockstep,
            shadow=start.shadow,
            resume=resume,
            version=start.companion,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise TornError(f"a start that cannot be gone on from ({error})") from error


def tell(session: Session, told: Input) -> Output | None:
    """Tell a session once more what it was told; what follows from it, if it was to be handled.

    TornError: it is nothing that a session is told.
    """
    try:
        match told:
            case ("receive", bytes(data), at_s):
                session.receive(data, at_s)
            case ("run",):
                return session.run()
            case ("silence", float() | int() as silent_s):
                session.silence(silent_s)
            case ("deliver", values):
                session.deliver(outcome_of(values))
            case ("stop",):
                session.stop()
            case ("complain", str(text)):
                session.complain(text)
            case ("part_died", str(part), str(error)):
                session.part_died(part, error)
            case ("recording_stopped", str(why)):
                session.recording_stopped(why)
            case ("farewell",):
                return session.farewell()
            case _:
                raise TornError(f"an input of no known kind ({told[0]!r})")
    except (KeyError, TypeError, ValueError) as error:
        raise TornError(f"a broken input ({told[0]!r}: {error})") from error
    return None
