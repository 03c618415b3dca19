"""The comparison as pictures, laid out as the paper's figures are."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.paper.compare.missions import Comparison, Outcome, by_heading
from companion.views import figure as views
from companion.views.figure import FlightFigure, TerrainPicture
from companion.world.known_map import empty_map
from companion.world.simulated_scan import true_map

_OURS, _PAPERS = "#0050b5", "#8a6d3b"
_WIDELY = 3.0  # spread of costs from which on their scale is logarithmic
_WIDE = 160  # characters in a line of the text under the panels


def draw(comparison: Comparison, found: Sequence[Outcome], path: Path) -> None:
    """Write the picture of a comparison."""
    compose = compose_effect if found[0].case.papers_way else compose_table
    views.save(compose(comparison, found), path)


def compose_effect(comparison: Comparison, found: Sequence[Outcome]) -> Figure:
    """Fig. 3 or Fig. 4: two panels seen at an angle, under each its profile or plan."""
    canvas = Figure(figsize=(15.0, 12.2))
    FigureCanvasAgg(canvas)
    (title,) = comparison.tables
    canvas.text(0.03, 0.967, title, fontsize=18, weight="bold", parse_math=False)
    profiles = not any(outcome.case.task.radars for outcome in found)
    for at, (outcome, letters) in enumerate(zip(found, ("ac", "bd"), strict=True)):
        flight, left = _flight(outcome), 0.02 + 0.49 * at
        box = (left, 0.525, 0.47, 0.42)
        views.draw_oblique(canvas.add_axes(box, projection="3d", label="oblique"), flight)
        heading = f"({letters[0]}) {outcome.case.label}: {_most(comparison.more(outcome)['ways'])}"
        canvas.text(left + 0.02, 0.93, heading, fontsize=14, weight="bold", parse_math=False)
        below = canvas.add_axes(
            (left + 0.045, 0.175, 0.41, 0.27) if profiles else (left + 0.075, 0.165, 0.30, 0.33),
            label="below",
        )
        if profiles:
            views.draw_profile(below, flight)
            below.set_title(f"({letters[1]}) Vertical profile of ({letters[0]})")
        else:
            views.draw_plan(below, flight)
            below.set_title(f"({letters[0]}) from above")
    lower = [axes for axes in canvas.axes if axes.get_label() == "below"]
    views.add_legend(canvas, lower, columns=8, bottom=0.085)
    _write_below(canvas, comparison.remarks(found))
    return canvas


def compose_table(comparison: Comparison, found: Sequence[Outcome]) -> Figure:
    """Table 1: the cost of every run, mean and standard deviation, beside the paper's."""
    canvas = Figure(figsize=(14.0, 11.5))
    FigureCanvasAgg(canvas)
    title = "Table 1: cost from start to target"
    canvas.text(0.03, 0.955, title, fontsize=18, weight="bold", parse_math=False)
    for at, row in enumerate(by_heading(found)):
        left, bottom = 0.07 + 0.49 * (at % 2), 0.61 - 0.365 * (at // 2)
        axes = canvas.add_axes((left, bottom, 0.37, 0.29), label="row")
        _draw_row(axes, row)
    handles, labels = canvas.axes[0].get_legend_handles_labels()
    canvas.legend(handles, labels, loc="upper right", ncols=3, frameon=False, fontsize=11)
    _write_below(canvas, comparison.remarks(found))
    return canvas


def _draw_row(axes: Axes, row: Sequence[Outcome]) -> None:
    other = axes.twinx()
    for at, outcome in enumerate(row):
        label: dict[str, Any] = {} if at else {"label": "one run"}
        spread = np.linspace(-0.08, 0.08, len(outcome.costs))
        dots: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3, "alpha": 0.45, "color": _OURS}
        axes.plot(at - 0.2 + spread, outcome.costs, **dots, **label)
        bars: dict[str, Any] = {"fmt": "_", "ms": 16, "capsize": 5, "lw": 1.6}
        label = {} if at else {"label": "mean ± standard deviation, here (left scale)"}
        mean, deviation = outcome.mean(), outcome.deviation
        below = min(deviation, mean - min(outcome.costs, default=mean))  # none lies below that
        ends = np.nan_to_num([[below], [deviation]])
        axes.errorbar(at, mean, ends, color=_OURS, **bars, **label)
        label = {} if at else {"label": "the paper's (right scale)"}
        other.errorbar(at + 0.2, *outcome.case.papers_cost, color=_PAPERS, **bars)
        axes.errorbar([], [], [], color=_PAPERS, **bars, **label)
    axes.set_xticks(range(len(row)), [each.case.label for each in row])
    axes.set_title(row[0].case.heading.replace(", ", ", T = "))
    costs = [cost for outcome in row for cost in outcome.costs]
    scale = "log" if max(costs, default=1.0) > _WIDELY * min(costs, default=1.0) else "linear"
    axes.set_yscale(scale)
    axes.set_ylabel(f"cost, here{' (logarithmic)' if scale == 'log' else ''}", color=_OURS)
    other.set_ylabel("cost, in the paper", color=_PAPERS)
    axes.tick_params(axis="y", which="both", colors=_OURS)
    other.tick_params(axis="y", colors=_PAPERS)


def _most(ways: list[str]) -> str:
    """What most runs do, and how many."""
    way = max(sorted(set(ways)), key=ways.count)
    return f"{way} ({ways.count(way)} of {len(ways)} runs)"


def _write_below(canvas: Figure, paragraphs: Sequence[str]) -> None:
    lines = [line for each in paragraphs for line in textwrap.wrap(each, _WIDE)]
    style: dict[str, Any] = {"fontsize": 11.5, "va": "bottom", "parse_math": False}
    canvas.text(0.03, 0.012, "\n".join(lines), color="#333333", **style)


def _flight(outcome: Outcome) -> FlightFigure:
    case, run, limits = outcome.case, outcome.shown, outcome.case.task.limits
    blank = empty_map(case.task.cell_m, limits.north_m, limits.east_m)
    return FlightFigure(
        title="",
        terrain=TerrainPicture.of(true_map(case.terrain, blank)),
        floor_amsl_m=limits.floor_amsl_m,
        ceiling_amsl_m=limits.ceiling_amsl_m,
        start_nea_m=case.start_nea_m,
        targets_ne_m=(case.target_ne_m,),
        legs_nea_m=(run.route_nea_m,),
        scans_nea_m=run.scans_nea_m,
        radars=case.task.radars,
    )
