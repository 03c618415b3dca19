"""A companion that is killed in flight, and whose memory cannot be read by the one that follows."""

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tlog
from flights import kept, launch, run, short_mission

pytestmark = [pytest.mark.closed_loop, pytest.mark.nightly]  # without a wire: `test_memory`


def truncate(folder: Path) -> None:
    file = folder / "resume.json"
    file.write_bytes(file.read_bytes()[:300])


def another_version(folder: Path) -> None:
    file = folder / "resume.json"
    file.write_text(json.dumps({**json.loads(file.read_bytes()), "version": 99}), encoding="utf-8")
    (folder / "known.npz").write_bytes(b"")


def is_in_a_leg(now: dict[str, Any] | None) -> bool:
    in_leg = now is not None and now["phase"] == "FLYING" and now["leg"] is not None
    return in_leg and now["legs_flown"] >= 1


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("sitl-arducopter", truncate),
        ("sitl-px4", another_version),
    ],
)
def test_it_takes_over_says_so_never_arms_and_arrives(
    tmp_path: Path, name: str, damage: Callable[[Path], None]
) -> None:
    mission = short_mission(name, tmp_path)
    flight = launch(tmp_path / "run", name, mission, "--resume", "--system", "1")
    folder, first = flight.folder, flight.companion
    first.until(lambda: is_in_a_leg(kept(folder)))
    first.kill()
    log, journal = folder / "flight.tlog", folder / "journal.jsonl"
    recorded = (log.read_bytes(), journal.read_bytes())
    damage(folder)
    torn, known = (folder / "resume.json").read_bytes(), (folder / "known.npz").read_bytes()

    flight.companion = run(*map(str, first.process.args))  # type: ignore[union-attr]
    flight.wait()
    flight.ended_well()
    said = flight.companion.transcript
    assert said.count("warning: taking over without memory of the flight: resume.json") == 1
    assert (folder / "resume.lost-1.json").read_bytes() == torn
    assert (folder / "known.lost-1.npz").read_bytes() == known
    for file, before in zip((log, journal), recorded, strict=True):
        whole = before[: before.rindex(b"\n") + 1] if file is journal else before[:-288]
        assert file.read_bytes().startswith(whole), f"{file.name} was written over"

    heads = [k for k, entry in enumerate(flight.journal) if "schema" in entry]
    later = flight.journal[heads[1] :]
    assert later[0]["resumed"] == 1
    assert not [entry for entry in later if entry.get("kind") in ("arm", "take off")]
    [warning] = [text for text in flight.says if "without memory" in text]
    frames = tlog.messages(folder)
    texts = "".join(each.text for each in frames if each.get_type() == "STATUSTEXT")
    assert warning in texts
    armed = [row["armed"] for row in flight.truth]
    assert [after for before, after in itertools.pairwise(armed) if before != after][:1] == [True]
