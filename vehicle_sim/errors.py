"""Every error that a user of the simulator can meet.  One line each, never a traceback.

SimulatorError    what went wrong on the way: exit code 1
└── InputError    what was asked for cannot be done as asked: exit code 2
"""

import difflib
from collections.abc import Iterable
from typing import final


def did_you_mean(name: str, known: Iterable[str], otherwise: str) -> str:
    """A remedy for a name that there is not: the known one that is most like it."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"Did you mean {near[0]}?" if near else otherwise


class SimulatorError(Exception):
    """What the simulator says instead of a traceback."""

    exit_code = 1


@final
class InputError(SimulatorError):
    """A file or an option that breaks a rule."""

    exit_code = 2

    def __init__(self, field: str, value: object, rule: str, remedy: str) -> None:
        message = f"{field} = {value!r}: {rule}. {remedy}"
        # keys and names of a file may hold anything, a line break too
        super().__init__("".join(c if c.isprintable() else repr(c)[1:-1] for c in message))
        self.field = field
