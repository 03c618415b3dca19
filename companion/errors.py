"""Every error that a user can meet.  One line each: the field, the value, the rule, the remedy.

CompanionError
├── InputError      what was asked for cannot be done as asked: exit code 2
└── FlightFailed    the flight ended before its target: exit code 1
"""

from typing import final


class CompanionError(Exception):
    """What the companion says instead of a traceback."""

    exit_code = 1


@final
class InputError(CompanionError):
    """A file, an option or a setting that breaks a rule."""

    exit_code = 2

    def __init__(self, field: str, value: object, rule: str, remedy: str) -> None:
        super().__init__(f"{field} = {value!r}: {rule}. {remedy}")
        self.field = field


@final
class FlightFailed(CompanionError):
    """The flight did not reach its target."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}. {remedy}")
