"""A flight as it is shown while it is flown: on a terminal, and as JSON to a pipe."""

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import termios
import threading
from pathlib import Path
from typing import Any

import pytest
from flights import BAD_LINK, ENVIRONMENT, Flight, flown_as, simulator, warm_up
from programs import BIN, ROOT, free_port

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("hills")]
PAGE = ROOT / "docs" / "reference" / "fly-json.md"
TICK_S = 0.15  # a position, and its rounding
WIDTH, ENDS_S = 80, 400.0


class Shown:
    """The flight of the hills, shown on a terminal, and as JSON to a pipe."""

    def __init__(self, folder: Path) -> None:
        world, mission, *options = flown_as("hills")
        port, out = free_port(), os.pipe()
        fcntl.fcntl(out[1], fcntl.F_SETPIPE_SZ, 4096)
        us, them = pty.openpty()
        fcntl.ioctl(them, termios.TIOCSWINSZ, struct.pack("HHHH", 24, WIDTH, 0, 0))
        how = ("--lockstep", "--json", "--connect", f"udpin:127.0.0.1:{port}", "--out", folder)
        warm_up()
        process = subprocess.Popen(
            [BIN / "companion", "fly", mission, *options, *how],
            stdin=them,
            stdout=out[1],
            stderr=them,
            cwd=ROOT,
            env={**ENVIRONMENT, "TERM": "xterm-256color", "COLUMNS": f"{WIDTH}"},
        )
        os.close(them)
        os.close(out[1])
        read: dict[int, bytes] = {us: b"", out[0]: b""}

        def follow(end: int) -> None:
            try:
                while part := os.read(end, 65536):
                    read[end] += part
            except OSError:  # Linux's end of a terminal
                pass
            os.close(end)

        threads = [threading.Thread(target=follow, args=(end,)) for end in read]
        for thread in threads:
            thread.start()
        try:
            where = ("--connect", f"udpout:127.0.0.1:{port}", "--lockstep", *BAD_LINK)
            vehicle = simulator(world, folder.parent / "truth", *where)
            self.code = process.wait(ENDS_S)
            vehicle.wait()
        finally:
            process.kill()
        for thread in threads:
            thread.join()
        self.screen, self.json = read[us].decode(), read[out[0]]
        self.text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", self.screen)  # as a person sees it


@pytest.fixture
def shown(flown: Any) -> Shown:
    it: Shown = flown(by=Shown)
    return it


@pytest.fixture
def flight(flown: Any) -> Flight:
    """The same: it decides what that does, and all of it is recorded."""
    it: Flight = flown(*flown_as("hills"))
    return it


@pytest.fixture
def lines(shown: Shown) -> list[dict[str, Any]]:
    assert shown.json.endswith(b"\n")
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


def test_the_lines_say_what_the_journal_says(
    shown: Shown, flight: Flight, lines: list[dict[str, Any]]
) -> None:
    header, *entries = flight.journal
    first, *statuses, ended = lines
    for name in ("mission", "seed", "profile", "lockstep"):
        assert first[name] == header[name]
    assert (ended["outcome"], ended["reason"]) == (flight.end["outcome"], flight.end["reason"])
    assert ended["exit_code"] == shown.code == 0
    phases = [(0.0, "waiting"), *((e["t_s"], e["phase"]) for e in entries if e["kind"] == "phase")]
    for line in statuses:
        begun = [p for t, p in phases if abs(t - line["t_s"]) <= TICK_S]
        before = [p for t, p in phases if t <= max(line["t_s"] - TICK_S, 0.0)][-1]
        assert line["phase"] in (before, *begun), line
    assert {"flying", "done"} <= {line["phase"] for line in statuses}
    assert [line["t_s"] for line in statuses] == sorted(line["t_s"] for line in statuses)


def test_on_a_terminal_a_table_is_drawn_and_the_cursor_is_given_back(shown: Shown) -> None:
    text = shown.screen
    assert text.count("\x1b[?25l") == text.count("\x1b[?25h") > 0
    assert text.rindex("\x1b[?25h") < text.index("run folder: ")
    for word in ("FLYING", "to go", "AMSL", "clearance", "battery", "link", "proof"):
        assert word in shown.text
    table = [line for line in shown.text.splitlines() if line.startswith(("to go ", "FLYING "))]
    assert table
    assert max(map(len, table)) <= WIDTH
