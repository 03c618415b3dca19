"""The comparison as pictures, laid out as the paper's figures are."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.campaign.families import unseen
from companion.paper.compare.comparisons import Comparison
from companion.paper.compare.missions import Outcome
from companion.views import figure as views
from companion.views.figure import FlightFigure
from companion.world.simulated import true_map

_WIDE = 160  # characters in a line of the text under the panels


def draw(comparison: Comparison, outcomes: Sequence[Outcome], path: Path) -> None:
    """Write Fig. 3 or Fig. 4: two panels seen at an angle, under each its profile or plan."""
    canvas = Figure(figsize=(15.0, 12.2))
    FigureCanvasAgg(canvas)
    (title,) = comparison.tables
    canvas.text(0.03, 0.967, title, fontsize=18, weight="bold", parse_math=False)
    remarks = comparison.remarks(outcomes)
    lines = "\n".join(line for remark in remarks for line in textwrap.wrap(remark, _WIDE))
    style: dict[str, Any] = {"fontsize": 11.5, "va": "bottom", "parse_math": False}
    canvas.text(0.03, 0.012, lines, color="#333333", **style)
    lower, places = [], (("a", "c", 0.02), ("b", "d", 0.51))
    for outcome, (letter, below_letter, left) in zip(outcomes, places, strict=True):
        flight, way = _flight(outcome), outcome.case.papers_way
        box = (left, 0.525, 0.47, 0.42)
        views.draw_oblique(canvas.add_axes(box, projection="3d", label="oblique"), flight)
        heading = f"({letter}) {outcome.case.label}: {way} ({outcome.share(way)} runs)"
        canvas.text(left + 0.02, 0.93, heading, fontsize=14, weight="bold", parse_math=False)
        if flight.task.radars:
            below = canvas.add_axes((left + 0.075, 0.165, 0.30, 0.33), label="below")
            views.draw_plan(below, flight)
            below.set_title(f"({letter}) from above")
        else:
            below = canvas.add_axes((left + 0.045, 0.175, 0.41, 0.27), label="below")
            views.draw_profile(below, flight)
            below.set_title(f"({below_letter}) Vertical profile of ({letter})")
        lower.append(below)
    views.add_legend(canvas, lower, columns=8, bottom=0.085)
    views.save(canvas, path)


def _flight(outcome: Outcome) -> FlightFigure:
    world, run = outcome.case.world, outcome.shown
    return FlightFigure(
        task=world.task,
        known=true_map(world.terrain, unseen(world)),
        start_nea_m=world.start_nea_m,
        targets_ne_m=world.targets_ne_m[-1:],
        legs_nea_m=(run.route_nea_m,),
        scans_nea_m=run.scans_nea_m,
    )
