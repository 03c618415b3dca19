"""The journal: what is written is read again with the same values; what is wrong is one line."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.errors import InputError
from companion.mission import journal as noted
from companion.mission.journal import VERSION
from companion.telemetry.journal import Journal

HEADER: dict[str, Any] = {"schema": "companion-journal", "version": VERSION, "mission": "hills"}
HEADER |= {"seed": 1, "profile": "flight", "lockstep": True}
LEG = {"t_s": 3.5, "kind": "leg", "number": 1}
SCAN = {"t_s": 1.0, "kind": "scan", "centre_nea_m": [1.0, 2.0], "blocks": 3}
REFUSED: list[tuple[list[Any], str]] = [
    ([LEG], r"line 1 = .*: a journal begins with a header"),
    ([{**HEADER, "version": VERSION - 1}], r"line 1: version = 2: only 3 can be read"),
    ([{**HEADER, "version": True}], r"line 1: version = True: only 3 can be read"),
    ([{**HEADER, "schema": "x"}], r"schema = 'x': only 'companion-journal' can be read"),
    ([{k: HEADER[k] for k in ("schema", "version")}], r"1 = .* missing .* field `mission`"),
    ([b'{"schema":\n'], r"line 1 = '\{\"schema\":': it is not JSON"),
    ([HEADER, b"\xff\xfe\n"], r"line 2 = .*: it is not JSON"),
    ([HEADER, LEG, [1]], r"line 3 = '\[1\]': an entry has a known kind"),
    ([HEADER, {"kind": "leg", "number": 1}], r"line 2 = .* missing required field `t_s`"),
    ([HEADER, SCAN], r"line 2: centre_nea_m = .*: Expected `array` of length 3, got 2"),
    ([HEADER, {"t_s": 1.0, "kind": "say", "text": "x" * 5000, "warning": 7}], r"warning = .*: "),
    ([bytes(65 * 2**20)], r"a line has no end within 64 MB"),
]


def written(folder: Path, *lines: Any) -> Journal:
    """A journal of these lines; bytes as they are, anything else as JSON."""
    texts = [
        line if isinstance(line, bytes) else msgspec.json.encode(line) + b"\n" for line in lines
    ]
    (folder / "journal.jsonl").write_bytes(b"".join(texts))
    return Journal(folder / "journal.jsonl")


def test_a_flight_is_read_and_written_again_with_the_same_values(run_dir: Path) -> None:
    """Nothing is made up, nothing is lost."""
    journal = Journal(run_dir / "journal.jsonl")
    entries = list(journal.entries())
    assert (journal.findings, len(journal.headers)) == ((), 1)
    assert {"phase", "leg", "plan ready", "order", "fence"} <= {entry.kind for entry in entries}
    lines = (run_dir / "journal.jsonl").read_bytes().splitlines()[1:]
    for text, entry in zip(lines, entries, strict=True):
        given, again = json.loads(text), json.loads(msgspec.json.encode(entry))
        assert {name: again[name] for name in given} == given
        left_out = {name: again[name] for name in again.keys() - {*given, *noted.UNTOLD}}
        assert set(left_out.values()) <= {None}, left_out


def test_reading_stops_at_the_last_whole_line_wherever_it_was_cut(tmp_path: Path) -> None:
    whole = written(tmp_path, HEADER, LEG, {**LEG, "number": 2}).path.read_bytes()
    for length in range(len(whole) + 1):
        *lines, torn = whole[:length].split(b"\n")
        journal = written(tmp_path, whole[:length])
        assert len(list(journal.lines())) == len(lines)
        said = f"journal.jsonl: the last line is not whole ({len(torn)} bytes): left out"
        assert journal.findings == ((said,) if torn else ())


def test_kinds_that_are_not_known_are_counted_and_fields_passed_over(tmp_path: Path) -> None:
    odd = {"t_s": 1.0, "kind": "levitation", "height_m": 3.0}
    journal = written(tmp_path, {**HEADER, "mood": 1}, odd, {**LEG, "colour": 1}, odd)
    assert [entry.kind for entry in journal.entries()] == ["leg"]
    left_out = "journal.jsonl: 2 x kind 'levitation', which is not known: left out"
    assert journal.findings == (left_out,)


def test_what_is_wrong_is_said_in_one_line(tmp_path: Path) -> None:
    for lines, words in REFUSED:
        with pytest.raises(InputError, match=words) as caught:
            list(written(tmp_path, *lines).entries())
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 600
    with pytest.raises(InputError, match=r"it cannot be read \(Is a directory\)"):
        list(Journal(tmp_path).entries())
