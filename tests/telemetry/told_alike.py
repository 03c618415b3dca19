"""One flight in two logs: the messages of a kind as tables, and what changes in them."""

import numpy as np

from companion.geodesy import FloatArray
from companion.mavlink.dialect import Message, wire

Told = list[tuple[int, Message]]
"""What a log tells: microseconds, and message."""


def of_kind(pairs: Told, kind: str) -> Told:
    return [pair for pair in pairs if pair[1].get_type() == kind]


def table(pairs: Told, kind: str, fields: str) -> FloatArray:
    """A line for each message of a kind, a column for each field.  (M, F)."""
    rows = [[getattr(m, name) for name in fields.split()] for _, m in of_kind(pairs, kind)]
    return np.array(rows, dtype=float)


def both_at(theirs: Told, mine: Told, kind: str, fields: str) -> tuple[FloatArray, FloatArray]:
    """The lines of both of the same moments by the first field, without it.  (M, F - 1)."""
    tables = [table(each, kind, fields) for each in (theirs, mine)]
    _, *places = np.intersect1d(*(each[:, 0] for each in tables), return_indices=True)
    first, second = (each[at, 1:] for each, at in zip(tables, places, strict=True))
    return first, second


def late_s(theirs: Told, mine: Told) -> FloatArray:
    """By how much positions of the same moment since boot are later in their log."""
    kind = "GLOBAL_POSITION_INT"
    begun = {m.time_boot_ms: t for t, m in of_kind(theirs, kind)}
    pairs = [(begun.get(m.time_boot_ms), t) for t, m in of_kind(mine, kind)]
    return np.array([(at_us - t) * 1e-6 for at_us, t in pairs if at_us is not None])


def changes(pairs: Told, kind: str, fields: str) -> list[list[float]]:
    """Time in seconds and values, each time that these change; of a heartbeat's mode the arming."""
    found: list[list[float]] = []
    for time_us, message in of_kind(pairs, kind):
        armed = wire.MAV_MODE_FLAG_SAFETY_ARMED
        values = {name: getattr(message, name) for name in fields.split()}
        now = [value & armed if name == "base_mode" else value for name, value in values.items()]
        if not found or found[-1][1:] != now:
            found.append([time_us * 1e-6, *now])
    return found
