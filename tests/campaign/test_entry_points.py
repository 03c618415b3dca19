"""A stranger's distribution brings an optimiser and a planner, and we fly with both."""

import importlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion import entry_points, library
from companion.campaign import families
from companion.campaign.run import fly_alone
from companion.config import load_mission, mission_text
from companion.errors import InputError
from companion.optimise.registry import OPTIMISERS
from companion.paper.rivals import PLANNERS

CODE = '''
import numpy as np

class Scatter:
    """Looks for the best of chance, seeds included."""
    def __init__(self, dimensions, evaluations, rng, seeds):
        self.rng, self.shape = rng, (50, dimensions)
        self.asked = np.empty((0, dimensions)) if seeds is None else np.clip(seeds, 0.0, 1.0)
        self.population, self.costs = np.empty((0, dimensions)), np.empty(0)

    def ask(self):
        self.asked = self.asked if len(self.asked) else self.rng.random(self.shape)
        return self.asked

    def tell(self, costs):
        population = np.concatenate([self.population, self.asked])
        best = np.argsort(costs := np.concatenate([self.costs, costs]))[:50]
        self.population, self.costs, self.asked = population[best], costs[best], ()

class Flat(Scatter):
    def ask(self):
        return self.rng.random(7)

def straight(problem, rng):
    return np.array([problem.start_ne_m, problem.target_ne_m])

def of_nothing():
    return None
'''
POINTS = """
[companion.optimisers]
scatter = strangers_search:Scatter
flat = strangers_search:Flat
gone = strangers_search:Gone
pso = strangers_search:Flat
[companion.planners]
straight = strangers_search:straight
of-nothing = strangers_search:of_nothing
"""
BROKEN = {"flat": "ask() gives the shape (7,)", "gone": "AttributeError"}


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """As pip leaves it in a folder on the path."""
    target = tmp_path_factory.mktemp("installed")
    about = target / "a_strangers_search-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: a-strangers-search\nVersion: 1\n")
    (about / "entry_points.txt").write_text(POINTS)
    (target / "strangers_search.py").write_text(CODE)
    known = set(OPTIMISERS), set(PLANNERS)
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(target))
        importlib.invalidate_caches()
        entry_points._points_of.cache_clear()
        yield
        for registry, before in zip((OPTIMISERS, PLANNERS), known, strict=True):
            for name in set(registry.data) - before:
                del registry[name]
    entry_points._points_of.cache_clear()


def mission_with(folder: Path, optimiser: str) -> str:
    path, text = folder / "mission.toml", mission_text("environment-1")
    path.write_text(text.replace("overlap_m", f'optimiser = "{optimiser}"\noverlap_m', 1))
    return str(path)


def test_its_optimiser_flies_named_in_a_mission_file_or_asked_for(tmp_path: Path) -> None:
    named, asked, ours = (
        library.fly("environment-1", mission, optimiser=optimiser, most_legs=2).points_nea_m
        for mission, optimiser in (
            (mission_with(tmp_path, "scatter"), None),
            ("environment-1", "scatter"),
            ("environment-1", None),
        )
    )
    assert len(named) > 1
    assert np.array_equal(asked, named)
    assert not np.array_equal(ours, named)


def test_its_planner_flies() -> None:
    found = fly_alone(families.world("copter", 5, 1), "straight", knowledge="full")
    assert len(found.points_nea_m) > 1  # the straight line is barred in every drawn world


def test_its_names_stand_beside_ours_and_ours_win_and_what_is_broken_is_told_in_one_line(
    tmp_path: Path,
) -> None:
    assert OPTIMISERS["pso"].__module__ == "companion.paper.optimisers"
    with pytest.raises(InputError, match=r"One of: .*flat, .*gone, .*refined-de, .*scatter"):
        load_mission(mission_with(tmp_path, "magic"))
    with pytest.raises(InputError, match=r"a-strangers-search.*does not take a problem"):
        PLANNERS["of-nothing"]
    for name, wrong in BROKEN.items():
        for ask in (
            lambda name=name: load_mission(mission_with(tmp_path, name)),
            lambda name=name: library.fly("environment-1", "environment-1", optimiser=name),
        ):
            with pytest.raises(InputError, match=r"a-strangers-search") as told:
                ask()
            assert wrong in str(told.value)
            assert "\n" not in str(told.value)
