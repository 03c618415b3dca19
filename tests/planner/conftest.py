"""Every plan is asked for a micrometre aside."""

from collections.abc import Iterator

import planning
import pytest
from nudge import nudged_questions


@pytest.fixture(autouse=True)
def _aside(request: pytest.FixtureRequest, nudge: int) -> Iterator[None]:
    """What is planned, and whether anything is, hangs on no last digit."""
    with nudged_questions(request.module, nudge), nudged_questions(planning, nudge):
        yield
