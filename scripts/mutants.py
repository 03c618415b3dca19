"""Small faults put into the product, and which tests notice: see tests/baseline/README.md."""

import argparse
import ast
import csv
import json
import lzma
import math
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import cache
from itertools import accumulate, count, pairwise, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
BASELINE = ROOT / "tests/baseline/mutants.jsonl"
SCRATCH = ROOT / "runs/mutants"  # copies of the checkout, numba's cache, which test runs which line
SEED = 40
PARTS = {"planner": 60, "path": 35, "world": 45, "mission": 65, "mavlink": 60, "replay": 20}
PARTS |= {"telemetry": 35}  # how many mutants of each
LIMIT_S, WHOLE_S = 30.0, 150.0  # of a test, of all that are run for a mutant
MOST, TOGETHER_S, KEPT = 25, 4.0, 6  # tests of a mutant, their time; no more run if as many fail
_COMPILES = "compiled"  # in the names of tests that take half a minute where `path` has changed
_SWAPS = {"<": "<=", ">": ">=", "==": "!=", "is": "is not", "in": "not in", "+": "-", "*": "/"}
_SWAPS |= {"and": "or", "min": "max", "minimum": "maximum"}
_SWAPS |= {other: each for each, other in _SWAPS.items()}
_TOKEN = rb"[<>]=?|[=!]=|[-+*/]|\b(?:is(?:\s+not)?|(?:not\s+)?in|and|or|m(?:in|ax)(?:imum)?)\b"
_LEFT_ALONE = ("annotation", "returns", "decorator_list")  # of any node

Lines = dict[str, dict[int, set[str]]]
"""The tests that run each line of each file."""


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
    found: list[tuple[int, int, str, str, str]] = []

    def span(node: Any) -> tuple[int, int]:
        start = begins[node.lineno - 1] + node.col_offset
        return start, begins[node.end_lineno - 1] + node.end_col_offset

    def swap(function: str, start: int, end: int) -> None:
        """The one operator or name in a stretch of the source."""
        token = re.search(_TOKEN, source[start:end])
        if token and b"#" not in source[start:end]:
            word = " ".join(token[0].decode().split())
            place = start + token.start(), start + token.end()
            found.append((*place, function, f"{word} -> {_SWAPS[word]}", _SWAPS[word]))

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
                found.append((start, start + 3, function, "not dropped", ""))
            case ast.Constant(value=bool()):
                found.append((*span(node), function, "constant", repr(not node.value)))
            case ast.Constant(value=int() | float()):
                found.append((*span(node), function, "constant", repr(node.value + 1)))
            case ast.Return(value=ast.AST()) if ast.unparse(node.value) != "None":
                found.append((*span(node.value), function, "return None", "None"))
            case ast.Expr(value=ast.Call()):
                found.append((*span(node), function, "call dropped", "pass"))
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
    for start, end, function, operator, new in sorted(found):
        row = bisect_right(begins, start)
        name = function or "<module>", operator, lines[row - 1].decode().strip()
        mutants.append(Mutant(file, *name, seen[name], row, start, end, new))
        seen[name] += 1
    return mutants


def _is_text(node: Any) -> bool:
    return isinstance(node, ast.JoinedStr) or isinstance(getattr(node, "value", None), str)


# A plugin of pytest, in the processes that run tests; what it is told is in the environment.
_TOLD = json.loads(os.environ.get("MUTANTS", "{}"))


def pytest_configure() -> None:
    """The code of this very copy, and no search for the smallest example of a law that fails."""
    from hypothesis import Phase, settings

    import companion

    assert Path(companion.__file__).is_relative_to(ROOT), "another checkout is imported"
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile("mutants", settings.get_profile("dev"), phases=phases)
    settings.load_profile("mutants")
    signal.signal(signal.SIGALRM, _late)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is wanted, in that order: cases, or whole tests."""
    order = {name: i for i, name in enumerate(_TOLD["wanted"])}

    def place(item: pytest.Item) -> int:
        name = item.nodeid.partition("::")[2]
        return order.get(name, order.get(name.partition("[")[0], -1))

    if order:
        items[:] = sorted((item for item in items if place(item) >= 0), key=place)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """A test that takes too long fails, and is the last."""
    _say(item.nodeid, "begun")
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        item.session.shouldstop = _TOLD.get("late", False)


def pytest_runtest_logreport(report: pytest.TestReport | pytest.CollectReport) -> None:
    """How it ended; a file that cannot be imported fails."""
    if report.failed or report.when == "teardown":
        _say(report.nodeid, "failed" if report.failed else "ended")


pytest_collectreport = pytest_runtest_logreport


def _late(*_: object) -> None:
    _TOLD["late"] = "it takes too long"
    pytest.fail(_TOLD["late"])


def _say(test: str, what: str) -> None:
    with Path(_TOLD["said"]).open("a", encoding="utf-8") as file:
        file.write(json.dumps([test, what, time.monotonic()]) + "\n")


# The program.
def run_tests(
    copy: Path, files: list[str], wanted: list[str], whole_s: float, *options: str
) -> list[str]:
    """The tests of some files that fail in a copy; with -x the first."""
    said = copy.with_suffix(".said")
    said.write_text("")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "mutants", "-p", "no:xdist", *options]
    command += ["-p", "no:cacheprovider", "--assert=plain", "--continue-on-collection-errors"]
    env = _environment(copy, said=str(said), wanted=wanted)
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        [*command, *files], cwd=copy, env=env, stdout=quiet, stderr=quiet, start_new_session=True
    ) as child:
        try:
            code = child.wait(whole_s)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            code = 0
    last: dict[str, tuple[str, float]] = {}
    for test, what, at_s in map(json.loads, said.read_text(encoding="utf-8").splitlines()):
        if test not in last or last[test][0] != "failed":
            last[test] = what, at_s
    if code >= 3 and not last:
        return files  # not even tests/conftest.py can be imported
    too_old = time.monotonic() - LIMIT_S if code >= 0 else math.inf  # it crashed, or never returned
    return [
        t for t, (what, s) in last.items() if what == "failed" or (what == "begun" and s < too_old)
    ]


def _environment(copy: Path, **told: object) -> dict[str, str]:
    paths = f"{copy}{os.pathsep}{copy / 'scripts'}"
    more = {"PYTHONPATH": paths, "MUTANTS": json.dumps(told), "PYTHONDONTWRITEBYTECODE": ""}
    more |= {"NUMBA_CACHE_DIR": str(SCRATCH / "numba"), "OPENBLAS_NUM_THREADS": "1"}
    return os.environ | more


class Copies:
    """A copy of the checkout for each job, in which one file at a time is another one."""

    def __init__(self, jobs: int) -> None:
        self._free: queue.Queue[Path] = queue.Queue()
        self._stamps = count(2_000_000_000)  # each mutant another: nothing that is cached fits
        skipped = shutil.ignore_patterns(".git", ".venv*", ".*_cache", "__pycache__", "runs")
        for n in range(jobs):
            copy = SCRATCH / f"copy-{n}"
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(ROOT, copy, ignore=skipped)
            warm = "from companion.runtime import compiler as c; c.load_kernel(); c.load_proof()"
            command = [sys.executable, "-c", warm]
            subprocess.run(command, cwd=copy, env=_environment(copy), check=True)
            self._free.put(copy)
        self.first = SCRATCH / "copy-0"

    @contextmanager
    def having(self, mutant: Mutant) -> Iterator[Path]:
        """A copy with the mutant in it."""
        copy, stamp = self._free.get(), next(self._stamps)
        file = copy / mutant.file
        try:
            file.write_bytes(mutant.applied(file.read_bytes()))
            os.utime(file, (stamp, stamp))
            yield copy
        finally:
            shutil.copy2(ROOT / mutant.file, file)
            self._free.put(copy)


@cache
def of_file(file: str) -> list[Mutant]:
    return mutants_of((ROOT / file).read_bytes(), file)


def _python(folder: str, pattern: str = "*.py") -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob(pattern))


def found_again(entry: dict[str, Any]) -> Mutant | None:
    """A mutant of the baseline: in its place, in another file, or in a function renamed."""
    file, function, *rest = (entry[field] for field in Mutant._fields[:5])
    here = [m for m in (of_file(file) if (ROOT / file).exists() else ()) if [*m[2:5]] == rest]
    if same := [each for each in here if each.function == function]:
        return same[0]
    moved = [m for other in _python("companion") for m in of_file(other) if [*m[2:5]] == rest]
    last = function.rpartition(".")[2]
    same = [m for m in moved if m.function.rpartition(".")[2] == last] or here
    return same[0] if len(same) == 1 else None


def drawn(part: str, lines: Lines, seconds: dict[str, float]) -> list[tuple[Mutant, list[str]]]:
    """The sample of a part with the tests to run: modules by size, operators in turn."""
    modules = []
    for file in _python(f"companion/{part}"):
        rng = random.Random(f"{SEED} {file}")
        by_operator: dict[str, list[tuple[Mutant, list[str]]]] = defaultdict(list)
        for each in of_file(file):
            if tests := _chosen(each, part, lines.get(file, {}), seconds):
                by_operator[each.operator].append((each, tests))
        groups = list(by_operator.values())
        for group in groups:
            rng.shuffle(group)
        rng.shuffle(groups)
        turns = [each for turn in zip_longest(*groups) for each in turn if each]
        first = {each.row: each for each, _ in reversed(turns)}  # one of a line
        modules.append([(each, tests) for each, tests in turns if first[each.row] is each])
    each_th = sum(map(len, modules)) / PARTS[part]
    sample = [module[: max(1, round(len(module) / each_th))] for module in modules]
    return [each for turn in zip_longest(*sample) for each in turn if each]


def _chosen(
    mutant: Mutant, part: str, lines: dict[int, set[str]], seconds: dict[str, float]
) -> list[str]:
    """The quickest tests that run its line, spread over files; those named after it first."""
    rows = lines if mutant.function == "<module>" else [mutant.row]
    runs = set().union(*(lines.get(row, ()) for row in rows))
    files = defaultdict(list)
    for test in sorted(runs - {""}, key=lambda test: (seconds[test], test)):
        slow = "path/proof" in mutant.file and "tests/path" not in test  # would compile it first
        if not slow and _COMPILES not in test:
            files[test.partition("::")[0]].append(test)
    stem = Path(mutant.file).stem
    near = sorted(files, key=lambda file: (stem not in file, f"/{part}/" not in file, file))
    spread = [t for turn in zip_longest(*(files[file] for file in near)) for t in turn if t]
    until_s = accumulate(seconds[test] for test in spread)
    return [test for test, s in zip(spread, until_s, strict=True) if s < TOGETHER_S][:MOST]


def _measured() -> tuple[Lines, dict[str, float]]:
    """Which tests run each line, measured once, and the seconds of each."""
    from coverage import CoverageData

    contexts = SCRATCH / "contexts"
    if not contexts.exists():
        command = [sys.executable, "-m", "pytest", "-q", "--assert=plain", "--cov=companion"]
        tests = [*(f"tests/{part}" for part in PARTS), *_python("tests", "test_session*.py")]
        command += ["--cov-context=test", "--cov-report=", *tests]
        env = os.environ | {"COVERAGE_FILE": str(contexts)}
        subprocess.run(command, cwd=ROOT, env=env, check=True)
    data = CoverageData(str(contexts))
    data.read()
    lines: Lines = {}
    for file in data.measured_files():
        rows = data.contexts_by_lineno(file).items()
        by_row = {row: {test.partition("|")[0] for test in tests} for row, tests in rows}
        lines[str(Path(file).relative_to(ROOT))] = by_row
    with lzma.open(BASELINE.with_name("times.csv.xz"), "rt", encoding="utf-8") as times:
        seconds = {row["test"]: float(row["seconds"]) for row in csv.DictReader(times)}
    return lines, defaultdict(lambda: 0.1, seconds)


def recorded() -> list[dict[str, Any]]:
    """What stands in the baseline."""
    return [json.loads(line) for line in BASELINE.read_text(encoding="utf-8").splitlines()]


def record(parts: list[str], jobs: int) -> None:
    """Run what is drawn and not in the baseline yet, and note which tests kill it."""
    lines, seconds = _measured()
    samples = [[(part, *each) for each in drawn(part, lines, seconds)] for part in parts]
    there = {tuple(entry[field] for field in Mutant._fields[:5]) for entry in recorded()}
    copies = Copies(jobs)

    def run(part: str, mutant: Mutant, tests: list[str]) -> dict[str, Any]:
        files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        names = [test.partition("::")[2] for test in tests]
        with copies.having(mutant) as copy:
            failed = run_tests(copy, files, names, WHOLE_S, f"--maxfail={KEPT}")
        name = dict(zip(Mutant._fields[:5], mutant[:5], strict=True))
        return {"part": part, **name, "tests": len(tests), "killers": failed}

    with ThreadPoolExecutor(jobs) as pool, BASELINE.open("a", encoding="utf-8") as file:
        turns = [each for turn in zip_longest(*samples) for each in turn if each]
        waiting = [pool.submit(run, *each) for each in turns if each[1][:5] not in there]
        for n, done in enumerate(as_completed(waiting), 1):
            file.write(json.dumps(done.result(), ensure_ascii=False) + "\n")
            file.flush()
            print(f"{n} of {len(waiting)}: {_words(done.result())}", flush=True)


def check(parts: list[str], jobs: int, whole_s: float) -> int:
    """Run all that was killed against what killed it; how many survive all tests of their part."""
    entries = [entry for entry in recorded() if entry["part"] in parts and entry["killers"]]
    texts = {file: (ROOT / file).read_text(encoding="utf-8") for file in _python("tests", "test_*")}
    copies = Copies(jobs)

    def files_of(test: str) -> list[str]:
        """The file of a test, or where one of its name is now."""
        file, _, name = test.partition("::")
        defined = f"def {name.partition('[')[0].rpartition('::')[2]}(" if name else ""
        there = [other for other, text in texts.items() if defined in text]
        return [file] if file in there else there if name else []

    def killers_of(some: list[dict[str, Any]]) -> tuple[list[str], list[str]]:
        """Files, and the tests in them: by their cases, or whole where these have other names."""
        killers = [test for entry in some for test in entry["killers"]]
        names = [name for test in killers if (name := test.partition("::")[2])]
        names += [name.partition("[")[0] for name in names]
        return list(dict.fromkeys(file for test in killers for file in files_of(test))), names

    def run(entry: dict[str, Any]) -> str:
        if (mutant := found_again(entry)) is None:
            return "gone"
        folders = [f"tests/{each}" for each in {entry["part"], *Path(mutant.file).parts[1:-1]}]
        every = [folder for folder in folders if (ROOT / folder).exists()]
        with copies.having(mutant) as copy:
            files, names = killers_of([entry])
            killed = files and run_tests(copy, files, names, WHOLE_S, "-x", *aside)
            slow = ("-k", f"not {_COMPILES}")
            killed = killed or run_tests(copy, every, [], whole_s, "-x", *slow, *aside)
        return "killed" if killed else "survived"

    aside = [f"--deselect={test}" for test in run_tests(copies.first, *killers_of(entries), 3600.0)]
    print("without a mutant", *aside or ["none fails"], flush=True)
    ends: Counter[tuple[str, str]] = Counter()
    with ThreadPoolExecutor(jobs) as pool:
        for entry, end in zip(entries, pool.map(run, entries), strict=True):
            ends[entry["part"], end] += 1
            if end != "killed":
                print(f"{end}: {_words(entry)}", flush=True)
    for part in parts:
        print(f"{part}:", ", ".join(f"{ends[part, e]} {e}" for e in ("killed", "survived", "gone")))
    return sum(ends[part, "survived"] for part in parts)


def _words(entry: dict[str, Any]) -> str:
    what = "{file} {function}: {operator}, #{nth} in `{line}`"
    return f"{what.format_map(entry)} ({len(entry['killers'])} killers)"


def main() -> None:
    """`scripts/mutants`."""
    parser = argparse.ArgumentParser(prog="scripts/mutants", description=__doc__)
    parser.add_argument("part", choices=[*PARTS, "all"])
    parser.add_argument("--record", action="store_true", help="note what is not noted yet")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, default=120.0, help="for all tests of a part")
    asked = parser.parse_args()
    parts = list(PARTS) if asked.part == "all" else [asked.part]
    if asked.record:
        record(parts, asked.jobs)
    elif survived := check(parts, asked.jobs, asked.seconds):
        sys.exit(f"{survived} mutants survive that were killed")


if __name__ == "__main__":
    main()
