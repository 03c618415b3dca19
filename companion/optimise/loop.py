"""The one loop that owns the budget, and what optimisers share."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, final

import numpy as np

from companion.geodesy import FloatArray


class Optimiser(Protocol):
    """Searches the unit cube: ask for candidates (P, D), be told their costs (P,)."""

    @property
    def population(self) -> FloatArray:
        """The members, (P, D)."""

    @property
    def costs(self) -> FloatArray:
        """Their costs, (P,)."""

    def ask(self) -> FloatArray:
        """The candidates to evaluate next."""

    def tell(self, costs: FloatArray) -> None:
        """The costs of the candidates of the last ask()."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Ranked:
    """The last population, best first."""

    x: FloatArray  # (P, D)
    costs: FloatArray  # (P,)
    evaluations: int


def minimise(
    optimiser: Optimiser,
    objective: Callable[[FloatArray], FloatArray],
    evaluations: int,
    stop: Callable[[], bool] = lambda: False,
) -> Ranked:
    """Search until the budget is spent, to the evaluation.

    Of the last generation as many candidates are evaluated as the budget allows; the others, and
    costs that are not numbers, count as infinite.
    """
    spent = 0
    while spent < evaluations and not (spent and stop()):
        x = optimiser.ask()
        costs = np.full(len(x), np.inf)
        count = min(len(x), evaluations - spent)
        costs[:count] = objective(x[:count])
        optimiser.tell(np.where(np.isnan(costs), np.inf, costs))
        spent += count
    order = np.argsort(optimiser.costs, kind="stable")
    return Ranked(x=optimiser.population[order], costs=optimiser.costs[order], evaluations=spent)


def first_members(
    size: int, dimensions: int, rng: np.random.Generator, seeds: FloatArray | None
) -> FloatArray:
    """The seeds, as many as there is room for, and random points.  (K, D) -> (size, D).

    Seeds beyond the unit cube are clipped into it.
    """
    members = rng.random((size, dimensions))
    if seeds is not None:
        members[: len(seeds)] = np.clip(seeds[:size], 0.0, 1.0)
    return members
