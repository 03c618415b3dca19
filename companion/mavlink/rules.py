"""Rules about the autopilot's parameters: what a mission sets, and for what it refuses to fly.

Rules compare in SI units (angles in degrees); results are in the autopilot's own.  Which ones an
autopilot has stands in its module of `autopilots/`, beside the checks that it alone needs.  What
only deserves a look is not here, but in docs/reference/parameters.md.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, final

from companion.mission.mission import Mission
from companion.path.envelope import RISES
from companion.path.limits import Limits

EQUAL_WITHIN: Final = 1e-6
CENTI: Final = 0.01
_GRAVITY_M_S2: Final = 9.81
_SHORTEST_TIMEOUT_S: Final = 0.5
"""A 5 to 10 Hz stream on a lossy link must not trigger it."""
_USUAL_TIMEOUT_S: Final = 1.0
_EASY: Final = 1.5
"""Minimum ratio of the loiter radius to the tightest turn, to leave bank angle for wind."""


@final
@dataclass(frozen=True, slots=True)
class Finding:
    """One parameter that does not fit the mission."""

    rule: str
    remedy: str = ""
    set_to: float | None = None
    """The value to give it, in the autopilot's own unit (in SI while it is checked); None: the
    flight is refused."""
    name: str = ""
    """The autopilot's name of it; empty while it is checked."""
    value: float | None = None
    """In the autopilot's own unit; None: it has no such parameter."""

    def __str__(self) -> str:
        """One line: the parameter, its value, the rule, the remedy."""
        value = "unknown" if self.value is None else f"{self.value:g}"
        return f"{self.name} = {value}: {self.rule}." + (f" {self.remedy}." if self.remedy else "")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What a check may look at besides the value: the mission, home and other parameters."""

    mission: Mission
    home_amsl_m: float | None
    values: Mapping[str, float]
    """Of the same table, as far as they are known, by their usual names, in SI."""

    @property
    def limits(self) -> Limits:
        """The mission's."""
        return self.mission.task.limits


Check = Callable[[float, Case], Finding | None]
"""Checks a value in SI (angles in degrees); None: it is fine."""


@final
@dataclass(frozen=True, slots=True)
class Rule:
    """One parameter that matters for a mission."""

    name: str
    check: Check | None = None
    """None: it is only read, for the fence or for other rules."""
    essential: str = ""
    """What it decides, of one without which nothing flies; empty: it may be missing."""
    scale: float = 1.0
    """The value times this is in SI."""
    also: str = ""
    """Its older or newer name,"""
    also_scale: float = 1.0
    """and its unit there."""
    matters: Callable[[Mission], bool] = lambda _: True
    """For other missions it is not asked for."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names, the usual one first."""
        return (self.name, self.also) if self.also else (self.name,)

    def reading(self, values: Mapping[str, float]) -> tuple[str, float, float] | None:
        """Its name on this autopilot, its value in SI, and the scale of its unit."""
        for name, scale in ((self.name, self.scale), (self.also, self.also_scale)):
            value = values.get(name)
            if value is not None and math.isfinite(value):
                return name, value * scale, scale
        return None


def only_read(names: str) -> tuple[Rule, ...]:
    """Rules without a check; "A/B": the parameter A, whose other name is B.

    Some of them nobody looks at any more: the golden flights were recorded when they were asked
    for, and are prepared a second or two earlier without.
    """
    pairs = (name.partition("/") for name in names.split())
    return tuple(Rule(name, also=also) for name, _, also in pairs)


def findings_of(
    rules: Iterable[Rule],
    values: Mapping[str, float],
    mission: Mission,
    home_amsl_m: float | None = None,
) -> list[Finding]:
    """Check an autopilot's parameters for a mission; what is refused comes first.

    values: by name, in the autopilot's units, when everything was asked for.  A mission that does
    not set parameters (`sets_parameters`) refuses what otherwise would be set.
    """
    readings = {rule: rule.reading(values) for rule in rules if rule.matters(mission)}
    if readings and not any(readings.values()):
        silent = "the autopilot has answered no request for a parameter"
        return [Finding(silent, "Check that the link carries both ways", name="parameters")]
    in_si = {rule.name: known[1] for rule, known in readings.items() if known is not None}
    case = Case(mission=mission, home_amsl_m=home_amsl_m, values=in_si)
    findings = list[Finding]()
    for rule, known in readings.items():
        if known is None and rule.essential:
            missing = f"the autopilot does not tell it; {rule.essential}"
            findings.append(Finding(missing, "Fly a firmware that has it", name=rule.name))
        elif known is not None and rule.check is not None:
            name, value, scale = known
            if (verdict := rule.check(value, case)) is not None:
                finding = replace(verdict, name=name, value=values[name])
                findings.append(_to_be_set(finding, scale, mission))
    return sorted(findings, key=lambda finding: finding.set_to is not None)


def _to_be_set(finding: Finding, scale: float, mission: Mission) -> Finding:
    """With what it is set to in the autopilot's unit, or should be, if the mission sets nothing."""
    if finding.set_to is None:
        return finding
    set_to = float(f"{finding.set_to / scale:.6g}")  # without the noise of the conversion
    if mission.sets_parameters:
        return replace(finding, remedy=f"It is set to {set_to:g}", set_to=set_to)
    return replace(finding, remedy=f"Set it to {set_to:g}", set_to=None)


def when(wrong: Callable[[float, Case], object], rule: str, remedy: str) -> Check:
    """Refuses if the condition is true."""
    refusal = Finding(rule, remedy)
    return lambda value, case: refusal if wrong(value, case) else None


def at_least(
    bound: Callable[[Limits], float], rule: str, remedy: str, *, most: bool = False
) -> Check:
    """Refuses less than a mission needs; most: more than it allows.

    In the texts stand {value}, {needed}, and {up}, that rounded up to tenths.
    """

    def check(value: float, case: Case) -> Finding | None:
        needed = bound(case.limits)
        if (needed - value if most else value - needed) >= -EQUAL_WITHIN:
            return None
        words = {"value": value, "needed": needed, "up": up_to_tenths(needed)}
        return Finding(rule.format(**words), remedy.format(**words))

    return check


def up_to_tenths(value: float) -> float:
    """Rounded up to tenths, with a tolerance for rounding errors."""
    return math.ceil(value * 10.0 - EQUAL_WITHIN) / 10.0


# --- when the setpoints end: what several autopilots have -----------------------------------------


def begins_to_brake_s(case: Case, braking: str, jerk: str, usual: tuple[float, float]) -> float:
    """Equivalent delay from the time-out to braking with full acceleration.

    0.25 s to notice, and half the time in which the acceleration builds up (jerk-limited): 0.5 s
    with ArduCopter's defaults, which is what was measured (ardupilot.md 3, "Stream stops").
    """
    acceleration = max(case.values.get(braking, usual[0]), 0.1)
    return 0.25 + 0.5 * acceleration / max(case.values.get(jerk, usual[1]), 0.1)


def timeout(
    value: float, slack_s: float, case: Case, what: str = "the vehicle flies on"
) -> Finding | None:
    """A time-out of the stream: short enough for the certified reach, long enough for a radio."""
    what = f"after the last setpoint {what}"
    dead_man_s = case.limits.dead_man_s
    shortest_s = max(_SHORTEST_TIMEOUT_S, 3.0 * case.mission.task.settings.position_period_s)
    longest_s = math.floor((dead_man_s - slack_s + EQUAL_WITHIN) * 10.0) / 10.0
    if longest_s < shortest_s:
        return Finding(
            f"{what}; with {shortest_s:g} s, the least for a radio, that is "
            f"{shortest_s + slack_s:.1f} s, and vehicle.dead_man_s = {dead_man_s:g}",
            f"Set vehicle.dead_man_s to {up_to_tenths(shortest_s + slack_s):g} or more",
        )
    if value > dead_man_s - slack_s + EQUAL_WITHIN:
        rule = f"{what} for {value + slack_s:.1f} s, longer than vehicle.dead_man_s = "
        return Finding(f"{rule}{dead_man_s:g}", set_to=longest_s)
    if value < shortest_s - EQUAL_WITHIN:
        rule = f"shorter than the {shortest_s:g} s in which a radio may lose setpoints"
        return Finding(rule, set_to=min(_USUAL_TIMEOUT_S, longest_s))
    return None


# --- speeds, tilt and turns -----------------------------------------------------------------------


def tilt(value: float, case: Case) -> Finding | None:
    """The tilt limit as acceleration, without drag, which is unknown."""
    limits = case.limits
    needed_m_s2 = max(limits.acceleration_m_s2, limits.speed_m_s**2 / limits.turn_radius_m)
    has_m_s2 = _GRAVITY_M_S2 * math.tan(math.radians(min(max(value, 0.0), 80.0)))
    if has_m_s2 >= needed_m_s2:
        return None
    degrees = math.degrees(math.atan(needed_m_s2 / _GRAVITY_M_S2))
    return Finding(
        f"{value:g} deg of tilt give {has_m_s2:.1f} m/s2, and the mission's speed, turn radius "
        f"and acceleration ask for {needed_m_s2:.1f}",
        f"Allow {math.ceil(degrees)} deg or more, or fly slower and wider turns",
    )


def _tightest_circle_m(speed_m_s: float, bank_deg: float) -> float:
    bank = math.radians(min(max(bank_deg, 1.0), 80.0))
    return speed_m_s**2 / (_GRAVITY_M_S2 * math.tan(bank))


def bank(value: float, case: Case) -> Finding | None:
    """The bank limits how tightly it turns."""
    limits = case.limits
    tightest_m = _tightest_circle_m(limits.speed_m_s, value)
    if tightest_m <= limits.turn_radius_m + EQUAL_WITHIN:
        return None
    return Finding(
        f"with {value:g} deg of bank its tightest turn at {limits.speed_m_s:g} m/s has a radius of "
        f"{tightest_m:.0f} m, and the mission turns with {limits.turn_radius_m:g} m",
        f"Set vehicle.turn_radius_m to {math.ceil(tightest_m)} or more",
    )


def circles(wider_m: float, bank: str) -> Check:
    """Whether the autopilot's loiter circles, which are wider by this, stay in the cleared ones.

    bank: the parameter that limits the bank.
    """

    def check(value: float, case: Case) -> Finding | None:
        limits, flown_m = case.limits, abs(value) + wider_m
        if limits.hovers or flown_m <= limits.loiter_radius_m + EQUAL_WITHIN:
            return None
        rule = (
            f"its circles are flown with {flown_m:g} m, and the mission keeps "
            f"vehicle.loiter_radius_m = {limits.loiter_radius_m:g} clear"
        )
        fits_m = math.floor(limits.loiter_radius_m - wider_m)
        if fits_m < _EASY * _tightest_circle_m(limits.speed_m_s, case.values.get(bank, 45.0)):
            return Finding(rule, f"Set vehicle.loiter_radius_m to {flown_m:g} or more")
        return Finding(rule, set_to=math.copysign(fits_m, value))

    return check


# --- what the mission plans with ------------------------------------------------------------------


def _rate(verb: str, needed: Callable[[Limits], float], otherwise: str) -> Check:
    rule = f"it {verb} with {{value:g}} m/s at most, and the mission asks for {{needed:.1f}}"
    return at_least(needed, rule, f"Raise it to {{up:g}}, or set {otherwise}")


def _copter_rate(limits: Limits) -> float:
    """No climb is steeper than the speed."""
    return min(limits.climb_rate_m_s, limits.speed_m_s)


def _dive_m_s(limits: Limits) -> float:
    return limits.speed_m_s * math.sin(limits.dive_angle_rad)


def _climb_m_s(limits: Limits) -> float:
    """A plane flies every climb at its speed."""
    return limits.speed_m_s * math.sin(limits.climb_angle_rad)


_LESS = "vehicle.climb_rate_m_s to {value:g}"
copter_climbs = _rate("climbs", _copter_rate, _LESS)
copter_sinks = _rate("sinks", lambda limits: min(limits.climb_rate_m_s, _dive_m_s(limits)), _LESS)
plane_climbs = _rate("climbs", _climb_m_s, "a smaller vehicle.climb_angle_deg")
plane_sinks = _rate("sinks", _dive_m_s, "a smaller vehicle.dive_angle_deg")
brakes = at_least(
    lambda limits: limits.acceleration_m_s2,
    "it brakes with {value:g} m/s2, and the mission counts on {needed:g}",
    "Raise it, or set vehicle.acceleration_m_s2 to {value:g} or less",
)
rises = at_least(
    lambda limits: RISES * limits.acceleration_m_s2,
    "it gains a climb rate with {value:g} m/s2, and the mission counts on {needed:g}",
    "Raise it, or set a smaller vehicle.acceleration_m_s2",
)
_SPEED = "vehicle.speed_m_s = {needed:g} is"
slowest = at_least(
    lambda limits: limits.speed_m_s,
    f"{_SPEED} slower than it may fly",
    "Fly {value:g} m/s or faster",
    most=True,
)
fastest = at_least(
    lambda limits: limits.speed_m_s,
    f"{_SPEED} faster than it may fly",
    "Fly {value:g} m/s or slower",
)
