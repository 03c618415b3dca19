"""A stranger's distribution brings an optimiser and a planner, and we fly with both."""

import importlib
import importlib.resources
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion import entry_points, library
from companion.campaign import families
from companion.campaign.run import fly_alone
from companion.config import load_mission
from companion.errors import InputError
from companion.optimise.registry import OPTIMISERS
from companion.paper.rivals import PLANNERS

CODE = '''
import numpy as np


class Scatter:
    """Looks for the best of chance."""

    def __init__(self, dimensions, evaluations, rng, seeds):
        self.rng, self.shape, self.seeds = rng, (50, dimensions), seeds
        self.population, self.costs = np.empty((0, dimensions)), np.empty(0)

    def ask(self):
        self.asked = self.rng.random(self.shape)
        if self.seeds is not None:
            self.asked, self.seeds = np.clip(self.seeds, 0.0, 1.0), None
        return self.asked

    def tell(self, costs):
        population = np.concatenate([self.population, self.asked])
        costs = np.concatenate([self.costs, costs])
        best = np.argsort(costs)[:50]
        self.population, self.costs = population[best], costs[best]


class Flat(Scatter):
    def ask(self):
        return self.rng.random(7)


def straight(problem, rng):
    return np.array([problem.start_ne_m, problem.target_ne_m])


def of_nothing():
    return None
'''
PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "a-strangers-search"
version = "1.0"
[project.entry-points."companion.optimisers"]
scatter = "strangers_search:Scatter"
flat = "strangers_search:Flat"
gone = "strangers_search:Gone"
pso = "strangers_search:Flat"
[project.entry-points."companion.planners"]
straight = "strangers_search:straight"
of-nothing = "strangers_search:of_nothing"
[tool.hatch.build.targets.wheel]
packages = ["strangers_search"]
"""


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """As pip installs it, into a folder on the path."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("installed")
    (source / "strangers_search").mkdir()
    (source / "strangers_search" / "__init__.py").write_text(CODE, encoding="utf-8")
    (source / "pyproject.toml").write_text(PROJECT, encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run(
        [*pip, "--no-build-isolation", "--target", str(target), str(source)],
        check=True,
        capture_output=True,
    )
    known = set(OPTIMISERS), set(PLANNERS)
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(target))
        importlib.invalidate_caches()
        entry_points._found.cache_clear()
        yield
        for registry, before in zip((OPTIMISERS, PLANNERS), known, strict=True):
            for name in set(registry.data) - before:
                del registry[name]
    entry_points._found.cache_clear()


def mission_with(folder: Path, optimiser: str) -> str:
    environments = Path(str(importlib.resources.files("companion") / "environments"))
    text = (environments / "environment-1" / "mission.toml").read_text(encoding="utf-8")
    path = folder / "mission.toml"
    path.write_text(text.replace("overlap_m", f'optimiser = "{optimiser}"\noverlap_m', 1))
    return str(path)


def test_its_names_stand_beside_ours_and_ours_win() -> None:
    assert {"scatter", "flat", "gone", "refined-de"} <= set(OPTIMISERS)
    assert "scatter" in library.OPTIMISERS
    assert {"straight", "a-star"} <= set(PLANNERS)
    assert OPTIMISERS["pso"].__module__ == "companion.paper.optimisers"


def test_a_mission_file_flies_with_its_optimiser(tmp_path: Path) -> None:
    named = mission_with(tmp_path, "scatter")
    flown = library.fly("environment-1", named, most_legs=2)
    assert flown.points_nea_m.shape[0] > 1
    own = library.fly("environment-1", "environment-1", optimiser="scatter", most_legs=2)
    assert (own.points_nea_m == flown.points_nea_m).all()
    ours = library.fly("environment-1", "environment-1", most_legs=2)
    assert (
        ours.points_nea_m.shape != own.points_nea_m.shape
        or (ours.points_nea_m != own.points_nea_m).any()
    )


@pytest.mark.parametrize(
    ("name", "wrong"), [("flat", "ask() gives the shape (7,)"), ("gone", "AttributeError")]
)
def test_a_broken_optimiser_is_one_line_with_its_distribution(
    name: str, wrong: str, tmp_path: Path
) -> None:
    for ask in (
        lambda: load_mission(mission_with(tmp_path, name)),
        lambda: library.fly("environment-1", "environment-1", optimiser=name),
    ):
        with pytest.raises(InputError) as told:
            ask()
        text = str(told.value)
        assert "a-strangers-search" in text
        assert wrong in text
        assert "\n" not in text


def test_an_unknown_optimiser_is_told_the_strangers_names_too(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"One of: .*, scatter"):
        load_mission(mission_with(tmp_path, "magic"))


def test_its_planner_flies_and_a_wrong_one_is_refused() -> None:
    world = families.world("copter", 5, 1)
    found = fly_alone(world, "straight", knowledge="full")
    assert len(found.points_nea_m) > 1  # the straight line is barred in every drawn world
    with pytest.raises(InputError, match=r"a-strangers-search.*too many positional arguments"):
        PLANNERS["of-nothing"]
