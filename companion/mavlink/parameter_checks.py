"""Checks of the autopilot's parameters against a mission.

Rules compare in SI units (angles in degrees); a rule holds the parameter's name, its older and
newer names and their units; results are in the autopilot's units.
"""

import enum
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, final

from companion.mission.mission import Mission
from companion.path.limits import Limits

EQUAL_WITHIN: Final = 1e-6


class Severity(enum.Enum):
    """Consequence of a result for the flight."""

    REFUSE = "refused"
    SET = "set"
    NOTE = "note"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterIssue:
    """One parameter that does not fit the mission, or that the operator should know about."""

    severity: Severity
    rule: str
    remedy: str = ""
    set_to: float | None = None
    """Of SET: the value to give it, in the autopilot's own unit; in SI while it is checked."""
    name: str = ""
    """The autopilot's name of it; empty while it is checked."""
    value: float | None = None
    """In the autopilot's own unit; None: it has no such parameter."""

    def __str__(self) -> str:
        """One line: the parameter, its value, the rule, the remedy."""
        value = "unknown" if self.value is None else f"{self.value:g}"
        return f"{self.name} = {value}: {self.rule}." + (f" {self.remedy}." if self.remedy else "")


@final
@dataclass(frozen=True, slots=True)
class Alias:
    """Another name of a parameter; its value times the scale is in SI."""

    name: str
    scale: float = 1.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CheckContext:
    """Context of a check: the mission, home and other parameters."""

    mission: Mission
    home_amsl_m: float | None
    read: Callable[[str], float | None]
    """The value of another parameter of the same table by its usual name, in SI."""

    def value(self, name: str, otherwise: float) -> float:
        """The value of another parameter, or this where the autopilot has none."""
        value = self.read(name)
        return otherwise if value is None else value

    @property
    def limits(self) -> Limits:
        """The mission's."""
        return self.mission.task.limits


ParameterCheck = Callable[[float, CheckContext], ParameterIssue | None]
"""Checks a value in SI (angles in degrees); None: it is fine."""


@final
@dataclass(frozen=True, slots=True)
class ParameterRule:
    """One parameter that matters for a mission."""

    name: str
    meaning: str
    """Its effect on a mission, as text for the operator."""
    checks: tuple[ParameterCheck, ...] = ()
    """The first result counts; (): only read, for the fence or other rules."""
    if_missing: Severity | None = None
    """Severity if the autopilot does not have it; None: none."""
    scale: float = 1.0
    """The value times this is in SI."""
    also: Alias | None = None
    """Its older or newer name."""
    matters: Callable[[Mission], bool] = lambda _: True
    """For other missions it is not asked for."""

    @property
    def names(self) -> tuple[Alias, ...]:
        """All names, the usual one first."""
        usual = Alias(self.name, self.scale)
        return (usual,) if self.also is None else (usual, self.also)

    def found(self, values: Mapping[str, float]) -> tuple[Alias, float] | None:
        """Its name on this autopilot, and its value in SI."""
        for alias in self.names:
            value = values.get(alias.name)
            if value is not None and math.isfinite(value):
                return alias, value * alias.scale
        return None


def names_of(rules: Iterable[ParameterRule]) -> tuple[tuple[str, ...], ...]:
    """All names of each parameter of a table: what `ParameterClient` asks for."""
    return tuple(tuple(alias.name for alias in rule.names) for rule in rules)


def value_of(
    rules: Iterable[ParameterRule], values: Mapping[str, float], name: str
) -> float | None:
    """A parameter by its usual name, in SI; None: not in the table, or not on the autopilot."""
    for rule in rules:
        if rule.name == name:
            found = rule.found(values)
            return None if found is None else found[1]
    return None


def check_parameters(
    rules: Iterable[ParameterRule],
    values: Mapping[str, float],
    mission: Mission,
    home_amsl_m: float | None = None,
) -> list[ParameterIssue]:
    """Check an autopilot's parameters for a mission, the most severe results first.

    values: by name, in the autopilot's units, when everything was asked for.  A mission that does
    not set parameters (`sets_parameters`) refuses what otherwise would be set.
    """
    rules = tuple(rules)
    if rules and not any(rule.found(values) for rule in rules):
        return [_NOTHING]
    case = CheckContext(
        mission=mission, home_amsl_m=home_amsl_m, read=lambda name: value_of(rules, values, name)
    )
    found = (_checked(rule, values, case) for rule in rules)
    order = list(Severity)
    return sorted(
        (finding for finding in found if finding is not None),
        key=lambda finding: order.index(finding.severity),
    )


_NOTHING: Final = ParameterIssue(
    name="parameters",
    value=None,
    rule="the autopilot has answered no request for a parameter",
    remedy="Check that the link carries both ways",
    severity=Severity.REFUSE,
)


def _checked(
    rule: ParameterRule, values: Mapping[str, float], case: CheckContext
) -> ParameterIssue | None:
    found = rule.found(values)
    if found is None:
        return _missing(rule)
    alias, value = found
    said = (check(value, case) for check in rule.checks)
    verdict = next((each for each in said if each is not None), None)
    if verdict is None:
        return None
    set_to = verdict.set_to
    if set_to is not None:  # without the noise of the conversion between units
        set_to = float(f"{set_to / alias.scale:.6g}")
    severity, remedy = verdict.severity, verdict.remedy
    if set_to is not None:
        remedy = f"It is set to {set_to:g}"
        if not case.mission.sets_parameters:
            severity, remedy = Severity.REFUSE, f"Set it to {set_to:g}"
            set_to = None
    issue = replace(verdict, severity=severity, remedy=remedy, set_to=set_to)
    return replace(issue, name=alias.name, value=values[alias.name])


def _missing(rule: ParameterRule) -> ParameterIssue | None:
    if rule.if_missing is None:
        return None
    refused = rule.if_missing is Severity.REFUSE
    return ParameterIssue(
        name=rule.name,
        value=None,
        rule=f"the autopilot does not tell it; {rule.meaning}",
        remedy="Fly a firmware that has it" if refused else "See to it by hand",
        severity=rule.if_missing,
    )


# --- verdicts -------------------------------------------------------------------------------------


def refused(rule: str, remedy: str) -> ParameterIssue:
    """Refuse the flight."""
    return ParameterIssue(severity=Severity.REFUSE, rule=rule, remedy=remedy)


def to_set(value: float, rule: str) -> ParameterIssue:
    """Set the parameter to this value, SI."""
    return ParameterIssue(severity=Severity.SET, rule=rule, set_to=value)


def note(rule: str, remedy: str = "") -> ParameterIssue:
    """A note to the operator."""
    return ParameterIssue(severity=Severity.NOTE, rule=rule, remedy=remedy)


# --- checks that compare: texts have {value}, {planned} and {up}, the planned one up to tenths ----


def at_least(
    planned: Callable[[Limits], float],
    rule: str,
    remedy: str = "",
    *,
    severity: Severity = Severity.REFUSE,
    share: float = 1.0,
) -> ParameterCheck:
    """The value must be at least (a share of) what the mission plans with."""

    def check(value: float, case: CheckContext) -> ParameterIssue | None:
        needed = planned(case.limits)
        is_enough = value >= share * needed - EQUAL_WITHIN
        return None if is_enough else _result(severity, rule, remedy, value, needed)

    return check


def at_most(planned: Callable[[Limits], float], rule: str, remedy: str) -> ParameterCheck:
    """The value must be at most what the mission plans with."""

    def check(value: float, case: CheckContext) -> ParameterIssue | None:
        needed = planned(case.limits)
        if value <= needed + EQUAL_WITHIN:
            return None
        return _result(Severity.REFUSE, rule, remedy, value, needed)

    return check


def _result(
    severity: Severity, rule: str, remedy: str, value: float, planned: float
) -> ParameterIssue:
    known = {"value": value, "planned": planned, "up": up_to_tenths(planned)}
    return ParameterIssue(
        severity=severity, rule=rule.format_map(known), remedy=remedy.format_map(known)
    )


def up_to_tenths(value: float) -> float:
    """Rounded up to tenths, with a tolerance for rounding errors."""
    return math.ceil(value * 10.0 - EQUAL_WITHIN) / 10.0


def when(
    wrong: Callable[[float, CheckContext], object],
    rule: str,
    remedy: str = "",
    *,
    severity: Severity = Severity.NOTE,
) -> ParameterCheck:
    """A result if the condition is true."""
    verdict = ParameterIssue(severity=severity, rule=rule, remedy=remedy)
    return lambda value, case: verdict if wrong(value, case) else None


def is_set(rule: str) -> ParameterCheck:
    """A note if the value is not 0, as for a failsafe."""
    return when(lambda value, _: value, rule)


def is_zero(rule: str, remedy: str, *, severity: Severity = Severity.NOTE) -> ParameterCheck:
    """A result if the value is 0."""
    return when(lambda value, _: not value, rule, remedy, severity=severity)
