"""Two companions with the same ids on one port of a router that sends back what it is given."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flights import companion, journal_of, run, simulator
from programs import BIN, Program
from router import Router

pytestmark = [pytest.mark.closed_loop, pytest.mark.nightly]

PATIENCE_S = 120.0
WHY = "another companion with our ids is on the link"


def until(folder: Path, by: Program, **wanted: Any) -> None:
    """Wait for a journal entry with these values."""
    by.until(
        lambda: any(wanted.items() <= entry.items() for entry in journal_of(folder)),
        PATIENCE_S,
        what=f"come to {wanted}",
    )


def frames_of(datagram: bytes) -> Iterator[bytes]:
    """The frames in it: unsigned, of the second protocol."""
    while datagram:
        size = 12 + datagram[1]
        yield datagram[:size]
        datagram = datagram[size:]


def test_the_second_companion_ends_and_the_first_flies_on(tmp_path: Path) -> None:
    """And what the router sends back of the first one's own raises no alarm before."""
    mine, others = tmp_path / "first", tmp_path / "second"
    with Router(reflects=True) as router:
        port = f"udpout:127.0.0.1:{router.port}"
        first = companion("sitl-px4", mine, port, "--system", 1)
        simulator("sitl-px4", tmp_path / "truth", "--connect", port, "--speedup", 4)
        until(mine, first, kind="leg", number=1)
        alone = [frame for data in tuple(router.passed) for frame in frames_of(data)]
        assert "another companion" not in {entry.get("kind") for entry in journal_of(mine)}

        second = companion("sitl-px4", others, port, "--system", 1)
        assert second.wait(PATIENCE_S) == 1
        assert f"error: {WHY}. End one of the two" in second.transcript
        looks = run(BIN / "companion", "preflight", "sitl-px4", "--connect", port, "--system", 1)
        assert looks.wait(PATIENCE_S) == 1
        assert "another companion with our ids" in looks.transcript

        until(mine, first, kind="another companion")
        first.interrupt(PATIENCE_S)
    sent = [frame for frame in alone if frame[6] == 195]
    heard = (mine / "flight.tlog").read_bytes()
    back = [frame for frame in sent if heard.count(frame) == 2]  # as it was sent, and as it came
    assert len(back) > 0.9 * len(sent) > 100
    kinds = {entry.get("kind") for entry in journal_of(others)}
    assert not {"set mode", "arm", "take off", "setpoint refused"} & kinds
    flown = journal_of(mine)
    told = [entry.get("kind") for entry in flown]
    noticed, stopped = told.index("another companion"), told.index("stop asked")
    assert not [entry for entry in flown[noticed:stopped] if entry.get("phase") == "holding"]
    says = [entry for entry in flown[:stopped] if WHY in entry.get("text", "")]
    assert 1 <= len(says) <= 2  # the second, then preflight
