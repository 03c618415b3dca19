"""The comparison as pictures, laid out as the paper's figures are."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.campaign.families import unseen
from companion.paper.compare.comparisons import Comparison, by_heading
from companion.paper.compare.missions import Outcome
from companion.views import figure as views
from companion.views.figure import FlightFigure
from companion.world.simulated import true_map

_OURS, _PAPERS = "#0050b5", "#8a6d3b"
_WIDELY = 3.0  # spread of costs from which on their scale is logarithmic
_WIDE = 160  # characters in a line of the text under the panels


def draw(comparison: Comparison, found: Sequence[Outcome], path: Path) -> None:
    """Write the picture of a comparison."""
    compose = compose_effect if found[0].case.papers_way else compose_table
    views.save(compose(comparison, found), path)


def compose_effect(comparison: Comparison, found: Sequence[Outcome]) -> Figure:
    """Fig. 3 or Fig. 4: two panels seen at an angle, under each its profile or plan."""
    (title,) = comparison.tables
    canvas = _canvas((15.0, 12.2), title, 0.967, comparison.remarks(found))
    lower, places = [], (("a", "c", 0.02), ("b", "d", 0.51))
    for outcome, (letter, below_letter, left) in zip(found, places, strict=True):
        flight, ways = _flight(outcome), outcome.ways
        box = (left, 0.525, 0.47, 0.42)
        views.draw_oblique(canvas.add_axes(box, projection="3d", label="oblique"), flight)
        way = max(sorted(set(ways)), key=ways.count)
        most = f"{way} ({ways.count(way)} of {len(ways)} runs)"
        heading = f"({letter}) {outcome.case.label}: {most}"
        canvas.text(left + 0.02, 0.93, heading, fontsize=14, weight="bold", parse_math=False)
        if flight.radars:
            below = canvas.add_axes((left + 0.075, 0.165, 0.30, 0.33), label="below")
            views.draw_plan(below, flight)
            below.set_title(f"({letter}) from above")
        else:
            below = canvas.add_axes((left + 0.045, 0.175, 0.41, 0.27), label="below")
            views.draw_profile(below, flight)
            below.set_title(f"({below_letter}) Vertical profile of ({letter})")
        lower.append(below)
    views.add_legend(canvas, lower, columns=8, bottom=0.085)
    return canvas


def compose_table(comparison: Comparison, found: Sequence[Outcome]) -> Figure:
    """Table 1: the cost of every run, mean and standard deviation, beside the paper's."""
    title = "Table 1: cost from start to target"
    canvas = _canvas((14.0, 11.5), title, 0.955, comparison.remarks(found))
    for at, row in enumerate(by_heading(found)):
        left, bottom = 0.07 + 0.49 * (at % 2), 0.61 - 0.365 * (at // 2)
        _draw_row(canvas.add_axes((left, bottom, 0.37, 0.29), label="row"), row)
    handles, labels = canvas.axes[0].get_legend_handles_labels()
    canvas.legend(handles, labels, loc="upper right", ncols=3, frameon=False, fontsize=11)
    return canvas


def _draw_row(axes: Axes, row: Sequence[Outcome]) -> None:
    """The costs of a row of the table, and on a scale to the right the paper's."""
    other = axes.twinx()
    bars: dict[str, Any] = {"fmt": "_", "ms": 16, "capsize": 5, "lw": 1.6}
    dots: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3, "alpha": 0.45, "color": _OURS}
    for at, outcome in enumerate(row):
        unnamed = "_" * at  # the first alone is named in the legend
        costs, mean, deviation = outcome.costs, outcome.mean(), outcome.deviation
        spread = np.linspace(-0.08, 0.08, len(costs))
        axes.plot(at - 0.2 + spread, costs, label=f"{unnamed}one run", **dots)
        below = min(deviation, mean - min(costs, default=mean))  # none lies below that
        ends = np.nan_to_num([[below], [deviation]])
        name = f"{unnamed}mean ± standard deviation, here (left scale)"
        axes.errorbar(at, mean, ends, color=_OURS, label=name, **bars)
        papers_mean, papers_deviation = outcome.case.papers_cost
        other.errorbar(at + 0.2, papers_mean, papers_deviation, color=_PAPERS, **bars)
        name = f"{unnamed}the paper's (right scale)"  # in the legend of the left scale
        axes.errorbar([], [], [], color=_PAPERS, label=name, **bars)
    axes.set_xticks(range(len(row)), [each.case.label for each in row])
    axes.set_title(row[0].case.heading.replace(", ", ", T = "))
    every = [cost for outcome in row for cost in outcome.costs]
    scale = "log" if max(every, default=1.0) > _WIDELY * min(every, default=1.0) else "linear"
    axes.set_yscale(scale)
    axes.set_ylabel(f"cost, here{' (logarithmic)' if scale == 'log' else ''}", color=_OURS)
    other.set_ylabel("cost, in the paper", color=_PAPERS)
    axes.tick_params(axis="y", which="both", colors=_OURS)
    other.tick_params(axis="y", colors=_PAPERS)


def _canvas(
    size_in: tuple[float, float], title: str, title_at: float, remarks: Sequence[str]
) -> Figure:
    """An empty picture with its title, and below the remarks."""
    canvas = Figure(figsize=size_in)
    FigureCanvasAgg(canvas)
    canvas.text(0.03, title_at, title, fontsize=18, weight="bold", parse_math=False)
    lines = "\n".join(line for each in remarks for line in textwrap.wrap(each, _WIDE))
    style: dict[str, Any] = {"fontsize": 11.5, "va": "bottom", "parse_math": False}
    canvas.text(0.03, 0.012, lines, color="#333333", **style)
    return canvas


def _flight(outcome: Outcome) -> FlightFigure:
    world, run, limits = outcome.case.world, outcome.shown, outcome.case.world.task.limits
    return FlightFigure(
        title="",
        known=true_map(world.terrain, unseen(world)),
        floor_amsl_m=limits.floor_amsl_m,
        ceiling_amsl_m=limits.ceiling_amsl_m,
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m[-1:],
        legs_nea_m=(run.route_nea_m,),
        scans_nea_m=run.scans_nea_m,
        radars=world.task.radars,
    )
