import numpy as np
import pytest

from companion.optimise.improved_de import ImprovedDE, Settings
from companion.optimise.loop import minimise
from companion.optimise.registry import OPTIMISERS

PAPERS = {
    "improved-de",
    "de/rand/1/bin",
    "de/best/1",
    "de/best/2",
    "de/current-to-best/1",
    "de/rand-to-best/1",
    "pso",
    "ga",
}


def test_every_optimiser_that_the_paper_names_can_be_asked_for() -> None:
    assert set(OPTIMISERS) >= PAPERS


@pytest.mark.parametrize("name", sorted(PAPERS))
def test_the_papers_optimisers_have_the_papers_60_members(name: str) -> None:
    assert OPTIMISERS[name](6, 3_000, np.random.default_rng(1), None).ask().shape == (60, 6)


def test_the_improved_de_gets_the_generations_that_its_budget_pays() -> None:
    def bowl(x: np.typing.NDArray[np.float64]) -> np.typing.NDArray[np.float64]:
        return ((x - 0.3) ** 2).sum(axis=1)

    asked = OPTIMISERS["improved-de"](4, 1_200, np.random.default_rng(7), None)
    by_hand = ImprovedDE(4, 20, Settings(), np.random.default_rng(7))
    a, b = minimise(asked, bowl, 1_200), minimise(by_hand, bowl, 1_200)
    assert a.x.tobytes() == b.x.tobytes()


def test_no_two_names_are_the_same_search() -> None:
    def bowl(x: np.typing.NDArray[np.float64]) -> np.typing.NDArray[np.float64]:
        return ((x - 0.3) ** 2).sum(axis=1)

    ends = {
        minimise(make(4, 600, np.random.default_rng(3), None), bowl, 600).x.tobytes()
        for make in OPTIMISERS.values()
    }
    assert len(ends) == len(OPTIMISERS)
