"""What a replay was not asked properly, or not given whole, it says in one line: never a traceback,
and never that nothing is the same as something."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import missions
import pytest
from answers import answered
from documents import HEIGHTS_M, terrain
from recorded import short_mission
from short_flight import fly_short, rewritten

from companion.config import load_mission
from companion.mission.journal import VERSION
from companion.replay import actions
from companion.replay.feed import DamagedInputError, Feeder
from companion.telemetry.inputs import FILE, HEADER, Input, InputsFile, packed

Damage = Callable[[Path], object]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("refused") / "run"
    fly_short(path, until_s=33.0)
    return path


@pytest.fixture
def run(run_dir: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


def test_a_run_folder_of_an_older_version_is_told_who_reads_it_and_left_as_it_is(run: Path) -> None:
    path = run / "journal.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"version":%d' % VERSION, b'"version":2', 1))
    before = {file: file.read_bytes() for file in run.iterdir()}
    rule = "an older companion has recorded it: its journal is of version 2"
    for command in (
        *("replay RUN", "replay RUN --seed 3", "report RUN", "view RUN --view-port 0"),
        "fly environment-1 --out RUN --resume",
    ):
        code, _, said = answered(*(run if word == "RUN" else word for word in command.split()))
        expected = f"error: RUN_DIR = '{run}': {rule}. Use companion 0.2.0 for it.\n"
        assert (code, said) == (2, expected)
    assert {file: file.read_bytes() for file in run.iterdir()} == before


# --- what is damaged


def empty(*names: str) -> Damage:
    return lambda run: [(run / name).write_bytes(b"") for name in names]


def changed(name: str, change: Callable[[bytes], bytes]) -> Damage:
    return lambda run: (run / name).write_bytes(change((run / name).read_bytes()))


def inputs_end_with(change: Callable[[bytes], bytes]) -> Damage:
    """From an input in their midst on there is something else: made of what was there."""

    def damage(run: Path) -> None:
        data = (run / FILE).read_bytes()
        whole = sum(map(len, packed((HEADER, *list(InputsFile(run / FILE))[:150]))))
        (run / FILE).write_bytes(data[:whole] + change(data[whole:]))

    return damage


ENDS_EARLY = "the recording ends early: .*\nidentical\n"  # as a power cut or a kill leaves it
NO_INPUTS = inputs_end_with(lambda rest: b"\xc1" + rest)
OTHERS = packed([("companion-inputs", 99)])[0]
GARBAGE = changed("flight.tlog", lambda data: data[:2000] + b"\0\1" * 1000 + data[4000:])
ODD_LINE = changed("journal.jsonl", lambda text: re.sub(rb"\A((?:.*\n){5}).*", rb"\1?", text))
WAS, IS = b'"kind":"phase","phase":"preparing"', b'"kind":"phase","phase":"landing"'
PHASE = changed("journal.jsonl", lambda text: text.replace(WAS, IS, 1))
NO_ANSWER: Input = ("deliver", {"kind": "planned"})
DAMAGES: dict[str, tuple[Damage, int, str]] = {
    "nothing": (empty("flight.tlog", "journal.jsonl"), 2, "it holds nothing to compare a replay"),
    "no file of inputs": (lambda run: (run / FILE).unlink(), 2, "RUN_DIR = .*cannot be read"),
    "no inputs": (empty(FILE), 2, "it does not begin like the inputs of a flight"),
    "other inputs": (changed(FILE, lambda _: OTHERS), 2, "reads version 1"),
    "another phase": (PHASE, 1, "phase.phase: recorded 'landing', replayed 'preparing'"),
    "no frame": (empty("flight.tlog"), 0, "no frame was compared: flight.tlog holds none"),
    "a line that is no JSON": (ODD_LINE, 1, "kind: recorded b'.\\\\n'.*Companion .* flew"),
    "garbage in the log": (GARBAGE, 2, "up to there.* bytes of flight.tlog that are no"),
    "garbage in the inputs": (NO_INPUTS, 2, "identical up to there.*bytes that are no inputs"),
    "a hole": (inputs_end_with(lambda _: bytes(5000)), 0, ENDS_EARLY),
    "a torn input": (inputs_end_with(lambda rest: rest[:9]), 0, ENDS_EARLY),
    "a damaged input": (
        lambda run: rewritten(run, lambda told: told.__setitem__(200, NO_ANSWER)),
        2,
        "identical up to there.*RUN_DIR = .*is damaged .an answer of the planner that is none",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_a_difference_or_an_error_of_one_line(run: Path, damage: str) -> None:
    """Never is nothing the same as something; what came before the damage is compared."""
    change, expected, words = DAMAGES[damage]
    change(run)
    code, out, said = answered("replay", run, "--no-plans")
    errors = [line for line in said.splitlines() if "error:" in line]
    assert (code, len(errors)) == (expected, expected > 0)
    assert re.search(words, "\n".join([out, *errors]), flags=re.DOTALL)
    assert damage != "nothing" or "identical" not in out


@pytest.mark.parametrize(("options", "named"), [
    ("--no-plans", "--plans"), ("--profile paper --shadow", "--profile"),
    ("--no-plans --set planner.seed=1", "--plans"),
])  # fmt: skip
def test_an_option_that_is_of_no_use_is_refused_in_one_line(options: str, named: str) -> None:
    code, _, said = answered("replay", missions.MISSION, *options.split())
    assert (code, said.count("\n"), said.split(" = ")[0]) == (2, 1, f"error: {named}")


NO_TOLD: list[Input] = [
    *[("deliver", each) for each in (None, {}, {"plan_id": 1, "kind": "?"})],
    *[("silence", each) for each in (None, float("nan"), True)],
    *[("receive", b"", float("nan")), ("receive", "x", 1.0), ("run", 1), ("nothing of the kind",)],
]
NO_STARTS = ({"seed": "x"}, {"system_id": 0}, {"resume": 5}, {"odd": 1}, {"profile": "x"})


def test_what_is_nothing_that_a_session_is_told_is_named(run_dir: Path) -> None:
    feeder = Feeder(lambda _: load_mission("valley"))
    start = next(iter(InputsFile(run_dir / FILE)))
    feeder.take(start)
    for told in NO_TOLD:
        with pytest.raises(DamagedInputError):
            feeder.take(told)
    for change in NO_STARTS:
        with pytest.raises(DamagedInputError, match="a start that is none"):
            feeder.take((start[0], {**start[1], **change}))


def test_an_elevation_file_that_has_changed_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, file = tmp_path / "run", tmp_path / "dem.tif"
    terrain(file)
    text = short_mission(terrain={"file": str(file), "vertical_datum": "EGM96"})
    fly_short(path, text=text, until_s=5.0)
    assert answered("replay", path, "--no-plans")[0] == 0
    terrain(file, HEIGHTS_M + 10)
    monkeypatch.setattr(actions, "load_kernel", lambda: pytest.fail("it is compiled in vain"))
    for option in (["--no-plans"], ["--seed", 3]):  # what if, too
        code, out, said = answered("replay", path, *option)
        assert (code, said.count("error:"), "first difference" in out) == (2, 1, False)
        assert f"terrain.file = '{file}': the elevation file has changed since the flight" in said
        assert "Put the file of the flight there, or name it in " in said
