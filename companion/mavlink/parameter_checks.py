"""Checks of the autopilot's parameters against a mission.

Rules compare in SI units (angles in degrees); a rule holds the parameter's name, its older and
newer names and their units; results are in the autopilot's units.  Which ones an autopilot has
stands in its module of `autopilots/`, beside the checks that it alone needs.
"""

import enum
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, final

from companion.mission.mission import Mission
from companion.path.limits import Limits

EQUAL_WITHIN: Final = 1e-6
CENTI: Final = 0.01
_GRAVITY_M_S2: Final = 9.81
_SHORTEST_TIMEOUT_S: Final = 0.5
"""A 5 to 10 Hz stream on a lossy link must not trigger it."""
_USUAL_TIMEOUT_S: Final = 1.0
_EASY: Final = 1.5
"""Minimum ratio of the loiter radius to the tightest turn, to leave bank angle for wind."""


class Severity(enum.Enum):
    """Consequence of a result for the flight."""

    REFUSE = "refused"
    SET = "set"
    NOTE = "note"


ESSENTIAL, WANTED = Severity.REFUSE, Severity.NOTE
"""If the autopilot does not have a parameter."""


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
class Rule:
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


def names_of(rules: Iterable[Rule]) -> tuple[tuple[str, ...], ...]:
    """All names of each parameter of a table: what `ParameterClient` asks for."""
    return tuple(tuple(alias.name for alias in rule.names) for rule in rules)


def value_of(rules: Iterable[Rule], values: Mapping[str, float], name: str) -> float | None:
    """A parameter by its usual name, in SI; None: not in the table, or not on the autopilot."""
    for rule in rules:
        if rule.name == name:
            found = rule.found(values)
            return None if found is None else found[1]
    return None


def check_parameters(
    rules: Iterable[Rule],
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


def _checked(rule: Rule, values: Mapping[str, float], case: CheckContext) -> ParameterIssue | None:
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


def _missing(rule: Rule) -> ParameterIssue | None:
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


# --- when the setpoints end: what several autopilots have -----------------------------------------


def begins_to_brake_s(
    case: CheckContext, braking: str, jerk: str, usual: tuple[float, float]
) -> float:
    """Equivalent delay from the time-out to braking with full acceleration.

    0.25 s to notice, and half the time in which the acceleration builds up (jerk-limited): 0.5 s
    with ArduCopter's defaults, which is what was measured (ardupilot.md 3, "Stream stops").
    """
    acceleration = max(case.value(braking, usual[0]), 0.1)
    return 0.25 + 0.5 * acceleration / max(case.value(jerk, usual[1]), 0.1)


def timeout(
    value: float, slack_s: float, case: CheckContext, what: str = "the vehicle flies on"
) -> ParameterIssue | None:
    """A time-out of the stream: short enough for the certified reach, long enough for a radio."""
    what = f"after the last setpoint {what}"
    dead_man_s = case.limits.dead_man_s
    shortest_s = max(_SHORTEST_TIMEOUT_S, 3.0 * case.mission.task.settings.position_period_s)
    longest_s = math.floor((dead_man_s - slack_s + EQUAL_WITHIN) * 10.0) / 10.0
    if longest_s < shortest_s:
        return refused(
            f"{what}; with {shortest_s:g} s, the least for a radio, that is "
            f"{shortest_s + slack_s:.1f} s, and vehicle.dead_man_s = {dead_man_s:g}",
            f"Set vehicle.dead_man_s to {up_to_tenths(shortest_s + slack_s):g} or more",
        )
    if value > dead_man_s - slack_s + EQUAL_WITHIN:
        rule = (
            f"{what} for {value + slack_s:.1f} s, longer than vehicle.dead_man_s = {dead_man_s:g}"
        )
        return to_set(longest_s, rule)
    if value < shortest_s - EQUAL_WITHIN:
        rule = f"shorter than the {shortest_s:g} s in which a radio may lose setpoints"
        return to_set(min(_USUAL_TIMEOUT_S, longest_s), rule)
    return None


# --- speeds, tilt and turns -----------------------------------------------------------------------


def turning_m_s2(limits: Limits) -> float:
    """Across, in the tightest turns."""
    return limits.speed_m_s**2 / limits.turn_radius_m


def tilt(value: float, case: CheckContext) -> ParameterIssue | None:
    """The tilt limit as acceleration, without drag, which is unknown."""
    needed_m_s2 = max(case.limits.acceleration_m_s2, turning_m_s2(case.limits))
    has_m_s2 = _GRAVITY_M_S2 * math.tan(math.radians(min(max(value, 0.0), 80.0)))
    if has_m_s2 >= needed_m_s2:
        return None
    degrees = math.degrees(math.atan(needed_m_s2 / _GRAVITY_M_S2))
    return refused(
        f"{value:g} deg of tilt give {has_m_s2:.1f} m/s2, and the mission's speed, turn radius "
        f"and acceleration ask for {needed_m_s2:.1f}",
        f"Allow {math.ceil(degrees)} deg or more, or fly slower and wider turns",
    )


def _tightest_circle_m(speed_m_s: float, bank_deg: float) -> float:
    bank = math.radians(min(max(bank_deg, 1.0), 80.0))
    return speed_m_s**2 / (_GRAVITY_M_S2 * math.tan(bank))


def bank(value: float, case: CheckContext) -> ParameterIssue | None:
    """The bank limits how tightly it turns."""
    limits = case.limits
    tightest_m = _tightest_circle_m(limits.speed_m_s, value)
    if tightest_m <= limits.turn_radius_m + EQUAL_WITHIN:
        return None
    return refused(
        f"with {value:g} deg of bank its tightest turn at {limits.speed_m_s:g} m/s has a radius of "
        f"{tightest_m:.0f} m, and the mission turns with {limits.turn_radius_m:g} m",
        f"Set vehicle.turn_radius_m to {math.ceil(tightest_m)} or more",
    )


def circles(wider_m: float, bank: str) -> ParameterCheck:
    """Whether the autopilot's loiter circles, which are wider by this, stay in the cleared ones.

    bank: the parameter that limits the bank.
    """

    def check(value: float, case: CheckContext) -> ParameterIssue | None:
        limits, flown_m = case.limits, abs(value) + wider_m
        if limits.hovers or flown_m <= limits.loiter_radius_m + EQUAL_WITHIN:
            return None
        rule = (
            f"its circles are flown with {flown_m:g} m, and the mission keeps "
            f"vehicle.loiter_radius_m = {limits.loiter_radius_m:g} clear"
        )
        fits_m = math.floor(limits.loiter_radius_m - wider_m)
        if fits_m < _EASY * _tightest_circle_m(limits.speed_m_s, case.value(bank, 45.0)):
            return refused(rule, f"Set vehicle.loiter_radius_m to {flown_m:g} or more")
        return to_set(math.copysign(fits_m, value), rule)

    return check


def _climb_m_s(limits: Limits) -> float:
    return min(limits.climb_rate_m_s, limits.speed_m_s)


def _sink_m_s(limits: Limits) -> float:
    return min(limits.climb_rate_m_s, _plane_sink_m_s(limits))


def _plane_climb_m_s(limits: Limits) -> float:
    """A plane flies every climb at its speed."""
    return limits.speed_m_s * math.sin(limits.climb_angle_rad)


def _plane_sink_m_s(limits: Limits) -> float:
    return limits.speed_m_s * math.sin(limits.dive_angle_rad)


_VERTICAL: Final = (
    "it {verb} with {{value:g}} m/s at most, and the mission asks for {{planned:.1f}}"
)
_CLIMBS: Final = _VERTICAL.format(verb="climbs")
_SINKS: Final = _VERTICAL.format(verb="sinks")
_RAISE: Final = "Raise it to {up:g}, or set "
_OTHER_RATE: Final = _RAISE + "vehicle.climb_rate_m_s to {value:g}"
COPTER_CLIMBS: Final = at_least(_climb_m_s, _CLIMBS, _OTHER_RATE)
COPTER_SINKS: Final = at_least(_sink_m_s, _SINKS, _OTHER_RATE)
PLANE_CLIMBS: Final = at_least(
    _plane_climb_m_s, _CLIMBS, _RAISE + "a smaller vehicle.climb_angle_deg"
)
PLANE_SINKS: Final = at_least(_plane_sink_m_s, _SINKS, _RAISE + "a smaller vehicle.dive_angle_deg")
BRAKES: Final = at_least(
    lambda limits: limits.acceleration_m_s2,
    "it brakes with {value:g} m/s2, and the mission counts on {planned:g}",
    "Raise it, or set vehicle.acceleration_m_s2 to {value:g} or less",
)
SLOWEST: Final = at_most(
    lambda limits: limits.speed_m_s,
    "vehicle.speed_m_s = {planned:g} is slower than it may fly",
    "Fly {value:g} m/s or faster",
)
FASTEST: Final = at_least(
    lambda limits: limits.speed_m_s,
    "vehicle.speed_m_s = {planned:g} is faster than it may fly",
    "Fly {value:g} m/s or slower",
)
