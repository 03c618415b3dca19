"""A flight explained on one page: self-contained HTML, made from what was recorded.

The page loads nothing and runs nothing; all that comes from the flight is escaped by the template.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, final

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from companion.mission import journal as noted
from companion.mission.journal import PlanReady
from companion.objective.scene import Weights
from companion.path.certificate import Certificate
from companion.views.report_facts import FlightFacts, Nearest
from companion.views.report_figures import svg_figures
from companion.views.words import BAD, entry_words, metres

_TERMS: Final = tuple(Weights.__dataclass_fields__)
_OUTCOMES: Final = {
    "arrived": ("Arrived", "good", "✔"),
    "failed": ("Failed", BAD, "✘"),
    "stopped": ("Stopped", BAD, "■"),
}
_LED_UP: Final = 4  # of its last holds
_NOT_ENDED: Final = ("Not ended", BAD, "?")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One line of the summary."""

    name: str
    value: str
    details: str = ""
    is_bad: bool = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SubpathRow:
    """One subpath of the tables."""

    number: str
    """Of the leg; a dash if it was never begun."""
    begun: str
    plan: PlanReady
    terms: tuple[tuple[str, float], ...]
    """What each cost term contributes, as text and as a percentage of the cost."""
    proof: tuple[str, ...]


def report_html(facts: FlightFacts) -> str:
    """The page.  What could not be recorded is named in it."""
    pages = Environment(
        loader=PackageLoader("companion", "views"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    outcome = _NOT_ENDED if facts.end is None else _OUTCOMES[facts.end.outcome]
    return pages.get_template("report.html.j2").render(
        facts=facts,
        task=facts.flight.mission.task,
        outcome=outcome,
        summary=list(_summary(facts)),
        health=list(_health(facts)),
        figures={name: Markup(svg) for name, svg in svg_figures(facts).items()},
        term_names=_TERMS,
        proof_names=tuple(_PROOF),
        subpaths=_subpaths(facts),
        refused=facts.count(noted.PlanRefused),
        events=list(_events(facts)),
        began=_began(facts),
        led_up=_led_up(facts) if outcome[1] == BAD else "",
    )


def _began(facts: FlightFacts) -> str:
    """Who flew, and when it began."""
    found = [e.name for _, _, e in facts.flight.entries if isinstance(e, noted.VehicleFound)]
    with suppress(TypeError, ValueError):
        began = datetime.fromisoformat(facts.run.get("began", ""))
        found.append(f"{began.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC")
    return " · ".join(found)


def _led_up(facts: FlightFacts) -> str:
    """What stopped a flight that did not arrive, before it ended."""
    told = [f"{each.why} ({facts.time_s(each.boot, each.t_s):,.0f} s)" for each in facts.holds]
    return ", then ".join(told[-_LED_UP:])


def _summary(facts: FlightFacts) -> Iterator[Fact]:
    """What people want to know first."""
    task = facts.flight.mission.task
    if len(facts.route_nea_m) and facts.flight.targets_ne_m:
        yield _route(facts)
    if facts.nearest is not None:
        yield _nearest(facts.nearest, task.settings.safety_distance_m)
    if task.radars:
        exposure = facts.exposure
        value, details = "none", f"{len(task.radars)} radars known"
        if exposure.detection > 0.0:
            value = f"{metres(exposure.length_m)}, {exposure.duration_s:,.0f} s"
            details += f"; highest probability of detection {exposure.detection:.0%}"
            details += f" ({exposure.radar})"
        yield Fact(name="Within radar ranges", value=value, details=details)
    holds = facts.holds
    why = list(dict.fromkeys(each.why for each in holds))
    value = f"{len(holds)}, {facts.held_s:,.0f} s in all" if holds else "none"
    yield Fact(name="Holds", value=value, details="; ".join(why))
    begun = sum(each.leg is not None for each in facts.flight.planned)
    count, refused = len(facts.flight.planned), facts.count(noted.PlanRefused)
    late = facts.count(noted.PlanLate)
    details = f"{begun} of {count} subpaths flown; {refused} plans refused, {late} late"
    if facts.planning_s is not None:
        median_s, longest_s = facts.planning_s
        value = f"{median_s * 1e3:,.0f} ms, longest {longest_s * 1e3:,.0f} ms"
        details += f"; T is {task.settings.planning_time_s:g} s"
        yield Fact(name="Planning time, median", value=value, details=details)
    else:
        yield Fact(name="Plans", value=f"{count}", details=details)
    if len(facts.route_nea_m):
        times_s = facts.times_s[facts.on_the_way]
        took_s = float(times_s[-1] - times_s[0])
        mean = facts.flown_m / took_s if took_s else 0.0
        details = f"mean ground speed {mean:.1f} m/s, V is {task.limits.speed_m_s:g} m/s"
        minutes, seconds = divmod(round(took_s), 60)
        yield Fact(name="On the way", value=f"{minutes} min {seconds} s", details=details)


def _route(facts: FlightFacts) -> Fact:
    """How far it flew, against how far it was."""
    details = f"straight {metres(facts.straight_m)}"
    arrived = facts.end is not None and facts.end.outcome == "arrived"
    if not arrived:
        details += f"; {metres(facts.left_m)} from the last target at the end"
    elif facts.straight_m:
        details += f" ({_more(facts.flown_m, facts.straight_m)})"
    if arrived and facts.hindsight_m:
        details += (
            f"; cheapest route over all that was known at the end {metres(facts.hindsight_m)}"
        )
        details += f" ({_more(facts.flown_m, facts.hindsight_m)})"
    return Fact(name="Flown over ground", value=metres(facts.flown_m), details=details)


def _nearest(nearest: Nearest, safety_m: float) -> Fact:
    """Where it was nearest to terrain."""
    details = f"d_s is {metres(safety_m)}"
    if not nearest.is_bound:
        details += f"; at {nearest.time_s:,.0f} s, {_place(nearest.north_m, nearest.east_m)}"
        details += f" ({nearest.latitude_deg:.5f}, {nearest.longitude_deg:.5f})"
        details += f", {nearest.altitude_amsl_m:,.0f} m AMSL"
    return Fact(
        name="Nearest to known terrain",
        value=("more than " if nearest.is_bound else "") + metres(nearest.distance_m),
        details=details,
        is_bad=nearest.distance_m < safety_m,
    )


def _more(length_m: float, than_m: float) -> str:
    return f"flown {length_m / than_m - 1.0:+.1%}"


def _place(north_m: float, east_m: float) -> str:
    north = f"{metres(abs(north_m))} {'south' if north_m < 0.0 else 'north'}"
    return f"{north} and {metres(abs(east_m))} {'west' if east_m < 0.0 else 'east'} of the origin"


def _health(facts: FlightFacts) -> Iterator[Fact]:
    """Link, setpoints and GPS."""
    health = facts.health
    if health.heard:
        share = health.lost / (health.heard + health.lost)
        details = f"{health.lost:,} missing ({share:.2%})"
        yield Fact(name="Heard from the vehicle", value=f"{health.heard:,} frames", details=details)
        at_s = float(facts.log_s(np.array([health.silent_from_us]))[0])
        value = f"{health.silence_us * 1e-6:.2f} s, from {at_s:,.0f} s on"
        yield Fact(name="Its longest silence", value=value)
    lost, dropped = facts.count(noted.LinkLost), facts.count(noted.MessagesDropped)
    yield Fact(name="Link lost", value=f"{lost} times" if lost else "never")
    trips = [e.round_trip_s for _, _, e in facts.flight.entries if isinstance(e, noted.LinkDelay)]
    if trips:
        yield Fact(name="Slowest round trip", value=f"{max(trips) * 1e3:.0f} ms")
    if dropped:
        yield Fact(name="Messages that came too fast", value=f"dropped {dropped} times")
    if len(health.setpoints_us):
        value = f"{len(health.setpoints_us):,}"
        gap_s = facts.setpoint_gap_s
        details = "" if gap_s is None else f"longest gap while flying {gap_s:.2f} s"
        yield Fact(name="Setpoints sent", value=value, details=details)
    if len(health.gps_us):
        without_s, fixes = facts.without_fix_s, health.fix_types
        yield Fact(
            name="Without a fix in three dimensions",
            value=f"{without_s:,.0f} s" if without_s else "never",
            details="after the first fix",
        )
        seen = health.satellites[np.isfinite(health.satellites) & (np.cumsum(fixes >= 3) > 0)]
        if len(seen):
            yield Fact(name="Satellites after it", value=f"{seen.min():.0f} to {seen.max():.0f}")
    times, wall_s = facts.run.get("times_real_time"), facts.run.get("wall_s")
    if isinstance(times, float | int) and isinstance(wall_s, float | int):
        value = f"{times:,.1f} times real time"
        yield Fact(name="Flown at", value=value, details=f"in {wall_s:,.0f} s")


# --- subpaths


def _finite(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "–"


def _degrees(angle_rad: float) -> str:
    return _finite(round(math.degrees(angle_rad), 1) + 0.0, "{:.1f}°")


_PROOF: Final[dict[str, Callable[[Certificate], str]]] = {
    "terrain, m": lambda p: _finite(p.clearance_m, "{:,.1f}"),
    "keep-outs, m": lambda p: _finite(p.keep_out_m, "{:,.1f}"),
    "dead-man reach, m": lambda p: _finite(p.dead_man_m, "{:,.1f}"),
    "turn radius, m": lambda p: _finite(p.turn_radius_m, "{:,.0f}"),
    "climb, dive": lambda p: f"{_degrees(p.climb_angle_rad)}, {_degrees(p.dive_angle_rad)}",
    "altitude, m AMSL": lambda p: (
        f"{_finite(p.lowest_amsl_m, '{:,.0f}')} – {_finite(p.highest_amsl_m, '{:,.0f}')}"
    ),
    "in radars, m": lambda p: _finite(p.radar_m, "{:,.0f}"),
    "detection": lambda p: _finite(p.detection, "{:.0%}"),
    "proven": lambda p: f"no: {', '.join(p.broken)}" if p.broken else "yes",
}
"""What a certificate says, column by column."""


def _subpaths(facts: FlightFacts) -> list[SubpathRow]:
    weights = facts.flight.mission.task.settings.weights
    rows = []
    for each in facts.flight.planned:
        terms = []
        for name in _TERMS:
            part, cost = each.plan.terms.get(name), each.plan.cost or math.inf
            weighed = 0.0 if part is None else getattr(weights, name) * part
            terms.append((f"{weighed:.2f}", min(100.0 * weighed / cost, 100.0)))
        rows.append(
            SubpathRow(
                number="–" if each.leg is None else f"{each.leg}",
                begun="never" if each.begun_s is None else f"{each.begun_s:,.0f}",
                plan=each.plan,
                terms=tuple(terms),
                proof=tuple(text(each.plan.certificate) for text in _PROOF.values()),
            )
        )
    return rows


def _events(facts: FlightFacts) -> Iterator[tuple[str, str, str]]:
    """Vehicle time, what happened, and `BAD` or nothing; what is said twice in a row once."""
    before = ""
    for boot, t_s, entry in facts.flight.entries:
        if (said := entry_words(entry)) is not None and said[0] != before:
            before = said[0]
            yield f"{facts.time_s(boot, t_s):,.1f}", *said
