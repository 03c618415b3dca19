"""The frame of the benchmarks: parameters are options, rows are Markdown, bars are held."""

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr
from pathlib import Path
from typing import Literal

import pytest
import running
from running import Found, least, main, most


def measured(
    flights: int = 2,
    world: Literal["forest", "street"] = "forest",
    rates: tuple[float, ...] = (20.0, 200.0),
    only: tuple[Literal["a", "b"], ...] = ("a", "b"),
    idle: bool = False,
) -> Found:
    """A benchmark."""
    yield "a title"
    for number in range(flights):
        yield {"flight": f"{world}-{number}", "m|.1f": 0.25 * number, "why": None}
    yield [rates, only, idle]
    yield most("metres", 0.25 * (flights - 1), 0.5)
    yield least("flights", flights, 1)


def run(*words: str) -> tuple[object, str, str]:
    """Its exit code, what it prints, and what it says of errors."""
    shown, said = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stderr(said):
        patch.setattr(running, "CONSOLE", running.Console(file=shown, width=100))
        patch.setattr(sys, "argv", ["bench", *words])
        with pytest.raises(SystemExit) as ended:
            main(measured)
    return ended.value.code, shown.getvalue(), said.getvalue()


def test_parameters_are_options_and_what_is_yielded_is_printed_and_written(tmp_path: Path) -> None:
    path = tmp_path / "found.json"
    words = "--world street --rates 5 --only b --idle --flights 3 --json"
    code, shown, _ = run(*words.split(), str(path))
    assert not code
    found = json.loads(path.read_text(encoding="utf-8"))
    assert [row["flight"] for row in found["rows"]] == ["street-0", "street-1", "street-2"]
    assert [row["m"] for row in found["rows"]] == [0.0, 0.25, 0.5]
    assert found["found"] == [[[5.0], ["b"], True]]
    assert found["bars"] == [["metres", "0.5", "0.5", True], ["flights", "1 or more", "3", True]]
    lines = {line.replace(" ", "") for line in shown.splitlines()}
    assert {"atitle", "|flight|m|why|", "|street-2|0.5||", "|metres|0.5|0.5|met|"} <= lines


def test_a_missed_bar_and_a_word_that_is_none_of_the_choices_end_it_with_a_code() -> None:
    assert run("--flights", "9")[0] == 1
    code, _, said = run("--only", "c")
    assert code == 2
    assert "invalid choice: 'c'" in said


IMPORT = """
import runpy, sys
from pathlib import Path
sys.path[0] = "scripts/benchmarks"
for file in sorted(Path(sys.path[0]).glob("*.py")):
    runpy.run_path(str(file), run_name="imported")
"""


def test_every_benchmark_finds_what_it_imports_where_the_paths_of_pytest_are_not_set() -> None:
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", IMPORT], cwd=root, check=True, timeout=300)
