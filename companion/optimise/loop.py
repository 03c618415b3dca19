"""The one loop that owns the budget."""

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
    optimiser: Optimiser, objective: Callable[[FloatArray], FloatArray], evaluations: int
) -> Ranked:
    """Search until the budget is spent: never more evaluations than asked for.

    A generation that does not fit into what is left is not begun; costs that are not numbers
    count as infinite.
    """
    spent = 0
    while True:
        x = optimiser.ask()
        if spent + len(x) > evaluations and spent > 0:
            break
        costs = objective(x)
        optimiser.tell(np.where(np.isnan(costs), np.inf, costs))
        spent += len(x)
    order = np.argsort(optimiser.costs, kind="stable")
    return Ranked(x=optimiser.population[order], costs=optimiser.costs[order], evaluations=spent)
