"""What is released: built, installed where no checkout is, and used by an ordinary user."""

import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
import zipfile
from collections.abc import Iterator
from importlib.metadata import Distribution
from pathlib import Path

import pytest
from flights import one_target
from pages import needed
from programs import ROOT, Program, free_port

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OURS = ("companion", "vehicle_sim")
NOBODY = "65534"
"""An ordinary user, for a suite that is run by root."""
AS_NOBODY = (
    *("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"),
    *("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"),  # reads root's checkout
)
pytestmark = pytest.mark.xdist_group("release")


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A folder that everybody may enter: pytest's own are closed to other users."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture(scope="module")
def built(folder: Path) -> Path:
    """The folder of a source distribution, and of a wheel that is built from nothing else."""
    hatchling = [sys.executable, "-m", "hatchling", "build", "-d", str(folder / "dist"), "-t"]
    subprocess.run([*hatchling, "sdist"], cwd=ROOT, check=True, capture_output=True)
    [source] = (folder / "dist").glob("*.tar.gz")
    (folder / "source").mkdir()
    subprocess.run(["tar", "-xf", source, "-C", folder / "source"], check=True)
    [tree] = (folder / "source").iterdir()
    subprocess.run([*hatchling, "wheel"], cwd=tree, check=True, capture_output=True)
    return folder / "dist"


def files(root: Path, *parts: str) -> set[str]:
    """What lies below these folders, without what Python leaves there."""
    return {
        path.relative_to(root).as_posix()
        for part in parts
        for path in (root / part).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_wheel_has_both_packages_with_all_their_data_and_nothing_else(built: Path) -> None:
    [wheel] = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        names = {name for name in packed.namelist() if ".dist-info/" not in name}
        about = {name.partition(".dist-info/")[2] for name in packed.namelist()}
    assert names == files(ROOT, *OURS)
    assert {"licenses/LICENSE", "licenses/THIRD-PARTY.md", "entry_points.txt"} <= about
    kinds = {Path(name).suffix for name in names}
    assert {".toml", ".tif", ".j2", ".parm", ".typed"} <= kinds


def test_the_source_distribution_has_what_the_suite_needs(built: Path, folder: Path) -> None:
    del built
    [tree] = (folder / "source").iterdir()
    for part in (*OURS, "scripts", "docs", ".ci"):
        assert files(tree, part) == files(ROOT, part)
    missing = files(ROOT, "tests") - files(tree, "tests")
    assert not {name for name in missing if "/.unpacked/" not in name}
    assert {"README.md", "CHANGELOG.md", "LICENSE", "requirements/dev.txt"} <= files(tree, ".")


def top_level(package: Distribution) -> set[Path]:
    """The files and folders of a package in the folder that it is installed in."""
    names = {each.parts[0] for each in package.files or () if each.parts[0] != ".."}
    return {Path(str(package.locate_file(name))) for name in names - {"__pycache__"}}


@pytest.fixture(scope="module")
def installed(built: Path, folder: Path) -> Path:
    """A fresh environment with the wheel, and exactly what the project says that it needs.

    No extra: as somebody has it who installs the bare project.
    """
    environment = folder / "environment"
    venv.create(environment, symlinks=True)
    [packages] = environment.glob("lib/python*/site-packages")
    for package in needed(PROJECT["dependencies"]).values():
        for path in top_level(package):
            if not (packages / path.name).exists():
                (packages / path.name).symlink_to(path)
    pip = [sys.executable, "-m", "pip", f"--python={environment}/bin/python", "install", "-q"]
    [wheel] = built.glob("*.whl")
    command = [*pip, "--no-deps", "--no-index", "--disable-pip-version-check", str(wheel)]
    subprocess.run(command, check=True)
    return environment / "bin"


class OrdinaryUser:
    """Somebody with a home that is read-only and a folder to work in."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self.programs, self.work, home = programs, folder / "work", folder / "home"
        home.mkdir(mode=0o555)
        self.work.mkdir(mode=0o700)
        self.prefix = AS_NOBODY if os.geteuid() == 0 else ()
        if self.prefix:
            os.chown(self.work, int(NOBODY), int(NOBODY))
        kept = {"PATH": os.environ["PATH"], "LANG": "C.UTF-8"}
        self.environment = {**kept, "HOME": str(home), "TMPDIR": str(self.work)}

    def starts(self, program: str, *arguments: str) -> Program:
        command = (*self.prefix, self.programs / program, *arguments)
        return Program(program, *command, folder=self.work, environment=self.environment)

    def runs(self, program: str, *arguments: str) -> str:
        """What a program prints that ends well."""
        started = self.starts(program, *arguments)
        try:
            assert started.wait(300.0) == 0, started.transcript  # it may compile
        finally:
            started.end()
        return started.transcript


@pytest.fixture(scope="module")
def user(folder: Path, installed: Path) -> OrdinaryUser:
    return OrdinaryUser(folder, installed)


@pytest.mark.parametrize("program", ["companion", "vehicle-sim"])
def test_both_programs_say_their_version(user: OrdinaryUser, program: str) -> None:
    assert user.runs(program, "--version").split() == [PROJECT["version"]]


@pytest.mark.closed_loop
def test_an_ordinary_user_flies_replays_and_reports(user: OrdinaryUser) -> None:
    """With a read-only home: nothing that is said sounds like a fault."""
    load = "from companion.runtime.compiler import load_kernel; load_kernel()"
    user.runs("python", "-c", load)  # the simulator has little patience
    port = free_port()
    quick = one_target().replace("[planner]\n", "[planner]\nevaluations = 200\n")
    (user.work / "mission.toml").write_text(quick, encoding="utf-8")
    simulator = user.starts(
        "vehicle-sim", "sitl-arducopter", "--lockstep", f"--connect=udpout:127.0.0.1:{port}"
    )
    flown = "fly", "mission.toml", "--lockstep", f"--connect=udpin:127.0.0.1:{port}", "--out=flight"
    try:
        said = user.runs("companion", *flown)
        assert simulator.wait(60.0) == 0, simulator.transcript
    finally:
        simulator.end()
    said += user.runs("companion", "replay", "flight")
    said += user.runs("companion", "report", "flight")
    assert not re.search("warn|error|traceback|cache", said, re.IGNORECASE), said
    flight = user.work / "flight"
    assert json.loads((flight / "run.json").read_text("utf-8"))["companion"] == PROJECT["version"]
    assert (flight / "flight.png").stat().st_size > 0
    assert "</html>" in (flight / "report.html").read_text("utf-8")


def test_every_package_that_is_needed_is_in_the_notices() -> None:
    page = (ROOT / "THIRD-PARTY.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| ([\w-]+) \| (?!not stated)\S", page, re.MULTILINE))
    extras = [each for every in PROJECT["optional-dependencies"].values() for each in every]
    assert set(needed(PROJECT["dependencies"] + extras)) <= named, "run scripts/docs"
