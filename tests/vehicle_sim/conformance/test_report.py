"""What the table and the file say, for rows that are made up."""

import math
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from conformance.flights import Reason, flight_of
from conformance.log import Recording
from conformance.rows import Row

Recorded = Callable[[str], Recording]


def row(kind: str, difference: float, reason: str | None = None, *, name: str = "x") -> Row:
    return Row(
        kind=kind,
        name=name,
        at_s=50.0,
        real="1",
        simulated="2",
        tolerance="1 s",
        difference=difference,
        reason=reason,
    )


ROWS = [
    row("mode", 0.0),
    row("mode", 0.7, name="y"),
    row("echo", math.inf, "because", name="known"),
    row("echo", 2.0, name="unknown"),
]


@pytest.mark.parametrize(
    ("kind", "names", "shown", "most", "explains"),
    [
        ("echo", "known", ".*", math.inf, True),
        ("mode", "known", ".*", math.inf, False),
        ("echo", "know", ".*", math.inf, False),
        ("echo", "known", "3", math.inf, False),
        ("echo", "known", ".*", 9.0, False),
    ],
)
def test_a_reason_must_match_as_a_whole(
    kind: str, names: str, shown: str, most: float, explains: bool
) -> None:
    reason = Reason(recordings="*", kind=kind, names=names, shown=shown, most=most, why="")
    assert ROWS[2].is_explained_by(reason) is explains


@pytest.mark.sample(3)
def test_reasons_are_narrow_say_something_and_belong_to_their_recordings(
    recorded: Recorded, name: str
) -> None:
    reasons = flight_of(recorded(name)).reasons
    assert reasons
    for reason in reasons:
        assert len(reason.why) > 20
        assert not (reason.names == ".*" and reason.shown == ".*")
        assert reason.recordings in (name, "*.tlog")


def test_a_file_that_is_none_ends_with_a_line_and_not_a_traceback(tmp_path: Path) -> None:
    command = [Path(__file__).parents[3] / "scripts/conformance", tmp_path / "none.tlog"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("error: LOG = ")
    assert done.stderr.count("\n") == 1
