"""The command that CI runs: the tests of a clone that has nothing but the commit."""

import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RUN = ROOT / ".ci" / "run"
PINS = ROOT / "requirements"
TEST = """#!/usr/bin/env bash
cd "$(dirname "$0")/.." || exit 1
{ ls -A; echo "beside: $(ls ..)"; echo "home: $(ls -A "$HOME")"; echo "options: $*"
echo "pip: $(cat "$PIP_CONFIG_FILE")"; env; } >"$SAID"
exit 7
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with our command, and a test command that notes where it is."""
    folder = tmp_path / "checkout"
    for path in (".ci", "scripts"):
        (folder / path).mkdir(parents=True)
    shutil.copy(RUN, folder / ".ci" / "run")
    (folder / "scripts" / "test").write_text(TEST, encoding="utf-8")
    (folder / "scripts" / "test").chmod(0o755)
    git = ["git", "-C", str(folder), "-c", "user.name=test", "-c", "user.email=test@localhost"]
    for command in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "All"]):
        subprocess.run([*git, *command], check=True)
    (folder / "not-committed").touch()
    (tmp_path / "shared").mkdir()
    return folder


def test_a_clone_is_tested_that_has_nothing_but_the_commit(checkout: Path, tmp_path: Path) -> None:
    home, scratch, said = tmp_path / "home", tmp_path / "scratch", tmp_path / "said.txt"
    (home / ".config" / "pip").mkdir(parents=True)
    (home / ".config" / "pip" / "pip.conf").write_text("[global]", encoding="utf-8")
    scratch.mkdir()
    own = {"HOME": str(home), "TMPDIR": str(scratch), "SAID": str(said), "VENV": "elsewhere"}
    told = {"NUMBA_CACHE_DIR": "elsewhere", "XDG_CACHE_HOME": "elsewhere"}
    kept = {k: v for k, v in os.environ.items() if k not in ("PIP_CONFIG_FILE", "XDG_CONFIG_HOME")}
    done = subprocess.run(
        [checkout / ".ci" / "run", "-k", "this"], env=kept | own | told, check=False, timeout=60
    )
    assert done.returncode == 7
    lines = said.read_text(encoding="utf-8").splitlines()
    assert lines[:3] == [".ci", ".git", "scripts"]
    assert "options: -k this" in lines
    assert {"home: ", "WITH_BROWSER=1"} <= set(lines)
    assert "pip: [global]" in lines
    assert not [line for line in lines if "elsewhere" in line or line.startswith("VENV=")]
    assert "shared" not in "".join(lines[3:6])
    assert list(scratch.iterdir()) == []  # nothing is left behind


def test_who_may_not_install_a_browser_is_told_what_is_missing(tmp_path: Path) -> None:
    for name, says in (("id", "1000"), ("apt-get", "")):
        (tmp_path / name).write_text(f"#!/bin/sh\necho {says}\n", encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    done = subprocess.run(
        [shutil.which("bash") or "bash", "-c", f". {RUN.parents[1]}/scripts/setup-browser.sh"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert "apt-get install chromium" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.nightly  # pytest and xdist are pinned
def test_tests_of_one_group_are_run_by_one_worker(tmp_path: Path) -> None:
    """With pytest 9.2 they are not, and nothing says so: flights are then flown once a worker."""
    for name in ("one", "two"):
        (tmp_path / f"test_{name}.py").write_text(
            "import pytest\n"
            "@pytest.mark.parametrize('n', [\n"
            "    pytest.param(n, marks=pytest.mark.xdist_group(str(n))) for n in range(9)])\n"
            "def test_it(n): pass\n",
            encoding="utf-8",
        )
    options = ("-n", "2", "--dist", "loadgroup", "-v", "-p", "no:cacheprovider")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, tmp_path],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    workers: dict[str, set[str]] = {}
    for worker, number in re.findall(r"\[(gw\d)\].* PASSED .*\[(\d)\]", done.stdout):
        workers.setdefault(number, set()).add(worker)
    assert [len(each) for each in workers.values()] == [1] * 9
    assert set.union(*workers.values()) == {"gw0", "gw1"}


WITHOUT_DEVELOPERS = """
import sys
class Refuses:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuses())
{compiles}
import {modules}
"""


@pytest.mark.parametrize(
    ("wanted", "modules"),
    [
        ("fly", "companion.cli, vehicle_sim.server"),
        ("view", "companion.live_view.server"),
        ("campaign", "companion.campaign.store, distributed, pyarrow"),
        ("compare", "ompl"),
    ],
)
def test_a_clone_is_set_up_with_what_its_user_needs(wanted: str, modules: str) -> None:
    pins = {
        name: set(re.findall(r"^([\w.-]+)==", (PINS / f"{name}.txt").read_text("utf-8"), re.M))
        for name in ("dev", wanted)
    }
    only = pins["dev"] - pins[wanted]
    assert {"pytest", "hatchling"} <= only
    assert "viser" in only or wanted == "view"
    names = {
        module
        for module, distributions in packages_distributions().items()
        if {each.lower().replace("_", "-") for each in distributions} <= only
    }
    assert "pytest" in names
    setup = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    [compiles] = re.findall(r"^compiles='(.*?)\n[^\n]*load_proof\(\)'$", setup, re.M | re.S)
    program = WITHOUT_DEVELOPERS.format(names=names, compiles=compiles, modules=modules)
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=120)
