"""A stranger's distribution brings an optimiser and a planner, and we fly with both."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion import entry_points, library
from companion.campaign import families
from companion.campaign.run import fly_alone
from companion.config import load_mission, read_mission
from companion.errors import InputError
from companion.optimise.registry import OPTIMISERS
from companion.paper.rivals import PLANNERS

PAGE = (Path(__file__).parents[2] / "docs" / "library.md").read_text(encoding="utf-8")
[SEARCH] = re.findall(r"^class RandomSearch:\n.*?\n\n\n", PAGE, re.MULTILINE | re.DOTALL)
CODE = f"""
import numpy as np

{SEARCH}
class Flat(RandomSearch):
    def ask(self):
        return self.rng.random(7)

def straight(problem, rng):
    return np.array([problem.start_ne_m, problem.target_ne_m])

def of_nothing():
    return None
"""
POINTS = """
[companion.optimisers]
scatter = strangers_search:RandomSearch
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
    path, text = folder / "mission.toml", read_mission("environment-1").text
    path.write_text(text.replace("overlap_m", f'optimiser = "{optimiser}"\noverlap_m', 1))
    return str(path)


def test_its_optimiser_flies_named_in_a_mission_file_or_asked_for(tmp_path: Path) -> None:
    def flown(mission: str, **asked: str) -> bytes:
        return library.fly("environment-1", mission, most_legs=1, **asked).points_nea_m.tobytes()

    named = flown(mission_with(tmp_path, "scatter"))
    assert named == flown("environment-1", optimiser="scatter") != flown("environment-1")


def test_its_planner_flies() -> None:
    found, _ = fly_alone(families.world("short-copter", 1, 0), "straight", knowledge="full")
    assert found.legs  # the straight line is barred in every drawn world


def test_its_names_stand_beside_ours_and_ours_win_and_what_is_broken_is_told_in_one_line(
    tmp_path: Path,
) -> None:
    assert OPTIMISERS["pso"].__module__ == "companion.paper.optimisers"
    with pytest.raises(InputError, match=r"One of: .*flat, .*gone, .*refined-de, .*scatter"):
        load_mission(mission_with(tmp_path, "magic"))
    with pytest.raises(InputError, match=r"a-strangers-search.*does not take a problem"):
        PLANNERS["of-nothing"]
    for name, wrong in BROKEN.items():
        with pytest.raises(InputError, match=r"a-strangers-search") as in_a_file:
            load_mission(mission_with(tmp_path, name))
        with pytest.raises(InputError, match=r"a-strangers-search") as asked:
            library.fly("environment-1", "environment-1", optimiser=name)
        for told in (str(in_a_file.value), str(asked.value)):
            assert wrong in told
            assert "\n" not in told
