"""One check of a vehicle before its flight; `preflight` has the list, each sensor its own."""

import enum
from typing import NamedTuple

PATIENCE_S = 5.0  # for rates and delays that have not come yet


class CheckStatus(enum.Enum):
    """Result of a check."""

    PASSED = "ok"
    NOTED = "note"
    REFUSED = "refused"


class Check(NamedTuple):
    """One check of the list."""

    name: str
    status: CheckStatus
    what: str
    """The finding and the rule."""
    remedy: str = ""


def check(name: str, passed: bool, what: str, remedy: str = "") -> Check:
    """One that the vehicle passes, or that refuses the flight."""
    status = CheckStatus.PASSED if passed else CheckStatus.REFUSED
    return Check(name, status, what, "" if passed else remedy)


def remark(name: str, what: str, remedy: str = "") -> Check:
    """One that refuses nothing."""
    return Check(name, CheckStatus.NOTED, what, remedy)
