"""Pages that open without a network and print: what reports of flights and campaigns share.

The page loads nothing and runs nothing; templates escape all that they are given.  Figures are SVG
that stands in it, on white as on paper.
"""

import io
import math
import re
from typing import Any, Final

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from companion.views.figure import DPI
from companion.views.words import metres, metres_at_least, rounded_down

STYLE: Final[Any] = {
    "svg.fonttype": "none",  # text stays text: it can be searched, and is small
    "svg.hashsalt": "companion",
    "font.size": 12.0,
}
_NO_METADATA: Final = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def page(template: str, package: str = "views", **values: object) -> str:
    """A page from a template of a package, which extends `page.html.j2`."""
    pages = Environment(
        loader=ChoiceLoader([PackageLoader("companion", p) for p in (package, "views")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pages.filters |= {"metres": metres, "metres_at_least": metres_at_least, "number": number}
    pages.filters |= {"at_least": at_least, "at_most": at_most, "degrees": _degrees}
    return pages.get_template(template).render(**values)


def number(value: float | None, digits: int = 0) -> str:
    """A number, or a dash if it is not known or unbounded."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{round(value, digits) + 0.0:,.{digits}f}"


def at_least(value: float | None, digits: int = 0) -> str:
    """Likewise, rounded down: a clearance must not look larger than it is."""
    return number(None if value is None else rounded_down(value, digits), digits)


def at_most(value: float, digits: int = 0) -> str:
    """Likewise, rounded up: a risk must not look smaller than it is."""
    return number(-rounded_down(-value, digits), digits)


def _degrees(angle_rad: float) -> str:
    return f"{number(math.degrees(angle_rad), 1)}°"


def svg(name: str, canvas: Figure) -> str:
    """A figure as an element of a page: no prologue, ids of its own, nothing about its edges."""
    file = io.StringIO()
    canvas.savefig(file, format="svg", dpi=DPI, metadata=_NO_METADATA, bbox_inches="tight")
    text = file.getvalue()
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", text[text.index("<svg") :])
