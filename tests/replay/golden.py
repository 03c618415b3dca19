"""Golden flights: what a few recorded flights decide, line by line, for people to read a change in.

tests/replay/goldens/NAME/
    why.md            what it protects
    mission.toml      as flown
    world.toml        of a flight that has a world of its own
    inputs.msgpack    all that the session was told
    decisions.jsonl   what it decided: journal entries, commands to the vehicle, and one setpoint
                      in a second
    flight.json       how it was recorded

The plans are the recorded ones: so the lines are the same on every machine, but for last digits.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from companion.mavlink.dialect import Message
from companion.replay.differences import message_of
from companion.replay.feed import flown_mission, outputs
from companion.telemetry.inputs import FILE, InputsFile
from companion.telemetry.run_folder import RunFolder, journal_line

GOLDENS: Final = Path(__file__).parent / "goldens"
NAMES: Final = tuple(sorted(path.parent.name for path in GOLDENS.glob("*/why.md")))
EPOCH_US: Final = 1_700_000_000_000_000
TOLERANCE: Final = 1e-5
"""Metres, and metres a second: ten times the nudge (tests/nudge.py)."""
_STEP: Final = 2.0**-23
"""From one number of 32 bits to the next, as the wire has them: of either, at most."""
_SETPOINTS = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")
_LEFT_OUT = ("HEARTBEAT", "TIMESYNC", "TERRAIN_REQUEST", "SYS_STATUS")
"""Frames that say nothing of what was decided, or (the radar's) stand in the journal."""


def decisions_of(folder: Path) -> Iterator[dict[str, Any]]:
    """What the flight of a golden decides, line by line."""
    shown_s, inputs = -math.inf, 0
    for _, _, output in outputs(folder, flown_mission(folder)):
        inputs += 1
        if output is None:
            continue
        for entry in output.journal:
            yield json.loads(journal_line(entry))
        for time_s, frame in output.record:
            if frame not in output.frames:
                continue
            message = message_of(frame)
            if message is None or message.get_type() in _LEFT_OUT:
                continue
            if message.get_type() in _SETPOINTS:
                if time_s - shown_s < 1.0:
                    continue
                shown_s = time_s
            yield {"t_s": round(time_s, 6), "sends": message.get_type(), **_fields(message)}
    assert inputs == len(list(InputsFile(folder / FILE)))


def _fields(message: Message) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(json.dumps(message.to_dict(), default=repr))
    values.pop("mavpackettype")
    return {name: None if value != value else value for name, value in values.items()}


def run_folder_of(golden: Path, folder: Path) -> Path:
    """The run folder that such a flight has left, as far as it goes: told again what it was."""
    text = (golden / "mission.toml").read_text(encoding="utf-8")
    with RunFolder(folder, mission_toml=text, epoch_us=EPOCH_US, durable=False) as run:
        run.header({"mission": golden.name, "seed": 1, "profile": "flight", "lockstep": True})
        for told, _, output in outputs(golden, flown_mission(golden)):
            run.inputs([told])
            if output is not None:
                run.frames(output.record)
                run.entries(output.journal)
    return folder


def expected(folder: Path) -> list[dict[str, Any]]:
    """What it decided when it was last looked at by a person."""
    lines = (folder / "decisions.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


def differences(was: list[dict[str, Any]], now: list[dict[str, Any]]) -> str:
    """For people: how often each field differs, and the first place; "" if nothing does."""
    counts, first = Counter[str](), ""
    for number, (old, new) in enumerate(zip_longest(was, now, fillvalue={}), start=1):
        for field in _fields_that_differ(old, new):
            counts[f"{_what(old or new)}.{field}"] += 1
            place = f"line {number}, {field}:\n  was {json.dumps(old)}\n  now {json.dumps(new)}"
            first = first or place
    often = [f"{count} x {what}" for what, count in counts.most_common(10)]
    return "\n".join([*often, first]) if often else ""


def _what(line: dict[str, Any]) -> str:
    return str(line.get("kind") or line.get("sends"))


def _fields_that_differ(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    if _what(old) != _what(new):
        return ["kind"]
    whole = ("lat_int", "lon_int")  # they stand for others, and so may be one apart
    return [
        key
        for key in dict.fromkeys((*old, *new))
        if not _is_close(old.get(key), new.get(key), rounded=key in whole)
    ]


def _is_close(was: Any, now: Any, *, rounded: bool = False) -> bool:
    if rounded and isinstance(was, int) and isinstance(now, int):
        return abs(was - now) <= 1
    if isinstance(was, float) or isinstance(now, float):
        numbers = isinstance(was, int | float) and isinstance(now, int | float)
        return numbers and math.isclose(was, now, rel_tol=_STEP, abs_tol=TOLERANCE)
    if isinstance(was, list) and isinstance(now, list):
        return len(was) == len(now) and all(map(_is_close, was, now))
    if isinstance(was, dict) and isinstance(now, dict):
        return was.keys() == now.keys() and all(_is_close(was[key], now[key]) for key in was)
    return bool(was == now)
