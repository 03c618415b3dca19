"""Texts and tables of files: what was written reads back, and a plan is one under any name."""

import contextlib
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from documents import DOCUMENTS, refusal, written
from hypothesis import given
from hypothesis import strategies as st

from companion.config import load_mission, load_world, read_mission
from companion.errors import InputError
from companion.sources.files import json_table, plain, read_text, toml_text, with_settings, writing

FENCED = (Path(__file__).parent / "missions" / "fenced.plan").read_bytes()
LIST = "\n".join(DOCUMENTS["list"][1]).encode()
VALUES = st.recursive(
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), VALUES, max_size=5))
def test_a_table_that_was_written_reads_back_as_it_was(table: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(table)) == table
    half_a_surrogate = toml_text({"name": "a\ud800b\x7f"})
    assert tomllib.loads(half_a_surrogate) == {"name": "a?b\x7f"}


def test_a_setting_is_one_key_whose_value_it_replaces_whatever_that_was() -> None:
    """A table too: with one key of it left, terrain would be a file and a statement at once."""
    table = {"terrain": {"file": "x.tif"}, "planner": {"profile": "flight", "overlap_m": 1.0}}
    settings = ["terrain = {highest_amsl_m = 1.0}", "planner.profile=paper", "end.action='hold'"]
    assert with_settings(table, settings) == {
        "terrain": {"highest_amsl_m": 1.0},
        "planner": {"profile": "paper", "overlap_m": 1.0},
        "end": {"action": "hold"},
    }
    assert table["planner"]["profile"] == "flight"
    for none in ("planner.profile", "=1", "planner.=1"):
        assert "it is not a key, an = and a value" in refusal(with_settings, {}, [none])


def test_what_can_be_read_is_a_file_that_is_there_and_ends(tmp_path: Path) -> None:
    path, huge = tmp_path / "x.json", tmp_path / "huge.json"
    path.write_bytes(b"\xef\xbb\xbf{}")  # a mark of the byte order is no part of the text
    assert json_table(path, "plan", "") == {}
    with huge.open("wb") as file:
        file.truncate(64_000_001)
    for bad, rule in ((tmp_path, "a folder"), (path / "x", "no such file"), (huge, "than 64 MB")):
        assert rule in refusal(read_text, bad, "field", "Remedy.")


def test_what_a_full_disk_took_a_part_of_is_removed_and_a_device_is_not(tmp_path: Path) -> None:
    torn, full = tmp_path / "report.html", Path("/dev/full")
    torn.write_text("half", encoding="utf-8")
    for path in (torn, full):
        with pytest.raises(InputError, match="No space left on device"), writing("--out", path):
            full.write_text("the other half", encoding="utf-8")
    assert not torn.exists()
    assert full.is_char_device()


@given(st.none() | st.integers() | st.text())
def test_a_plain_name_is_one_printable_line_that_is_not_long(name: object) -> None:
    shown = plain(name, "nameless")
    assert 0 < len(shown) <= 60
    assert shown.isprintable()
    assert shown == shown.strip()


@pytest.mark.parametrize(
    "name", [b"flight.plan.txt", b"Flight.PLAN", b"pl\xe4n", "über 7".encode()]
)
def test_a_plan_is_a_plan_under_any_name(tmp_path: Path, name: bytes) -> None:
    """Also under one that is no UTF-8; so is a list of waypoints, or an error that names it."""
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(FENCED)
    mission = load_mission(str(path))
    assert len(mission.targets_ne_m) == 3
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]*", mission.name)  # as a folder can be called
    toml = tmp_path / "mission.toml"
    with contextlib.suppress(UnicodeEncodeError):
        toml.write_text(f'plan = "{path.name}"\n', encoding="utf-8")
        assert load_mission(str(toml)).targets_ne_m == mission.targets_ne_m
    read_mission(str(path)).text.encode()
    path.write_bytes(LIST)
    assert len(load_mission(str(path)).targets_ne_m) == 1
    path.write_bytes(b"<kml>")
    assert refusal(load_mission, str(path)).isprintable()


def test_an_elevation_file_in_a_folder_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"h\xf6he")
    folder.mkdir()
    (folder / "dem.tif").write_bytes(b"")
    (folder / "terrain.tif").write_bytes(b"")
    path = written(folder, "mission that knows the ground")
    assert re.search(r"terrain\.file = .*must be a valid string", refusal(load_mission, str(path)))
    path = written(folder, "world of a file")
    assert re.search(r"terrain\.file = .*must be a valid string", refusal(load_world, str(path)))
