"""What the mission decides hangs on no last digit: every test is flown a micrometre aside."""

import pytest


@pytest.fixture(autouse=True)
def _aside(nudged: None) -> None:
    """Every position is nudged."""
