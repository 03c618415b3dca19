import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.sources.files import json_table, plain, read_text, toml_table, toml_text, writing

SCALARS = (
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text()
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


def test_what_a_full_disk_took_a_part_of_is_removed_and_a_device_is_not(tmp_path: Path) -> None:
    torn = tmp_path / "report.html"
    torn.write_text("half", encoding="utf-8")
    with pytest.raises(InputError, match="No space left on device"), writing("--out", torn):
        Path("/dev/full").write_text("the other half", encoding="utf-8")
    assert not torn.exists()
    with pytest.raises(InputError, match="No space left"), writing("--out", Path("/dev/full")):
        Path("/dev/full").write_text("all of it", encoding="utf-8")
    assert Path("/dev/full").is_char_device()


@given(st.dictionaries(st.text(), VALUES, max_size=5))
def test_a_table_that_was_written_reads_back_as_it_was(table: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(table)) == table


def test_half_a_surrogate_is_written_as_something_that_can_be_read() -> None:
    assert tomllib.loads(toml_text({"name": "a\ud800b\x7f"})) == {"name": "a?b\x7f"}


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 5000, "a = " + "9" * 10_000, "a.b = 1\na = 2", "= 1", "\x00", "a = 2020-99-99"],
    ids=["deep", "long", "twice", "no key", "nul", "date"],
)
def test_what_is_no_toml_is_one_error_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"^file = 'x.toml': not TOML") as caught:
        toml_table(text, "x.toml")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("data", "rule"),
    [
        (b"", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b'{"a": ' + b"9" * 10_000 + b"}", "not JSON"),
        (b'{"a": NaN}', "NaN is no number"),
        (b'{"a": -Infinity}', "-Infinity is no number"),
        (b"[1, 2]", "no JSON object"),
        (b"\xff\xfe{}", "cannot be read"),
    ],
)
def test_what_is_no_json_object_is_one_error_in_one_line(
    tmp_path: Path, data: bytes, rule: str
) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        json_table(path, "plan", "Mend it.")
    message = str(caught.value)
    assert message.startswith("plan = ")
    assert rule in message
    assert message.endswith("Mend it.")
    assert len(message.splitlines()) == 1


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"\xef\xbb\xbf{}")
    assert json_table(path, "plan", "") == {}


def test_a_folder_and_a_missing_file_are_told_apart(tmp_path: Path) -> None:
    for path, rule in ((tmp_path, "it is a folder"), (tmp_path / "absent", "no such file")):
        with pytest.raises(InputError, match=rule):
            read_text(path, "field", "Remedy.")


def test_a_file_that_never_ends_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        file.truncate(64_000_001)
    with pytest.raises(InputError, match="larger than 64 MB"):
        read_text(path, "field", "Remedy.")


@given(st.none() | st.integers() | st.text())
def test_a_plain_name_is_one_printable_line_that_is_not_long(name: object) -> None:
    shown = plain(name, "nameless")
    assert 0 < len(shown) <= 60
    assert shown.isprintable()
    assert shown == shown.strip()
