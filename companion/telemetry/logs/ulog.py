"""PX4's .ulg, as pyulog reads it: the topics that are wanted, in memory, by time."""

import heapq
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyulog import ULog, core
from pyulog.exceptions import ULogIncompatibleFlagException

from companion.errors import InputError
from companion.telemetry.logs.anomalies import Anomaly, AnomalyCounter
from companion.telemetry.logs.translated import Row

MAGIC: Final = b"ULog\x01\x12\x35"
PARAMETER: Final = "(parameter)"
TEXT: Final = "(text)"
"""Names of the rows that are of no topic."""
_CHUNK: Final = 4096
"""Messages of a topic that are made rows at a time."""

core.print = lambda *_, **__: None  # it prints what it takes for damage


def read(path: Path, topics: Collection[str]) -> ULog | None:
    """A log with these of its topics; None: it cannot be read.

    InputError if it is of a later format.
    """
    with path.open("rb") as file:  # pyulog would not close it when it fails
        try:
            return ULog(file, topics)
        except ULogIncompatibleFlagException as error:
            rule = "its flags say that it must not be read by who does not know them"
            remedy = "Convert it to the present ULog format."
            raise InputError("log", str(path), rule, remedy) from error
        except Exception:  # noqa: BLE001 - whatever damage brings it to raise
            return None


def first_instances(log: ULog) -> list[ULog.Data]:
    """The data of its topics, of each the first instance.

    In reverse order of their names: what is known of a moment is the vehicle's status first, then
    its local position, then the global one that is made of it.
    """
    found = [
        each
        for each in log.data_list
        if each.multi_id == 0 and each.data.get("timestamp", np.zeros(0)).dtype.kind == "u"
    ]
    return sorted(found, key=lambda each: each.name, reverse=True)


def parameters(log: ULog) -> dict[str, float]:
    """By name, as they were in the end."""
    changed = {name: value for _, name, value in log.changed_parameters}
    return {
        name: value
        for name, value in (log.initial_parameters | changed).items()
        if isinstance(value, (int, float))
    }


def rows(log: ULog, findings: AnomalyCounter) -> Iterator[Row]:
    """Data, parameters and texts, by time; damage and losses are noted."""
    if log.file_corruption:
        findings.note(Anomaly.CORRUPT, 0, None)
    for lost in log.dropouts:
        findings.note(Anomaly.LOST_TIME, 0, None, lost.duration)
    for name, value in log.initial_parameters.items():
        yield _parameter(None, name, value)
    texts = [*log.logged_messages]
    for tagged in log.logged_messages_tagged.values():
        texts += tagged
    others = [_parameter(*each) for each in log.changed_parameters]
    for each in texts:
        values = {"level": each.log_level, "text": each.message}
        others.append(Row(TEXT, each.timestamp, values, 0))
    others.sort(key=_time_us)
    yield from heapq.merge(others, *map(_data, first_instances(log)), key=_time_us)


def _time_us(row: Row) -> int:
    return row.time_us or 0


def _parameter(time_us: int | None, name: str, value: Any) -> Row:
    return Row(PARAMETER, time_us, {"key": name, "value": value}, 0)


def _data(topic: ULog.Data) -> Iterator[Row]:
    """The messages of a topic by time; arrays, which pyulog takes apart, are lists."""
    singles, arrays = dict[str, Any](), dict[str, list[Any]]()
    for name, column in topic.data.items():
        if name.endswith("]"):
            arrays.setdefault(name[: name.rindex("[")], []).append(column)
        else:
            singles[name] = column
    order = np.argsort(topic.data["timestamp"], kind="stable")
    for begin in range(0, len(order), _CHUNK):
        some = order[begin : begin + _CHUNK]
        columns = {name: column[some].tolist() for name, column in singles.items()}
        for name, parts in arrays.items():
            columns[name] = np.stack([part[some] for part in parts], axis=1).tolist()
        for row in zip(*columns.values(), strict=True):
            values = dict(zip(columns, row, strict=True))
            yield Row(topic.name, values["timestamp"], values, 0)
