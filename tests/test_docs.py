"""The pages of docs/ and the README are true: their commands work, and what they name is there."""

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
ELSEWHERE = {"offboard.md"}
"""A page of PX4's own documentation."""
PLACEHOLDERS = re.compile(r"[A-Z][A-Z_.]*|(hill/)?(mission|world)\.toml|\S+\.plan")
"""Words that stand for what the reader puts in their place."""
OURS = re.compile(r"(?:\S+/)?(companion|vehicle-sim) .+")
NOT_RUN = {
    r"companion (fly|preflight) ": "needs a vehicle: closed_loop/ and runtime/ have simulated ones",
    r"companion view ": "until Ctrl-C, for a browser: live_view/",
    r"companion (campaign|compare) ": "takes minutes to hours: campaign/ and paper/ do a part",
    r"companion replay RUN_DIR": "of a whole flight: test_release and closed_loop/",
    r"companion replay (FILE|flight.bin)": "as it is of a LOG",
    r"vehicle-sim": "until its client leaves: vehicle_sim/ and interop/",
}
"""Commands of the pages that are parsed and not executed, and why."""


def text_of(name: str | Path) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def commands() -> list[str]:
    """Each command for one of our programs in a block of code of a page."""
    found = set()
    for page in PAGES:
        blocks = re.findall(r"^```\w*\n(.*?)^```", text_of(page), re.M | re.S)
        for line in "".join(blocks).splitlines():
            for part in re.split(r"\s#\s|\s{4,}|;", line.replace("ExecStart=", "")):
                if OURS.fullmatch(part.strip()):
                    found.add(part.strip())
    return sorted(found)


def is_parsed(program: str, words: list[str]) -> None:
    """As the program would; nothing is run."""
    if program == "vehicle-sim":
        given = typer.main.get_command(simulator_app).make_context(program, words).params
        for address in given["connect"] or []:
            parse_endpoint(address)
        named, known = given["world"], list(bundled_worlds())
    else:
        command = typer.main.get_command(app)
        while isinstance(command, typer.core.TyperGroup):
            command = command.commands[words.pop(0)]
        given = command.make_context(program, words).params
        if (address := given.get("connect", "ADDRESS")) != "ADDRESS":
            parsed(address)
        named, known = given.get("mission"), bundled()
    assert named is None or named in known or PLACEHOLDERS.fullmatch(named), named


@pytest.mark.xdist_group("commands of the pages")
@pytest.mark.parametrize("line", commands())
def test_a_command_of_the_pages_does_what_it_says(
    line: str, copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, *words = shlex.split(line)
    if any(re.match(pattern, line) for pattern in NOT_RUN):
        return is_parsed(program, words)
    log = str(recording("px4-gps-loss.tlog"))
    meant = {"RUN_DIR": str(copy), "MISSION": "sitl-px4", "LOG": log}
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hill").mkdir()
    files = {"README.md": ["mission"], "docs/first-flight.md": ["hill/world", "hill/mission"]}
    for page, names in files.items():
        blocks = re.findall(r"^```toml\n(.*?)^```", text_of(page), re.M | re.S)
        for name, block in zip(names, blocks, strict=True):
            (tmp_path / f"{name}.toml").write_text(block, encoding="utf-8")
    code, shown, said = answered(*(meant.get(word, word) for word in words))
    assert code == 0, (shown, said)
    assert shown.strip()


def test_every_command_is_shown_on_a_page() -> None:
    known, text = typer.main.get_command(app), "".join(map(text_of, PAGES))
    assert isinstance(known, typer.core.TyperGroup)
    assert [name for name in known.commands if f"companion {name} " not in text] == []


def test_what_is_named_anywhere_is_in_the_repository_and_nothing_beside_it() -> None:
    """Every page that is named, and every file that a page links to or sends engineers to."""
    written = [path for path in ROOT.iterdir() if path.suffix in (".md", ".toml")]
    for folder in ("companion", "vehicle_sim", "tests", "scripts", "docs", ".ci"):
        found = (path for path in (ROOT / folder).rglob("*") if path.is_file())
        found = (path for path in found if path.suffix in (".py", ".md", ".toml", ".sh", ""))
        written += [p for p in found if not {"__pycache__", ".unpacked"} & set(p.parts)]
    pages = {path.name for path in written if path.suffix == ".md"} | ELSEWHERE
    beside = "sha" + "red"  # this page says it itself
    outside = re.compile(rf"\.\./{beside}|{beside}/(telemetry|reference)|/wo[r]k/|/roo[t]/")
    for path in written:
        text = path.read_text(encoding="utf-8")
        assert set(re.findall(r"[\w-]+\.md\b", text)) <= pages, path
        assert outside.search(text) is None, path
    for path in PAGES:
        for link in re.findall(r"\]\(([^)]+)\)", text_of(path)):
            target, _, anchor = link.partition("#")
            there = path.parent / target if target else path
            assert "://" in link or there.exists(), (path, link)
            if anchor and there.suffix == ".md":
                heads = re.findall(r"^#+ (.*)", text_of(there), re.M)
                heads = [re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads]
                assert anchor in heads, (path, link)
    for name in ("CONTRIBUTING.md", "docs/architecture.md"):
        places = r"`((?:companion|vehicle_sim|tests|scripts|requirements|docs)/[\w./-]*)`"
        named = re.findall(places, text_of(name).partition("## Budget")[0])
        assert named
        assert [each for each in named if not (ROOT / each).exists()] == [], name


def test_the_deciding_path_is_read_in_an_afternoon() -> None:
    path = re.findall(r"^\d+\. `([\w/.]+)`", text_of("docs/architecture.md"), re.M)
    assert len(path) == 14
    assert sum(text_of(f"companion/{each}").count("\n") for each in path) < 5000


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
    names = {name for name in bundled() if name.startswith("sitl-")}
    names |= {rule.name for each in ALL for rule in each.rules if rule.check}
    page = text_of("docs/connecting.md") + text_of("docs/reference/parameters.md")
    assert {name for name in names if f"`{name}`" not in page} == set()


@pytest.mark.parametrize("name", [name for name in MADE if name.startswith("docs/")])
def test_the_pages_that_are_made_from_the_code_are_up_to_date(name: str) -> None:
    assert text_of(f"{name}.md") == page_of(name), "run scripts/docs"


def test_the_register_of_laws_names_every_file_of_tests_once() -> None:
    tests = ROOT / "tests"
    named = re.findall(r"[\w/]*test_\w+(?=[,\s|])", text_of("tests/LAWS.md"))
    there = (path.relative_to(tests).with_suffix("") for path in tests.rglob("test_*.py"))
    assert sorted(named) == sorted(path.as_posix() for path in there)
