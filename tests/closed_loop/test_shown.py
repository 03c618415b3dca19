"""A flight as it is shown while it is flown: on a terminal, as JSON to a pipe, on a full disk."""

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import threading
from pathlib import Path
from typing import Any, get_args

import pytest
from flights import _ENVIRONMENT, BAD_LINK, Flight, flown_as, simulator, warm_up
from programs import ROOT, free_port

from companion.replay.command import Format, export
from companion.telemetry.journal import Journal
from companion.telemetry.run_folder import whole_records

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
PAGE = ROOT / "docs" / "reference" / "fly-json.md"
TICK_S = 0.15  # a position, and its rounding
WIDTH = 80
MOST_BYTES = 900_000
"""The operating system refuses more than so many bytes of any file of the companion's."""
FLY = (
    f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({MOST_BYTES},) * 2)\n"
    "from companion.cli import main\nmain()"
)


class Shown:
    """The flight of the hills on a full disk, shown on a terminal and as JSON to a pipe."""

    def __init__(self, folder: Path) -> None:
        world, mission, *options = flown_as("hills")
        port, out = free_port(), os.pipe()
        fcntl.fcntl(out[1], fcntl.F_SETPIPE_SZ, 4096)
        us, them = pty.openpty()
        fcntl.ioctl(them, termios.TIOCSWINSZ, struct.pack("HHHH", 24, WIDTH, 0, 0))
        how = ("--lockstep", "--json", "--connect", f"udpin:127.0.0.1:{port}", "--out", folder)
        warm_up()
        self.folder = folder
        self.process = subprocess.Popen(
            [*(sys.executable, "-c", FLY, "fly", mission), *options, *how],
            stdin=them, stdout=out[1], stderr=them, cwd=ROOT,
            env={**_ENVIRONMENT, "TERM": "xterm-256color", "COLUMNS": f"{WIDTH}"},
        )  # fmt: skip
        os.close(them)
        os.close(out[1])
        self.read: dict[int, bytes] = {us: b"", out[0]: b""}
        threads = [threading.Thread(target=self._read, args=(end,)) for end in self.read]
        for thread in threads:
            thread.start()
        try:
            where = ("--connect", f"udpout:127.0.0.1:{port}", "--lockstep", *BAD_LINK)
            vehicle = simulator(world, folder.parent / "truth", *where)
            self.code = self.process.wait(400.0)
            vehicle.wait()
        finally:
            self.process.kill()
        for thread in threads:
            thread.join()
        self.screen, self.json = (each.decode() for each in self.read.values())
        self.text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", self.screen)  # no colours, no moves

    def _read(self, end: int) -> None:
        try:
            while part := os.read(end, 65536):
                self.read[end] += part
        except OSError:  # Linux's end of a terminal
            pass
        os.close(end)


@pytest.fixture
def shown(flown: Any) -> Shown:
    it: Shown = flown(by=Shown)
    return it


@pytest.fixture
def lines(shown: Shown) -> list[dict[str, Any]]:
    return [json.loads(line) for line in shown.json.splitlines()]


def documented() -> dict[str, dict[str, str]]:
    """Kind of line -> field -> type, by the page."""
    kinds: dict[str, dict[str, str]] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if heading := re.fullmatch(r"## `(\w+)`", line):
            fields = kinds[heading[1]] = {}
        elif row := re.fullmatch(r"\| `(\w+)` \| (.+?) \| (.+) \|", line):
            fields[row[1]] = row[2]
    return kinds


def fits(value: object, kind: str) -> bool:
    """Whether a value is of a type as the page has it."""
    if kind.endswith(" or null"):
        return value is None or fits(value, kind.removesuffix(" or null"))
    if kind.startswith("`"):
        return f"`{value}`" in kind.split(", ")
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return {
        "text": isinstance(value, str),
        "number": is_number,
        "whole number": is_number and isinstance(value, int),
        "true or false": isinstance(value, bool),
        "[north, east, altitude]": isinstance(value, list) and len(value) == 3,
        "list of text": isinstance(value, list) and all(isinstance(each, str) for each in value),
    }[kind]


def test_every_line_has_the_fields_of_the_page_and_no_others(lines: list[dict[str, Any]]) -> None:
    kinds = documented()
    assert [line["kind"] for line in lines[:1] + lines[-1:]] == ["begun", "ended"]
    assert {line["kind"] for line in lines[1:-1]} == {"status"}
    for line in lines:
        fields = kinds[line["kind"]]
        assert line.keys() == fields.keys() | {"kind"}
        for name, kind in fields.items():
            assert fits(line[name], kind), (name, line[name])


def test_the_lines_say_what_the_journal_of_the_same_flight_says(
    shown: Shown, lines: list[dict[str, Any]], flown: Any
) -> None:
    flight: Flight = flown(*flown_as("hills"))
    *statuses, ended = lines[1:]
    assert (ended["outcome"], ended["reason"]) == (flight.end["outcome"], flight.end["reason"])
    assert ended["exit_code"] == shown.code == 0
    changes = [(e["t_s"], e["phase"]) for e in flight.journal if e.get("kind") == "phase"]
    phases = [(0.0, "waiting"), *changes]
    for line in statuses:
        begun = [p for t, p in phases if abs(t - line["t_s"]) <= TICK_S]
        before = [p for t, p in phases if t <= max(line["t_s"] - TICK_S, 0.0)][-1]
        assert line["phase"] in (before, *begun), line
    assert {"flying", "done"} <= {line["phase"] for line in statuses}


def test_on_a_terminal_a_table_is_drawn_and_the_cursor_is_given_back(shown: Shown) -> None:
    assert shown.screen.count("\x1b[?25l") == shown.screen.count("\x1b[?25h") > 0
    assert shown.screen.rindex("\x1b[?25h") < shown.screen.index("run folder: ")
    table = [line for line in shown.text.splitlines() if line.startswith(("to go ", "FLYING "))]
    assert table
    assert max(map(len, table)) <= WIDTH


def test_a_flight_whose_disk_is_full_goes_on_says_so_and_leaves_whole_records(
    shown: Shown, tmp_path: Path
) -> None:
    assert shown.code == 0, shown.text
    for said in ("arrived", "not recorded any more: File too large", "recording stopped: File"):
        assert said in shown.text
    log = shown.folder / "flight.tlog"
    assert MOST_BYTES - 300 < log.stat().st_size <= MOST_BYTES
    assert whole_records(log) == log.stat().st_size
    journal = Journal(shown.folder / "journal.jsonl")
    assert "end" not in {entry.kind for entry in journal.entries()}  # that was later
    assert journal.findings == ()
    for to in get_args(Format):
        export(shown.folder, to, tmp_path / f"flight.{to}")
