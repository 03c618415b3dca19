"""Files that people may give, and what is said of those that cannot be taken."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st

from companion.errors import InputError

NUMBERS = [True, 0, -1, 1e308, 1e-300, 2**62, 10**400, 91.0, 16, 20, 177]
OTHERS = [None, "", "x\ny", "radar", "x.plan", [], {}, [[]], [{}], [8.0, 47.0], {"type": 1}]
JUNK = st.sampled_from([*NUMBERS, *OTHERS])


def feature(shape: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    """A feature of GeoJSON."""
    geometry = {"type": shape, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def collection(*features: Any, **more: Any) -> dict[str, Any]:
    """They, as a file has them."""
    return {"type": "FeatureCollection", "features": list(features), **more}


def refusal(read: Callable[[Path, Any], object], path: Path, content: Any) -> str:
    """The one line that is said of a file with that content."""
    with pytest.raises(InputError) as caught:
        read(path, content)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


def replace_somewhere(content: Any, data: st.DataObject) -> None:
    """Put something else into a place of a JSON or TOML value, at any depth."""
    here = content
    while keys := list(here) if isinstance(here, dict) else list(range(len(here))):
        key = data.draw(st.sampled_from(keys))
        if not isinstance(here[key], dict | list) or data.draw(st.integers(0, 4)) == 0:
            here[key] = copy.deepcopy(data.draw(JUNK))
            return
        here = here[key]
