"""Every error that a user can meet.  One line each: the field, the value, the rule, the remedy.

CompanionError
├── InputError          what was asked for cannot be done as asked: exit code 2
├── FlightFailed        the flight ended before its target, by decision: exit code 1
└── FlightInterrupted   it is not over: a companion started again may go on: exit code 75
"""

from typing import final

_MAX_SHOWN = 200
"""Characters of a value: it may be a whole file."""


class CompanionError(Exception):
    """What the companion says instead of a traceback."""

    exit_code = 1

    def __init__(self, message: str) -> None:
        super().__init__("".join(c if c.isprintable() else " " for c in message))


@final
class InputError(CompanionError):
    """A file, an option or a setting that breaks a rule."""

    exit_code = 2

    def __init__(self, field: str, value: object, rule: str, remedy: str) -> None:
        shown = repr(value)
        if len(shown) > _MAX_SHOWN:
            shown = f"{shown[:_MAX_SHOWN]}..."
        message = f"{field} = {shown}: {rule}. {remedy}"
        super().__init__(message.encode(errors="backslashreplace").decode())  # odd names of files
        self.field, self.value, self.rule, self.remedy = field, value, rule, remedy


class _Ended(CompanionError):
    """The flight did not reach its target."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason.rstrip('.')}. {remedy}" if remedy else reason)


@final
class FlightFailed(_Ended):
    """Nor will it if it is started again."""


@final
class FlightInterrupted(_Ended):
    """The vehicle was in the air and is not heard, or the companion itself has failed."""

    exit_code = 75  # EX_TEMPFAIL
