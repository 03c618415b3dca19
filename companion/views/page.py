"""Pages that open without a network and print: what reports of flights and campaigns share.

The page loads nothing and runs nothing; templates escape all that they are given.  Figures are SVG
that stands in it, in light, dark and print: what is drawn in the colours below takes its colour
from the page (`var(--...)`).
"""

import io
import math
import re
from collections.abc import Callable
from typing import Any, Final

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.views.figure import DPI, PATH
from companion.views.words import metres, metres_at_least, rounded_down

_INK: Final = "#010203"
THEME: Final = {_INK: "currentColor"}
THEME_OF_CHARTS: Final = THEME | {
    "#000000": "currentColor",
    "#222222": "currentColor",
    "#ffffff": "var(--page)",
    PATH: "var(--path)",
}
_INKED: Final = (
    *("text.color", "axes.labelcolor", "axes.edgecolor", "axes.titlecolor"),
    *("xtick.color", "ytick.color"),
)
STYLE: Final[Any] = {
    "svg.fonttype": "none",  # text stays text: it can be searched, and is small
    "svg.hashsalt": "companion",
    "savefig.transparent": False,
    "font.size": 10.0,
    **dict.fromkeys(_INKED, _INK),
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


def svg(
    name: str, size_in: tuple[float, float], draw: Callable[[Figure], None], theme: dict[str, str]
) -> str:
    """A figure as an element of a page: no prologue, ids of its own, colours of the page."""
    canvas, file = Figure(figsize=size_in), io.StringIO()
    FigureCanvasAgg(canvas)
    canvas.patch.set_alpha(0.0)
    draw(canvas)
    canvas.savefig(file, format="svg", dpi=DPI, metadata=_NO_METADATA)
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", text)
    return re.sub("|".join(theme), lambda found: theme[found[0]], text)
