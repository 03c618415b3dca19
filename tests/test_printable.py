"""Texts from outside are fit to be shown wherever they come in."""

import json
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from companion.errors import FlightFailed
from companion.mavlink.frames import Receiver
from companion.mission.journal import VERSION
from companion.printable import printable
from companion.sources.files import json_table, toml_table
from companion.telemetry.journal import Journal

NASTY = (
    "\x1b[2J\x1b[31mred",
    "two\r\nlines",
    "\x9b31m",  # the same as ESC [, in one character of C1
    "a\u202eb",  # from right to left
    "line\u2028line",
    "\x7f\b\b",
)
HARMLESS = ("plain", "Zürich — 47°", "\u05e9\u05dc\u05d5\u05dd", "no\u00a0break", "山", "👍")


def is_fit(*texts: str) -> bool:
    return not {unicodedata.category(c) for c in "".join(texts)} & {"Cc", "Cf", "Cs", "Zl", "Zp"}


@given(st.text())
def test_what_is_shown_steers_no_terminal_and_is_as_long(text: str) -> None:
    assert is_fit(printable(text))
    assert len(printable(text)) == len(text)
    assert [printable(each) for each in HARMLESS] == [*HARMLESS]


def heard(message: Any) -> Any:
    """As it is read; the frame is recorded as it came."""
    sent = message.pack(wire.MAVLink(None, srcSystem=1, srcComponent=1))
    [received] = Receiver().feed(sent)
    assert bytes(received.get_msgbuf()) == sent
    return received


@pytest.mark.parametrize("text", NASTY)
def test_texts_are_cleaned_where_they_come_in(text: str, tmp_path: Path) -> None:
    """Of MAVLink, of TOML and JSON files, of journals; and of errors."""
    raw = text.encode("utf-8", "replace")[:16]
    assert is_fit(
        heard(wire.MAVLink_statustext_message(4, raw)).text,
        heard(wire.MAVLink_param_value_message(raw, 1.0, 9, 1, 0)).param_id,
        heard(wire.MAVLink_open_drone_id_self_id_message(1, 1, [0] * 20, 0, raw)).description,
        str(FlightFailed(f"a part has died ({text})", "")),
    )
    toml = f"name = {json.dumps(text)}\n[[radars]]\nname = {json.dumps(text)}"
    table = toml_table(toml.replace("\\b", "\\u0008"), "x")
    assert is_fit(table["name"], table["radars"][0]["name"])
    (tmp_path / "a.json").write_text(json.dumps({text: [text]}), encoding="utf-8")
    [(key, [value])] = json_table(tmp_path / "a.json", "file", "Mend it.").items()
    assert is_fit(key, value)
    header = {"schema": "companion-journal", "version": VERSION, "mission": text, "seed": 1}
    header |= {"profile": "flight", "lockstep": True}
    said = {"t_s": 1.0, "kind": "vehicle says", "text": text}
    lines = [json.dumps(each, separators=(",", ":")) + "\n" for each in (header, said)]
    (tmp_path / "journal.jsonl").write_text("".join(lines), encoding="utf-8")
    read = Journal(tmp_path / "journal.jsonl")
    [entry] = read.entries()
    assert is_fit(getattr(entry, "text", "\n"), read.headers[0].mission)
