import subprocess
import sys
from pathlib import Path

import pytest

COMPANION = Path(sys.executable).parent / "companion"
HILLS = Path(__file__).parent / "closed_loop" / "hills"


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMPANION, *arguments], capture_output=True, text=True, check=False, timeout=60
    )


def test_check_says_in_words_what_a_mission_will_do() -> None:
    done = run("check", "environment-1")
    assert (done.returncode, done.stderr) == (0, "")
    for fact in ("100 km north, 100 km east", "150 m/s", "3 km and 5 km AMSL", "500 m (d_s)"):
        assert fact in done.stdout


def test_plan_reaches_the_target_and_writes_a_picture(tmp_path: Path) -> None:
    picture = tmp_path / "plan.png"
    done = run("plan", HILLS / "world.toml", HILLS / "mission.toml", "--out", picture)
    assert (done.returncode, done.stderr) == (0, "")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "subpaths" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fly", "nowhere"), "MISSION = 'nowhere'"),
        (("fly", "environment-1", "--connect", "tcp:1"), "--connect = 'tcp:1'"),
        (("fly", "environment-1", "--seed", "-1"), "--seed"),
        (("fly", "environment-1", "--profile", "bold"), "--profile"),
        (("fly", "environment-1", "environment-2"), "environment-2"),
        (("plan", str(HILLS / "world.toml"), "environment-1", "--out", "/nowhere/x.png"), "--out"),
        (("check", str(HILLS / "world.toml")), "this is a world"),
    ],
    ids=lambda value: value[-1] if isinstance(value, tuple) else "",
)
def test_wrong_input_is_one_line_and_exit_code_2(arguments: tuple[str, ...], words: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")
    assert words in done.stderr


@pytest.mark.parametrize("command", ["fly", "plan", "check"])
def test_every_command_has_a_page_of_help(command: str) -> None:
    done = run(command, "--help")
    assert done.returncode == 0
    assert "MISSION" in done.stdout
