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

from companion.views import words
from companion.views.figure import DPI

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
    pages.filters |= {"number": words.number, "counted": words.counted, "degrees": math.degrees}
    pages.filters |= {"at_least": words.at_least, "at_most": words.at_most}
    pages.filters |= {"metres": words.metres, "metres_at_least": words.metres_at_least}
    pages.filters["clock_text"] = words.clock_text
    return pages.get_template(template).render(**values)


def svg(name: str, canvas: Figure) -> str:
    """A figure as an element of a page: no prologue, ids of its own, nothing about its edges."""
    file = io.StringIO()
    canvas.savefig(file, format="svg", dpi=DPI, metadata=_NO_METADATA, bbox_inches="tight")
    text = file.getvalue()
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", text[text.index("<svg") :])
