"""What is released: built, installed where no checkout is, and used by an ordinary user.

And a clone is set up by `scripts/setup.sh` with what its user needs, and nothing is missing.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
import zipfile
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from flights import one_target, warm_up
from numba.core.caching import _CacheLocator
from pages import needed
from programs import ROOT, Program, free_port

from companion import jit

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
def source(folder: Path) -> Path:
    """The source distribution, unpacked, with the wheel that is built from nothing else."""
    hatchling = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), "-t"]
    subprocess.run([*hatchling, "sdist"], cwd=ROOT, check=True, capture_output=True)
    [packed] = folder.glob("*.tar.gz")
    subprocess.run(["tar", "-xf", packed, "-C", folder], check=True)
    tree = packed.with_suffix("").with_suffix("")
    subprocess.run([*hatchling, "wheel"], cwd=tree, check=True, capture_output=True)
    return tree


def files(root: Path, *parts: str) -> set[str]:
    """What lies below these folders, without what Python leaves there."""
    return {
        path.relative_to(root).as_posix()
        for part in parts
        for path in (root / part).rglob("*")
        if path.is_file() and not {"__pycache__", ".unpacked"} & set(path.parts)
    }


def test_both_distributions_have_all_that_they_need_and_nothing_else(source: Path) -> None:
    [wheel] = source.parent.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        names = {name for name in packed.namelist() if ".dist-info/" not in name}
        about = {name.partition(".dist-info/")[2] for name in packed.namelist()}
    assert names == files(ROOT, *OURS)
    assert {"licenses/LICENSE", "licenses/THIRD-PARTY.md", "entry_points.txt"} <= about
    assert {".toml", ".tif", ".j2", ".parm", ".typed"} <= {Path(name).suffix for name in names}
    for part in (*OURS, "scripts", "docs", ".ci", "tests"):  # what the suite needs
        assert files(source, part) == files(ROOT, part)
    assert {"README.md", "CHANGELOG.md", "LICENSE", "requirements/dev.txt"} <= files(source, ".")


class OrdinaryUser:
    """Somebody with a home that is read-only and a folder to work in."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self.programs, self.work, home = programs, folder / "work", folder / "home"
        home.mkdir(mode=0o555)
        self.work.mkdir(mode=0o700)
        self.prefix = AS_NOBODY if os.geteuid() == 0 else ()
        if self.prefix:
            os.chown(self.work, int(NOBODY), int(NOBODY))
        self.cache = self.work / f"companion-{NOBODY if self.prefix else os.geteuid()}"
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
def user(source: Path, folder: Path) -> OrdinaryUser:
    """Of a fresh environment with the wheel, and exactly what the project says that it needs.

    No extra: as somebody has it who installs the bare project.
    """
    environment = folder / "environment"
    venv.create(environment, symlinks=True)
    [packages] = environment.glob("lib/python*/site-packages")
    for package in needed(PROJECT["dependencies"]).values():
        names = {each.parts[0] for each in package.files or ()} - {"..", "__pycache__"}
        for path in (Path(str(package.locate_file(name))) for name in names):
            if not (packages / path.name).exists():
                (packages / path.name).symlink_to(path)
    pip = [sys.executable, "-m", "pip", f"--python={environment}/bin/python", "install", "-q"]
    [wheel] = source.parent.glob("*.whl")
    command = [*pip, "--no-deps", "--no-index", "--disable-pip-version-check", str(wheel)]
    subprocess.run(command, check=True)
    user = OrdinaryUser(folder, environment / "bin")
    lend(user.cache, packages)
    return user


def lend(cache: Path, packages: Path) -> None:
    """What this checkout has compiled of the same code, but for a part: all takes a minute.

    numba finds it by the folder of the source, and tells by its text whether it is still true.
    """
    warm_up()
    ours = jit.cache_on_disk()
    assert ours is not None
    for part in ("path", "planner"):
        here, there = (
            _CacheLocator.get_suitable_cache_subpath(str(root / "companion" / part / "file.py"))
            for root in (Path(jit.__file__).parents[1], packages)
        )
        shutil.copytree(ours / here, cache / ours.name / there)
    for path in (cache, *cache.rglob("*")) if os.geteuid() == 0 else ():
        os.chown(path, int(NOBODY), int(NOBODY))


@pytest.mark.closed_loop
def test_an_ordinary_user_flies_replays_and_reports(user: OrdinaryUser) -> None:
    """With a read-only home: what is compiled is kept, and nothing that is said sounds bad."""
    port = free_port()
    (user.work / "mission.toml").write_text(one_target(), encoding="utf-8")
    simulator = user.starts(
        "vehicle-sim", "sitl-arducopter", "--lockstep", f"--connect=udpout:127.0.0.1:{port}"
    )
    flown = "fly", "mission.toml", "--lockstep", f"--connect=udpin:127.0.0.1:{port}", "--out=flight"
    try:
        said = user.runs("companion", *flown)
        assert simulator.wait(60.0) == 0, simulator.transcript
    finally:
        simulator.end()
    compiled = {file.parent.name.partition("_")[0] for file in user.cache.rglob("*.nbc")}
    assert compiled == {"path", "planner", "world"}
    for command in ("replay", "report"):
        said += user.runs("companion", command, "flight")
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


WITHOUT_DEVELOPERS = """
import sys
class Refuses:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuses())
"""


def pinned(wanted: str) -> set[str]:
    text = (ROOT / "requirements" / f"{wanted}.txt").read_text(encoding="utf-8")
    return set(re.findall(r"^([\w.-]+)==", text, re.MULTILINE))


@pytest.mark.parametrize(
    ("wanted", "modules"),
    [
        ("fly", "companion.cli, vehicle_sim.server"),
        ("view", "companion.live_view.page"),
        ("campaign", "companion.campaign.store, distributed, polars"),
        ("compare", "ompl"),
    ],
)
def test_a_clone_is_set_up_with_what_its_user_needs(wanted: str, modules: str) -> None:
    """And for flying with what setup.sh compiles: all that both programs are made of."""
    only = pinned("dev") - pinned(wanted)
    names = {
        module
        for module, distributions in packages_distributions().items()
        if {each.lower().replace("_", "-") for each in distributions} <= only
    }
    assert {"pytest", "hatchling"} <= names
    assert ("viser" in names) == (wanted != "view")
    setup = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    [compiles] = re.findall(r"^compiles='(.*?)\n[^\n]*load_proof\(\)'$", setup, re.M | re.S)
    program = WITHOUT_DEVELOPERS.format(names=names) + compiles * (wanted == "fly")
    program += f"\nimport {modules}"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=120)
