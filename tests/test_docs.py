"""The pages of docs/ and the README: their commands are valid, and their links lead somewhere."""

import re
import shlex
import subprocess
from pathlib import Path

import lines
import pytest
import typer
from answers import answered
from pages import PAGES as MADE
from pages import page_of
from recorded import run_folder
from recordings import recording

from companion.cli import app
from companion.config import bundled
from companion.mavlink.autopilots import ALL
from companion.runtime.connection import parsed
from vehicle_sim.cli import app as simulator_app
from vehicle_sim.cli import bundled_worlds
from vehicle_sim.links import parse_endpoint

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "tests/recordings/README.md", *(ROOT / "docs").rglob("*.md")]
)
PROGRAMS = ("companion", "vehicle-sim")
PLACEHOLDERS = re.compile(r"[A-Z][A-Z_.]*|(hill/)?(mission|world)\.toml|\S+\.plan")
"""Words that stand for what the reader puts in their place."""
ELSEWHERE = {"offboard.md"}
"""A page of PX4's own documentation."""


def commands() -> list[tuple[str, str]]:
    """Page and line of each command for one of our programs in a block of code."""
    found = set()
    for page in PAGES:
        blocks = re.findall(r"^```\w*\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
        for line in "".join(blocks).splitlines():
            for part in re.split(r"\s#\s|\s{4,}|;", line.replace("ExecStart=", "")):
                program = part.strip().split(" ")[0].rsplit("/", 1)[-1]
                if program in PROGRAMS and part.strip() != program:
                    found.add((page.name, part.strip()))
    return sorted(found)


@pytest.mark.parametrize(("page", "line"), commands())
def test_a_command_of_the_docs_is_understood(page: str, line: str) -> None:
    """Parsed as the program would; nothing is run."""
    del page
    program, *words = shlex.split(line)
    if program == "vehicle-sim":
        given = typer.main.get_command(simulator_app).make_context(program, words).params
        for address in given["connect"] or []:
            parse_endpoint(address)
        named, known = given["world"], list(bundled_worlds())
    else:
        command = typer.main.get_command(app)
        while isinstance(command, typer.core.TyperGroup):
            command = command.commands[words.pop(0)]
        if words == ["--help"]:
            return
        given = command.make_context(program, words).params
        address = given.get("connect", "ADDRESS")
        if address not in (None, "ADDRESS"):
            parsed(address)
        named, known = given.get("mission"), bundled()
    assert named is None or named in known or PLACEHOLDERS.fullmatch(named), named


PROGRAM = (
    r"(?:companion|vehicle-sim|python|scripts/\w+|build/\S+|cd|ls|make|mavproxy\.py|pip|printf"
    r"|sim_vehicle\.py|sudo)"
)
TOML = r"^```toml\n(.*?)^```"
SHELL = re.compile(rf"(?:\$ )?((?:\w+=\S+ )*{PROGRAM}(?: .*?)?)(?:\s+#\s.*)?")
NOT_RUN = {
    r"companion (fly|preflight) ": "needs a vehicle: closed_loop/ and runtime/ have simulated ones",
    r"companion view ": "until Ctrl-C, for a browser: live_view/",
    r"companion campaign ": "takes minutes to hours: tests of companion/campaign run small ones",
    r"companion compare ": "takes minutes: compare/ computes a part of it",
    r"companion replay (RUN_DIR|runs/)": "of a whole flight: test_release and closed_loop/",
    r"vehicle-sim": "until its client leaves: vehicle_sim/ and interop/",
    r"scripts/fly": "sets a clone up: test_ci; its flight: closed_loop/",
    r"(sim_vehicle\.py|mavproxy\.py|make|build/\S+|PX4_\S+) ": "programs of others: interop/",
    r"(sudo|ls|printf|pip) ": "about the reader's own computer",
    r"scripts/conformance ": "takes minutes: vehicle_sim/",
}
"""Commands that are not executed as they stand on the pages, and why."""


def shell_commands() -> set[str]:
    """Each command of a block of code, without its comment."""
    blocks = [
        block
        for page in PAGES
        for block in re.findall(r"^```\w*\n.*?^```", page.read_text(encoding="utf-8"), re.M | re.S)
        if block.startswith("```\n")
    ]
    found = (SHELL.fullmatch(line) for line in "".join(blocks).splitlines())
    return {each[1].strip() for each in found if each}


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_folder(tmp_path_factory.mktemp("flight"))


@pytest.mark.xdist_group("commands of the pages")
@pytest.mark.parametrize(
    "line", sorted(e for e in shell_commands() if not any(re.match(r, e) for r in NOT_RUN))
)
def test_a_command_of_the_pages_does_what_it_says(
    line: str, flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = str(recording("px4-gps-loss.tlog"))
    meant = {"RUN_DIR": str(flight), "MISSION": "sitl-px4", "LOG": log, "FILE": log}
    words = [meant.get(word, log if word == "flight.bin" else word) for word in shlex.split(line)]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hill").mkdir()
    files = {"README.md": ["mission"], "docs/first-flight.md": ["hill/world", "hill/mission"]}
    for page, names in files.items():
        text = (ROOT / page).read_text(encoding="utf-8")
        for name, block in zip(names, re.findall(TOML, text, re.M | re.S), strict=True):
            (tmp_path / f"{name}.toml").write_text(block, encoding="utf-8")
    code, shown, said = answered(*words[1:])
    assert code == 0, (shown, said)
    assert shown.strip()


def texts() -> list[tuple[Path, str]]:
    """Everything that people wrote in this repository."""
    folders = ("companion", "vehicle_sim", "tests", "scripts", "docs", ".ci")
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    paths += [path for path in ROOT.iterdir() if path.suffix in (".md", ".toml")]
    written = [
        path
        for path in paths
        if path.suffix in (".py", ".md", ".toml", ".sh", "")
        and not {"__pycache__", ".unpacked"} & set(path.parts)
    ]
    return [(path, path.read_text(encoding="utf-8")) for path in sorted(written)]


def test_every_page_that_is_named_is_in_the_repository() -> None:
    pages = {path.name for path, _ in texts() if path.suffix == ".md"} | ELSEWHERE
    for path, text in texts():
        assert set(re.findall(r"[\w-]+\.md\b", text)) <= pages, path


def test_every_file_that_engineers_are_sent_to_is_there() -> None:
    for page in ("CONTRIBUTING.md", "docs/architecture.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        places = r"`((?:companion|vehicle_sim|tests|scripts|requirements|docs)/[\w./-]*)`"
        named = re.findall(places, text.partition("## Budget")[0])
        assert named
        assert [each for each in named if not (ROOT / each).exists()] == [], page


def test_the_deciding_path_is_read_in_an_afternoon() -> None:
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    path = re.findall(r"^\d+\. `([\w/.]+)`", page, re.M)
    files = [(ROOT / "companion" / each).read_text("utf-8") for each in path]
    assert len(files) == 14
    assert sum(len(each.splitlines()) for each in files) < 5000


def test_nothing_names_a_place_outside_the_repository() -> None:
    beside = "sha" + "red"  # this page says it itself
    outside = re.compile(rf"\.\./{beside}|{beside}/(telemetry|reference)|/wo[r]k/|/roo[t]/")
    for path, text in texts():
        assert outside.search(text) is None, path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_links_of_a_page_lead_to_files_and_headings(page: Path) -> None:
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        target, _, anchor = link.partition("#")
        there = page.parent / target if target else page
        assert "://" in link or there.exists(), link
        if anchor and there.suffix == ".md":
            heads = re.findall(r"^#+ (.*)", there.read_text(encoding="utf-8"), re.M)
            assert anchor in {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in heads}


def test_what_is_added_beyond_the_budget_fails_the_checks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a checkout of one file: at what its row allows, and one line beyond."""
    for folder in ("docs", "companion/path"):
        (tmp_path / folder).mkdir(parents=True)
    rows = "| core | `companion/path` | 1,001 |\n| rest | `companion/` | 0 |\n"
    (tmp_path / "docs" / "architecture.md").write_text(rows, encoding="utf-8")
    added = tmp_path / "companion" / "path" / "added.py"
    added.write_text("\n" * 1001, encoding="utf-8")
    for command in (["init", "-q"], ["add", "-A"]):
        subprocess.run(["git", "-C", str(tmp_path), *command], check=True)
    monkeypatch.setattr(lines, "ROOT", tmp_path)
    assert lines.main() == 0
    added.write_text("\n" * 1002, encoding="utf-8")
    assert lines.main() == 1
    assert capsys.readouterr().err.startswith("budget: core = 1,002: 1,001 are allowed")


def test_missions_for_simulations_and_parameters_that_are_judged_are_on_the_page() -> None:
    pages = ("connecting.md", "reference/parameters.md")
    page = "".join((ROOT / "docs" / each).read_text(encoding="utf-8") for each in pages)
    names = {name for name in bundled() if name.startswith("sitl-")}
    names |= {rule.name for each in ALL for rule in each.rules if rule.check}
    assert {name for name in names if f"`{name}`" not in page} == set()


@pytest.mark.parametrize("name", [name for name in MADE if name.startswith("docs/")])
def test_the_pages_that_are_made_from_the_code_are_up_to_date(name: str) -> None:
    page = (ROOT / f"{name}.md").read_text(encoding="utf-8")
    assert page == page_of(name), "run scripts/docs"


def test_the_register_of_laws_names_every_file_of_tests_once() -> None:
    tests = ROOT / "tests"
    named = re.findall(r"[\w/]*test_\w+(?=[,\s|])", (tests / "LAWS.md").read_text("utf-8"))
    there = (path.relative_to(tests).with_suffix("") for path in tests.rglob("test_*.py"))
    assert sorted(named) == sorted(path.as_posix() for path in there)
