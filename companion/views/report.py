"""A flight explained on one page: self-contained HTML, made from what was recorded.

What the flight comes to is `report_facts`, how it reads is `report.html.j2`.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from itertools import groupby
from typing import Final

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from companion.geodesy import FloatArray
from companion.mission.journal import ScanAsked
from companion.profiles import Weights
from companion.telemetry.export.shapes import utc_text
from companion.telemetry.flight import PlannedSubpath
from companion.views import figure as views
from companion.views.figure import FlightFigure
from companion.views.page import STYLE, page, svg
from companion.views.report_facts import FlightFacts
from companion.views.words import entry_words
from companion.world.known_map import empty_map

_TERMS: Final = tuple(Weights.__dataclass_fields__)
_CHART_POINTS: Final = 3000
_LINE_POINTS: Final = 2000
_NO_FIX: Final = "#d55e00"


def report_html(facts: FlightFacts) -> str:
    """The page.  What could not be recorded is named in it."""
    return page(
        "report.html.j2",
        facts=facts,
        task=facts.flight.mission.task,
        began=_began(facts),
        figures={name: Markup(svg) for name, svg in svg_figures(facts).items()},
        term_names=_TERMS,
        weighed=lambda planned: _weighed(facts, planned),
        events=_events(facts),
    )


def _began(facts: FlightFacts) -> str:
    """When it was flown, as run.json says, or the log."""
    with suppress(TypeError, ValueError):
        began = datetime.fromisoformat(facts.run.get("began", ""))
        return f"{began.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
    times_us = facts.flight.track.time_us
    return utc_text(times_us[0]) if len(times_us) else "at a time that was not recorded"


def _weighed(facts: FlightFacts, planned: PlannedSubpath) -> list[tuple[float, float]]:
    """What each cost term of a subpath contributes to its cost, and its share, in percent."""
    weights, cost = facts.flight.mission.task.settings.weights, planned.plan.cost or math.inf
    parts = [getattr(weights, name) * (planned.plan.terms.get(name) or 0.0) for name in _TERMS]
    return [(part, min(100.0 * part / cost, 100.0)) for part in parts]


def _events(facts: FlightFacts) -> Iterator[tuple[float, str, bool]]:
    """Vehicle time, what happened, and whether it is bad; what is said twice in a row once."""
    said = ((entry.t_s, entry_words(entry)) for _, entry in facts.flight.entries)
    told = ((t_s, *words) for t_s, words in said if words is not None)
    return (next(alike) for _, alike in groupby(told, key=lambda each: each[1]))


# --- figures: SVG that stands in the page


def svg_figures(facts: FlightFacts) -> dict[str, str]:
    """The figures by name: flight and charts; without a track or a subpath, none."""
    shown = flight_figure(facts)
    if shown is None:
        return {}
    with rc_context(STYLE):
        return {
            "flight": svg("flight", views.compose(shown)),
            "charts": svg("charts", _charts(facts)),
        }


def flight_figure(facts: FlightFacts) -> FlightFigure | None:
    """What is drawn of a flight; None: neither a position nor a subpath was recorded."""
    flight, track = facts.flight, facts.flight.places_nea_m
    task = flight.mission.task
    lines = [line for line in (track, *facts.legs_nea_m) if len(line)]
    if not lines:
        return None
    scans = (each.centre_nea_m for _, each in flight.entries if isinstance(each, ScanAsked))
    points = sum(map(len, facts.legs_nea_m))
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    return FlightFigure.of(
        flight.mission,
        blank if facts.known is None else facts.known,
        title="",
        start_nea_m=tuple(lines[0][0].tolist()),
        targets_ne_m=flight.decided.targets_ne_m,
        legs_nea_m=tuple(_thinned(leg, points) for leg in facts.legs_nea_m),
        scans_nea_m=() if flight.mission.near else tuple(scans),  # a lidar's is there all the time
        zones=flight.zones_of(flight.decided),
        track_nea_m=_thinned(track, len(track)) if len(track) > 1 else None,
    )


def _thinned(line_nea_m: FloatArray, total: int) -> FloatArray:
    """Some of its points, and the last; total: of all lines that are drawn together."""
    chosen = np.arange(0, len(line_nea_m), max(total // _LINE_POINTS, 1))
    return line_nea_m[np.union1d(chosen, [len(line_nea_m) - 1])]


def _charts(facts: FlightFacts) -> Figure:
    """Over time: clearance, speed, satellites; holds are hatched."""
    canvas = Figure(figsize=(14.0, 7.0), layout="constrained")
    clearance, speed, satellites = canvas.subplots(3, 1, sharex=True)
    task, track = facts.flight.mission.task, facts.flight.track
    _line(clearance, facts.times_s[facts.way], facts.clearances_m, np.minimum)
    clearance.axhline(task.settings.safety_distance_m, color="black", lw=1.2, ls="--")
    clearance.set(ylabel="clearance of known\nterrain, m", ylim=(0.0, None))
    _line(speed, facts.times_s, np.hypot(track.north_m_s, track.east_m_s), np.maximum)
    speed.axhline(task.limits.speed_m_s, color="black", lw=1.2, ls="--")
    speed.set(ylabel="ground speed,\nm/s", ylim=(0.0, None))
    satellites.step(facts.gps_s, facts.satellites, where="post", color=views.PATH, lw=1.4)
    changes = np.flatnonzero(np.diff(~facts.has_fix, prepend=False, append=False))
    for first, end in changes.reshape(-1, 2).tolist():
        until_s = facts.gps_s[min(end, len(facts.gps_s) - 1)]
        satellites.axvspan(facts.gps_s[first], until_s, fc=_NO_FIX, alpha=0.45, lw=0.0)
    satellites.set(ylabel="satellites", ylim=(0.0, None), xlabel="vehicle time, s")
    for axes in (clearance, speed, satellites):
        for hold in facts.holds if len(track) else ():
            begin_s = facts.times_s[0] + hold.time_s
            end_s = facts.times_s[-1] if hold.until_s is None else begin_s + hold.until_s - hold.t_s
            axes.axvspan(begin_s, end_s, fc="none", ec="#888888", hatch="////", lw=0.0)
        axes.grid(color="#888888", alpha=0.3, lw=0.6)
        axes.margins(x=0.0)
    canvas.align_ylabels()
    return canvas


def _line(axes: Axes, times_s: FloatArray, values: FloatArray, worst: np.ufunc) -> None:
    """A line of not too many points, which keeps the worst of those that it stands for."""
    if len(times_s):
        firsts = np.arange(0, len(times_s), -(-len(times_s) // _CHART_POINTS))
        axes.plot(times_s[firsts], worst.reduceat(values, firsts), color=views.PATH, lw=1.4)
