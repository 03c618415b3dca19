"""Text files as users have them: read, or refused in one line."""

import contextlib
import errno
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from companion.errors import InputError
from companion.printable import with_printable_texts

RawTable = dict[str, Any]
"""A table as its file has it: nothing in it has been checked."""
PICTURES = (".png", ".svg", ".pdf")
"""How files of pictures end."""

MAX_BYTES = 64_000_000
PLAN, WAYPOINTS = b"{", b"QGC WPL"
"""How the content of these files begins, behind white space."""
_BEGINNING_BYTES = 4096


def read_text(path: Path, field: str, remedy: str) -> str:
    """The text of a file.  Raises InputError about the field if there is none to be read."""
    rule = "it is a folder" if answer(path.is_dir) else "no such file"
    try:
        if answer(path.is_file):
            rule = f"it is larger than {MAX_BYTES / 1e6:g} MB"
            if path.stat().st_size <= MAX_BYTES:
                return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        rule = f"it cannot be read: it is no text in UTF-8, from byte {error.start}"
    except OSError as error:
        rule = f"it cannot be read ({error})"
    raise InputError(field, str(path), rule, remedy)


@contextlib.contextmanager
def within(where: str, advice: str = "") -> Iterator[None]:
    """Say of what is refused meanwhile in which file it is; advice: after the remedy."""
    try:
        yield
    except InputError as error:
        remedy = " ".join(filter(None, (error.remedy, advice)))
        raise InputError(f"{where}: {error.field}", error.value, error.rule, remedy) from None


def begins_as(path: Path, *beginnings: bytes) -> bool:
    """Whether the content of a file begins so, behind white space; no, if it cannot be read."""

    def begins() -> bool:
        with path.open("rb") as file:
            content = file.read(_BEGINNING_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
        return content.startswith(beginnings)

    return answer(path.is_file) and answer(begins)


def answer(question: Callable[[], bool]) -> bool:
    """The answer, no for a name that the file system does not take."""
    try:
        return question()
    except (OSError, ValueError):
        return False


def file_of_run(run_dir: Path, name: str, field: str = "RUN_DIR") -> Path:
    """A file of a run folder.  Raises InputError about the field if it is not there."""
    if answer(run_dir.is_file):
        rule = "it is a file, and a run folder is asked for"
        remedy = (
            "Logs of others are for companion replay LOG --shadow and companion view LOG; of a "
            "flight of the companion give the folder."
        )
        raise InputError(field, str(run_dir), rule, remedy)
    if not answer((run_dir / name).is_file):
        rule = f"it holds no {name}" if answer(run_dir.is_dir) else "no such folder"
        remedy = "Give the run folder of a flight: the one that was given to companion fly --out."
        raise InputError(field, str(run_dir), rule, remedy)
    return run_dir / name


def writable(option: str, path: Path) -> Path:
    """Refuse a file that cannot be written before time is spent on what goes into it."""
    is_folder = answer(path.is_dir)
    if is_folder or not answer(path.absolute().parent.is_dir):
        rule = "it is a folder" if is_folder else "its folder does not exist"
        raise InputError(option, str(path), rule, "Give a file in a folder that exists.")
    return path


@contextlib.contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """Raise InputError about the option if what is done meanwhile cannot be written.

    A file that a full disk took only a part of is removed.
    """
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) and answer(path.is_file):
            path.unlink()
        rule = f"not written ({error.strerror or error})"
        raise InputError(option, str(path), rule, "Give a file that can be written.") from error


def picture_file(option: str, path: Path) -> Path:
    """Likewise a file that does not end as pictures do."""
    if path.suffix.lower() not in PICTURES:
        rule = f"a picture ends in {', '.join(PICTURES[:-1])} or {PICTURES[-1]}"
        raise InputError(option, str(path), rule, "Name the file so.")
    return writable(option, path)


def toml_table(text: str, where: str) -> RawTable:
    """The table of a TOML text.  Raises InputError about the file."""
    try:
        return {**with_printable_texts(tomllib.loads(text))}
    except (RecursionError, ValueError) as error:  # brackets in brackets, numbers without end, too
        rule, remedy = f"not TOML: {_one_line(error)}", "Mend that place; see docs/files.md."
        raise InputError("file", where, rule, remedy) from None


def located(table: RawTable, folder: Path) -> RawTable:
    """A world or a mission that names its elevation file, if it does, by an absolute path.

    folder: where it names it from.
    """
    terrain = table.get("terrain")
    if not (isinstance(terrain, dict) and isinstance(terrain.get("file"), str)):
        return table
    return table | {"terrain": terrain | {"file": str((folder / terrain["file"]).absolute())}}


def json_table(path: Path, field: str, remedy: str) -> RawTable:
    """The object in a JSON file.  Raises InputError about the field."""

    def constant(name: str) -> None:
        raise ValueError(f"{name} is no number")

    text = read_text(path, field, remedy)
    try:
        value = with_printable_texts(json.loads(text, parse_constant=constant))
    except (RecursionError, ValueError) as error:
        raise InputError(field, str(path), f"not JSON: {_one_line(error)}", remedy) from None
    if not isinstance(value, dict):
        raise InputError(field, str(path), "it holds no JSON object", remedy)
    return value


def plain(text: object, default: str, most: int = 60) -> str:
    """A name out of a file, made fit to be shown: one line, not too long, nothing unprintable."""
    if not isinstance(text, str):
        return default
    shown = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(shown.split())[:most] or default


def with_settings(table: RawTable, settings: Sequence[str]) -> RawTable:
    """A table with other values of some keys, each "table.key=value", the value as in TOML.

    Raises InputError for what is not of that form; whether there is such a key is not checked.
    """
    for setting in settings:
        path, sign, text = setting.partition("=")
        *above, last = [key.strip() for key in path.split(".")]
        if not sign or not all([*above, last]):
            remedy = "Write it like planner.safety_distance_m=300."
            raise InputError("--set", setting, "it is not a key, an = and a value", remedy)
        table = inner = dict(table)
        for key in above:
            below = inner.get(key)
            inner[key] = inner = dict(below) if isinstance(below, dict) else {}
        try:
            inner[last] = tomllib.loads(f"value = {text}")["value"]
        except (RecursionError, ValueError):
            inner[last] = text.strip()  # a string: people leave out the quotes
    return table


def merged(table: RawTable, over: RawTable, joined: Sequence[str] = ()) -> RawTable:
    """A table with what is over it, table by table; joined: lists of which both count."""
    result = dict(table)
    for key, value in over.items():
        below = result.get(key)
        if isinstance(value, dict) and isinstance(below, dict):
            result[key] = merged(below, value, joined)
        elif key in joined and isinstance(value, list):
            result[key] = [*value, *(below or [])]
        else:
            result[key] = value
    return result


def toml_text(table: RawTable) -> str:
    """A table of strings, numbers, truths, lists and tables as TOML; None is left out."""
    plain_lines, headed_lines = list[str](), list[str]()
    for key, value in table.items():
        if isinstance(value, dict):
            headed_lines += ["", f"[{_key(key)}]", *_pairs(value)]
        elif isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
            headed_lines += [
                line for row in value for line in ("", f"[[{_key(key)}]]", *_pairs(row))
            ]
        else:
            plain_lines += _pairs({key: value})
    return "\n".join([*plain_lines, *headed_lines]) + "\n"


def _pairs(table: RawTable) -> list[str]:
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items() if value is not None]


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _value(key)


def _value(value: object) -> str:
    match value:
        case str():
            fit = value.encode("utf-8", "replace").decode()  # half a surrogate is no character
            return json.dumps(fit, ensure_ascii=False).replace("\x7f", "\\u007f")
        case list() | tuple():
            return f"[{', '.join(map(_value, value))}]"
        case dict():
            return f"{{{', '.join(_pairs(value))}}}"
        case bool():
            return json.dumps(value)
        case _:
            return str(value)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
