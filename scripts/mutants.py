"""Small faults put into the product, and which tests notice: see tests/baseline/README.md."""

import argparse
import ast
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from bisect import bisect_right
from collections import Counter
from functools import cache
from itertools import accumulate, count, pairwise
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
BASELINE = ROOT / "tests/baseline/mutants.jsonl"
PARTS = ("planner", "path", "world", "mission", "mavlink", "replay", "telemetry")
_SWAPS = {"<": "<=", ">": ">=", "==": "!=", "is": "is not", "in": "not in", "+": "-", "*": "/"}
_SWAPS |= {"and": "or", "min": "max", "minimum": "maximum"}
_SWAPS |= {other: token for token, other in _SWAPS.items()}
_TOKEN = rb"[<>]=?|[=!]=|[-+*/]|\b(?:is(?:\s+not)?|(?:not\s+)?in|and|or|m(?:in|ax)(?:imum)?)\b"
_LEFT_ALONE = ("annotation", "returns", "decorator_list")  # of any node


class Mutant(NamedTuple):
    """One change of a file; it is found again by the first five fields."""

    file: str
    function: str
    operator: str
    line: str
    nth: int  # of those that have all of these in common
    row: int
    start: int  # bytes of the file
    end: int
    new: str

    def applied(self, source: bytes) -> bytes:
        """The file with the change."""
        return source[: self.start] + self.new.encode() + source[self.end :]


def mutants_of(source: bytes, file: str) -> list[Mutant]:
    """Every mutant of a file, in its order."""
    lines = source.splitlines(keepends=True)
    begins = [0, *accumulate(map(len, lines))]
    places: list[tuple[int, int, str, str, str]] = []

    def span(node: Any) -> tuple[int, int]:
        start = begins[node.lineno - 1] + node.col_offset
        return start, begins[node.end_lineno - 1] + node.end_col_offset

    def swap(function: str, start: int, end: int) -> None:
        """The one operator or name in a stretch of the source."""
        token = re.search(_TOKEN, source[start:end])
        if token and b"#" not in source[start:end]:
            word = " ".join(token[0].decode().split())
            place = start + token.start(), start + token.end()
            places.append((*place, function, f"{word} -> {_SWAPS[word]}", _SWAPS[word]))

    def visit(node: Any, function: str) -> None:
        operands: list[ast.AST] = []
        match node:
            case ast.Import() | ast.ImportFrom() | ast.Raise() | ast.Assert() | ast.JoinedStr():
                return
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                return
            case ast.FunctionDef() | ast.ClassDef():
                function = f"{function}.{node.name}".removeprefix(".")
            case ast.Compare():
                operands = [node.left, *node.comparators]
            case ast.BoolOp():
                operands = node.values
            case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div()):
                operands = (
                    [] if _is_text(node.left) or _is_text(node.right) else [node.left, node.right]
                )
            case ast.UnaryOp(op=ast.Not()):
                start = span(node)[0]
                places.append((start, start + 3, function, "not dropped", ""))
            case ast.Constant(value=bool()):
                places.append((*span(node), function, "constant", repr(not node.value)))
            case ast.Constant(value=int() | float()):
                places.append((*span(node), function, "constant", repr(node.value + 1)))
            case ast.Return(value=ast.AST()) if ast.unparse(node.value) != "None":
                places.append((*span(node.value), function, "return None", "None"))
            case ast.Expr(value=ast.Call()):
                places.append((*span(node), function, "call dropped", "pass"))
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
                if name in ("min", "max", "minimum", "maximum"):
                    swap(function, span(node.func)[1] - len(name), span(node.func)[1])
        for one, other in pairwise(operands):
            swap(function, span(one)[1], span(other)[0])
        for field, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and field not in _LEFT_ALONE:
                    visit(child, function)

    visit(ast.parse(source), "")
    seen: Counter[tuple[str, str, str]] = Counter()
    mutants = []
    for start, end, function, operator, new in sorted(places):
        row = bisect_right(begins, start)
        name = function or "<module>", operator, lines[row - 1].decode().strip()
        mutants.append(Mutant(file, *name, seen[name], row, start, end, new))
        seen[name] += 1
    return mutants


def _is_text(node: Any) -> bool:
    return isinstance(node, ast.JoinedStr) or isinstance(getattr(node, "value", None), str)


@cache
def of_file(file: str) -> list[Mutant]:
    return mutants_of((ROOT / file).read_bytes(), file)


def _python(folder: str, pattern: str = "*") -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob(f"{pattern}.py"))


def found_again(entry: dict[str, Any]) -> Mutant | None:
    """A mutant of the baseline: in its place, in another file, or in a function renamed."""
    file, function, *rest = (entry[field] for field in Mutant._fields[:5])
    alike = [m for m in (of_file(file) if (ROOT / file).exists() else ()) if [*m[2:5]] == rest]
    if same := [mutant for mutant in alike if mutant.function == function]:
        return same[0]
    moved = [m for other in _python("companion") for m in of_file(other) if [*m[2:5]] == rest]
    last = function.rpartition(".")[2]
    same = [m for m in moved if m.function.rpartition(".")[2] == last] or alike
    return same[0] if len(same) == 1 else None


def drawn(part: str, number: int, seed: int) -> list[Mutant]:
    """So many mutants of a part, anywhere in it."""
    every = [mutant for file in _python(f"companion/{part}") for mutant in of_file(file)]
    return random.Random(f"{seed} {part}").sample(every, min(number, len(every)))


class Copy:
    """A copy of the checkout in which one file at a time is another one."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "copy"
        skipped = shutil.ignore_patterns(".git", ".venv*", ".*_cache", "__pycache__", "runs")
        shutil.copytree(ROOT, self.root, ignore=skipped)
        self._stamps = count(2_000_000_000)  # each mutant another: nothing that is cached fits
        more = {"PYTHONPATH": str(self.root), "NUMBA_CACHE_DIR": str(folder / "numba")}
        self._environment = os.environ | more | {"OPENBLAS_NUM_THREADS": "1"}

    def failing(self, mutant: Mutant | None, seconds: float, *what: str) -> list[str]:
        """The tests that fail with a mutant, with -x the first; `late` if it takes too long."""
        if mutant is not None:
            file, stamp = self.root / mutant.file, next(self._stamps)
            file.write_bytes(mutant.applied(file.read_bytes()))
            os.utime(file, (stamp, stamp))
        command = [sys.executable, "-m", "pytest", "-qq", "-rfE", "--tb=no", "--assert=plain"]
        command += ["-p", "no:xdist", "-p", "no:cacheprovider", *what]
        with subprocess.Popen(
            command, cwd=self.root, env=self._environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        ) as child:  # fmt: skip
            try:
                output, _ = child.communicate(timeout=seconds)
            except subprocess.TimeoutExpired:
                os.killpg(child.pid, signal.SIGKILL)
                output = "FAILED late"
        if mutant is not None:
            shutil.copy2(ROOT / mutant.file, self.root / mutant.file)
        failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
        return failed or (["crashed"] if child.returncode not in (0, 5) else [])


def recorded() -> list[dict[str, Any]]:
    """What stands in the baseline."""
    return [json.loads(line) for line in BASELINE.read_text(encoding="utf-8").splitlines()]


def killers_of(entry: dict[str, Any]) -> list[str]:
    """What pytest is told to run the killers of a mutant, in whatever files they are now."""
    names = {test.partition("::")[2].partition("[")[0] for test in entry["killers"]}
    texts = {file: (ROOT / file).read_text(encoding="utf-8") for file in _python("tests", "test_*")}
    files = [
        f for f, text in texts.items() if any(f"def {name}(" in text for name in names if name)
    ]
    return [*files, "-k", " or ".join(sorted(names))] if files else []


def tests_of(mutant: Mutant) -> list[str]:
    """The folders of the tests of its part; at least those of the session."""
    folders = [f"tests/{part}" for part in Path(mutant.file).parts[1:-1]]
    return [folder for folder in folders if (ROOT / folder).is_dir()] or _python(
        "tests", "test_session*"
    )


def main() -> None:
    """Print what comes of each; 1 if one that was killed survives, or one is not tested in time."""
    parser = argparse.ArgumentParser(prog="scripts/mutants", description=__doc__)
    parser.add_argument("part", choices=[*PARTS, "all"])
    parser.add_argument("--drawn", type=int, default=0, metavar="N", help="N new ones of each part")
    parser.add_argument("--seed", type=int, default=1, help="of these")
    parser.add_argument("--seconds", type=float, default=120.0, help="for the tests of a mutant")
    asked = parser.parse_args()
    parts = PARTS if asked.part == "all" else (asked.part,)
    todo = [(found_again(e), killers_of(e)) for e in recorded() if e["part"] in parts]
    if asked.drawn:
        todo = [(m, []) for part in parts for m in drawn(part, asked.drawn, asked.seed)]
    ends = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for mutant, killers in todo:
            end = "gone"
            if mutant is not None:
                for what in filter(None, (killers, tests_of(mutant))):
                    if killed := copy.failing(mutant, asked.seconds, "-x", *what):
                        break
                # what is late hangs, if half the time is enough without the mutant
                late = killed == ["late"] and copy.failing(None, asked.seconds / 2, "-x", *what)
                end = "not tested in time" if late else "killed" if killed else "survived"
                words = f"{mutant.file}:{mutant.row}: {mutant.operator}, `{mutant.line}`"
                print(f"{end}: {words}", *killed[:1], flush=True)
            ends[end] += 1
    print(", ".join(f"{number} {end}" for end, number in ends.items()))
    sys.exit(ends["not tested in time"] > 0 or (ends["survived"] > 0 and not asked.drawn))


if __name__ == "__main__":
    main()
