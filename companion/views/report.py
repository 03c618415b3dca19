"""A flight explained on one page: self-contained HTML, made from what was recorded.

What the flight comes to is `report_facts`, how it reads is `report.html.j2`.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from typing import Final

from markupsafe import Markup

from companion.profiles import Weights
from companion.telemetry.export.shapes import utc_text
from companion.telemetry.flight import PlannedSubpath
from companion.views.page import page
from companion.views.report_facts import FlightFacts
from companion.views.report_figures import svg_figures
from companion.views.words import entry_words

_TERMS: Final = tuple(Weights.__dataclass_fields__)


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
    before = ""
    for _, t_s, entry in facts.flight.entries:
        if (said := entry_words(entry)) is not None and said[0] != before:
            before = said[0]
            yield t_s, *said
