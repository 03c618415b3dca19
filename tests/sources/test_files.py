"""Files by what is in them: texts, tables, plans under any name; anything else is one line."""

import contextlib
import gzip
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from spoiled import refusal

import companion
from companion.config import load_mission, load_world, mission_text
from companion.errors import InputError
from companion.sources.files import (
    json_table,
    plain,
    read_text,
    toml_table,
    toml_text,
    with_settings,
    writing,
)

FENCED = (Path(__file__).parent / "missions" / "fenced.plan").read_bytes()
LIST = b"QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 100 1\n1 0 3 16 0 0 0 0 47 8.002 240 1\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("files")


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
        assert "it is not a key, an = and a value" in refusal(
            lambda _, text: with_settings({}, [text]), Path(), none
        )


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 5000, "a = " + "9" * 10_000, "a.b = 1\na = 2", "\x00", "a = 2020-99-99"],
    ids=["deep", "long", "twice", "nul", "date"],
)
def test_what_is_no_toml_is_one_error_in_one_line(text: str) -> None:
    told = refusal(lambda _, text: toml_table(text, "x.toml"), Path(), text)
    assert told.startswith("file = 'x.toml': not TOML")


@pytest.mark.parametrize(
    ("data", "rule"),
    [
        (b"", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b'{"a": ' + b"9" * 10_000 + b"}", "not JSON"),
        (b'{"a": -Infinity}', "-Infinity is no number"),
        (b"[1, 2]", "no JSON object"),
        (b"\xff\xfe{}", "cannot be read"),
    ],
)
def test_what_is_no_json_object_is_one_error(tmp_path: Path, data: bytes, rule: str) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(data)
    told = refusal(lambda path, _: json_table(path, "plan", "Mend it."), path, None)
    assert re.fullmatch(rf"plan = .*{rule}.*Mend it\.", told)


def test_what_can_be_read_is_a_file_that_is_there_and_ends(tmp_path: Path) -> None:
    path, huge = tmp_path / "x.json", tmp_path / "huge.json"
    path.write_bytes(b"\xef\xbb\xbf{}")  # a mark of the byte order is no part of the text
    assert json_table(path, "plan", "") == {}
    with huge.open("wb") as file:
        file.truncate(64_000_001)
    for bad, rule in ((tmp_path, "a folder"), (path / "x", "no such file"), (huge, "than 64 MB")):
        with pytest.raises(InputError, match=rule):
            read_text(bad, "field", "Remedy.")


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


@pytest.mark.parametrize("name", [b"flight.plan.txt", b"flight.json", b"Flight.PLAN", b"pl\xe4n"])
def test_a_plan_is_a_plan_under_any_name(tmp_path: Path, name: bytes) -> None:
    """Also under one that is no UTF-8; so is a list of waypoints, or an error that names it."""
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(FENCED)
    mission = load_mission(str(path))
    assert len(mission.targets_ne_m) == 3
    toml = tmp_path / "mission.toml"
    with contextlib.suppress(UnicodeEncodeError):
        toml.write_text(f'plan = "{path.name}"\n', encoding="utf-8")
        assert load_mission(str(toml)).targets_ne_m == mission.targets_ne_m
    mission_text(str(path)).encode()
    path.write_bytes(LIST)
    assert len(load_mission(str(path)).targets_ne_m) == 1
    path.write_bytes(b"<kml>")
    assert refusal(lambda path, _: load_mission(str(path)), path, None).isascii()


def test_a_mission_is_called_as_its_plan_as_far_as_a_folder_can_be(tmp_path: Path) -> None:
    (tmp_path / "über Wald_7.plan").write_bytes(FENCED)
    assert load_mission(str(tmp_path / "über Wald_7.plan")).name == "ber Wald_7"


def test_an_elevation_file_in_a_folder_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"h\xf6he")
    folder.mkdir()
    (folder / "x.txt").write_bytes(LIST)
    path, terrain = folder / "mission.toml", '[terrain]\nfile = "h.tif"\nvertical_datum = "EGM96"\n'
    path.write_text(f'plan = "x.txt"\n{terrain}')
    told = refusal(lambda path, _: load_mission(str(path)), path, None)
    assert re.search(r"terrain\.file = .*must be a valid string", told), told
    world, valley = folder / "world.toml", Path(companion.__file__).parent / "environments/valley"
    world.write_bytes((valley / "world.toml").read_bytes())
    (folder / "terrain.tif").write_bytes(b"")
    told = refusal(lambda path, _: load_world(str(path)), world, None)
    assert re.search(r"terrain\.file = .*of an odd name", told), told


@given(
    st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace"))
)
@example(b"")
@example(b'{"type": "FeatureCollection"}')
@example(gzip.compress(b"QGC WPL 110\n", mtime=0))
@example(b"\x00\x06\x0a\x24\x18\x1e\x40\x00\xfd\x09")  # as a .ulg begins
def test_any_other_bytes_are_an_error_wherever_they_stand(folder: Path, content: bytes) -> None:
    other, toml = folder / "x.txt", folder / "mission.toml"
    other.write_bytes(content)
    (folder / "fenced.plan").write_bytes(FENCED)
    for load in (load_mission, load_world):
        refusal(lambda path, _, load=load: load(str(path)), other, None)
    for text in ('plan = "x.txt"\n', 'plan = "fenced.plan"\nthreats = "x.txt"\n'):
        toml.write_text(text)
        assert "x.txt" in refusal(lambda path, _: load_mission(str(path)), toml, None)
