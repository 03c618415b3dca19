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


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """As pip leaves it in a folder on the path."""
    target = tmp_path_factory.mktemp("installed")
    about = target / "a_strangers_search-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: a-strangers-search\nVersion: 1.0\n"
    )
    (about / "entry_points.txt").write_text(POINTS)
    (target / "strangers_search.py").write_text(CODE)
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
    path = folder / "mission.toml"
    text = mission_text("environment-1")
    path.write_text(text.replace("overlap_m", f'optimiser = "{optimiser}"\noverlap_m', 1))
    return str(path)


def test_its_names_stand_beside_ours_and_ours_win(tmp_path: Path) -> None:
    assert {"scatter", "flat", "gone", "refined-de"} <= set(OPTIMISERS)
    assert {"straight", "a-star"} <= set(PLANNERS)
    with pytest.raises(InputError, match=r"One of: .*, scatter"):
        load_mission(mission_with(tmp_path, "magic"))
    assert OPTIMISERS["pso"].__module__ == "companion.paper.optimisers"


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
        with pytest.raises(InputError, match=r"a-strangers-search") as told:
            ask()
        assert wrong in str(told.value)
        assert "\n" not in str(told.value)


def test_its_planner_flies_and_a_wrong_one_is_refused() -> None:
    found = fly_alone(families.world("copter", 5, 1), "straight", knowledge="full")
    assert len(found.points_nea_m) > 1  # the straight line is barred in every drawn world
    with pytest.raises(InputError, match=r"a-strangers-search.*does not take a problem"):
        PLANNERS["of-nothing"]
