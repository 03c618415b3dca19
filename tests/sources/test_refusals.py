"""A file that cannot be taken is told in one line: where, field, value, rule and remedy.

`refusals.txt` has a file and its line in each row: the edits of a usual file (`documents`), then
what is said of it.
"""

import contextlib
import gzip
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from documents import COPTER, DOCUMENTS, edited, loaded, mission, refusal, table_of, written
from hypothesis import example, given
from hypothesis import strategies as st

from companion.config import load_mission, load_world, read_mission
from companion.errors import InputError

REFUSALS = table_of("refusals.txt")


@pytest.mark.parametrize("kind", REFUSALS)
def test_each_file_is_refused_with_its_line(folder: Path, kind: str) -> None:
    for edits, said in REFUSALS[kind]:
        told = refusal(loaded, written(folder, kind, *edits)).replace(f"{folder}/", "")
        assert told == said
        assert re.fullmatch(r"\S[^\n]*? = [^\n]+: [^\n]+\. [A-Z][^\n]*[.?)]", told)


def places_in(content: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Every key and item with its path, at any depth, and what is there."""
    inside = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in inside:
        yield f"{above}{key}", value
        if isinstance(value, dict | list):
            yield from places_in(value, f"{above}{key}.")


KEYS = [(place, value) for place, value in places_in(COPTER) if not place.startswith("targets.")]


@pytest.mark.parametrize(("key", "value"), KEYS, ids=str)
def test_a_key_that_is_left_out_misspelt_or_no_number_is_named(
    folder: Path, key: str, value: Any
) -> None:
    def told(*edits: str) -> str:
        return refusal(mission, folder, "mission", *edits)

    last = key.rpartition(".")[2]
    missing = told(key)
    assert last in missing
    assert "it is missing" in missing or "there are either" in missing
    misspelt = told(key, f"{key}_x = {json.dumps(value)}")
    assert f"{last}_x = " in misspelt
    assert f"Did you mean {last}? Known here: " in misspelt
    for number in ("NaN", "Infinity", "-Infinity") if isinstance(value, float) else ():
        assert f"{last} = {float(number)}" in told(f"{key} = {number}")


NO_TEXTS = {
    "x.toml": [
        *(b"a = " + b"[" * 5000, b"a = " + b"9" * 10_000, b"a.b = 1\na = 2", b"\x00"),
        *(b"a = 2020-99-99", b"<kml>", b"\xff\xfe{}"),
    ],
    "x.plan": [
        *(b"", b"[" * 100_000, b'{"a": ' + b"9" * 10_000 + b"}", b'{"a": -Infinity}'),
        *(b"[1, 2]", b"\xff\xfe{}", b"{}"),
    ],
}


@pytest.mark.parametrize(("name", "text"), [(n, text) for n in NO_TEXTS for text in NO_TEXTS[n]])
def test_what_is_no_table_is_told_with_what_it_is_not(
    tmp_path: Path, name: str, text: bytes
) -> None:
    (tmp_path / name).write_bytes(text)
    told = refusal(load_mission, str(tmp_path / name))
    kinds = "not TOML: |not JSON: |holds no JSON object|no QGroundControl plan|no text in UTF-8"
    assert re.search(f"^(file|MISSION|{re.escape(str(tmp_path))}/{name}).* = .*({kinds})", told)


@given(
    st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace"))
)
@example(b"")
@example(b'{"type": "FeatureCollection"}')
@example(gzip.compress(b"QGC WPL 110\n", mtime=0))
@example(b"\x00\x06\x0a\x24\x18\x1e\x40\x00\xfd\x09")  # as a .ulg begins
def test_any_other_bytes_are_one_line_wherever_they_stand(folder: Path, content: bytes) -> None:
    other = folder / "other.txt"
    other.write_bytes(content)
    for load in (load_mission, load_world):
        refusal(load, str(other))
    for key in ("plan", "threats"):
        path = written(folder, "mission", f'{key} = "other.txt"')
        assert "other.txt" in refusal(load_mission, str(path))


def test_what_is_no_mission_and_no_world_is_told(folder: Path) -> None:
    names = r"'nowhere'.*no such file.*environment-1, environment-2"
    world = written(folder, "world")
    for name, words in (
        ("nowhere", names),
        (folder, r"it is a folder\. Give a mission\.toml"),
        ("x" * 5000, "xxx"),
        (world, r"this is a world, not a mission\. Give its mission\.toml"),
    ):
        assert re.search(words, refusal(load_mission, str(name)))


NUMBERS = ["true", "0", "-1", "1e308", "1e-300", f"{2**62}", "9" * 400, "91.0", "16", "20", "177"]
OTHERS = ["null", '""', '"x\\ny"', '"radar"', '"x.plan"', "[]", "{}", "[[]]", "[{}]"]
JUNK = st.sampled_from([*NUMBERS, *OTHERS, "[8.0, 47.0]", '{"type": 1}'])


@pytest.mark.parametrize(
    "kind", ["mission", "all of a mission", "plan", "list", "GeoJSON", "world"]
)
@given(data=st.data())
def test_any_value_anywhere_is_taken_or_one_line(
    folder: Path, kind: str, data: st.DataObject
) -> None:
    content = DOCUMENTS[kind][1]
    content = [line.split() for line in content] if kind == "list" else content
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.sampled_from([place for place, _ in places_in(content)]))
        content = edited(content, f"{place} = {data.draw(JUNK)}")
    if kind == "list":
        content = [
            " ".join(map(str, row)) if isinstance(row, list) else str(row) for row in content
        ]
    path = written(folder, kind, content=content)
    with contextlib.suppress(InputError):
        loaded(path)
        if path.name != "world.toml":
            assert read_mission(str(path)).text
