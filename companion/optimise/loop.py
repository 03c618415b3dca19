"""The one loop that owns the budget, and what optimisers share."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Generic, Protocol, TypeVar, final

import numpy as np

from companion.errors import InputError
from companion.geodesy import BoolArray, FloatArray


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


class Sized(Protocol):
    """The parameters of an optimiser."""

    @property
    def population(self) -> int:
        """NP."""


S = TypeVar("S", bound=Sized)


class Generations(ABC, Generic[S]):
    """An optimiser that asks for a whole generation at a time, the first one seeds and chance.

    `population` and `costs` are its members; before the first tell() there are none.
    """

    _usual: ClassVar[type]
    """Makes the settings if none are given."""

    def __init__(
        self,
        dimensions: int,
        evaluations: int,
        rng: np.random.Generator,
        seeds: FloatArray | None = None,
        settings: S | None = None,
    ) -> None:
        """evaluations: the budget; seeds: candidates to start from, (K, D) in the unit cube."""
        self._settings: S = settings or self._usual()
        self._evaluations, self._rng = evaluations, rng
        self._asked = first_members(self._settings.population, dimensions, rng, seeds)
        self.population: FloatArray = np.empty((0, dimensions))
        self.costs: FloatArray = np.empty(0)

    def ask(self) -> FloatArray:
        """The candidates to evaluate next.  -> (NP, D) in the unit cube."""
        if len(self.population):
            self._asked = self._next()
        return self._asked

    def tell(self, costs: FloatArray) -> None:
        """The costs of the candidates of the last ask(): (NP,)."""
        if len(self.population):
            self._learn(costs)
        else:
            self.population, self.costs = self._asked.copy(), costs.copy()

    @abstractmethod
    def _next(self) -> FloatArray:
        """The generation after the first.  -> (NP, D) in the unit cube."""

    def _learn(self, costs: FloatArray) -> None:
        """What becomes of the members."""
        self._keep_better(costs)

    def _keep_better(self, costs: FloatArray) -> BoolArray:
        """Eq. 14: of member and candidate the better, the candidate if equal.  -> which, (NP,)."""
        better = costs <= self.costs
        self.population = np.where(better[:, None], self._asked, self.population)
        self.costs = np.where(better, costs, self.costs)
        return better


def check_population(population: int, others: int) -> None:
    """Refuse a population in which a member does not have that many others (InputError)."""
    if population <= others:
        rule = f"a mutant needs {others} members besides its own"
        raise InputError("population", population, rule, f"Set it to {others + 1} or more.")


def first_members(
    size: int, dimensions: int, rng: np.random.Generator, seeds: FloatArray | None
) -> FloatArray:
    """The seeds, as many as there is room for, and random points.  (K, D) -> (size, D).

    Seeds beyond the unit cube are clipped into it.
    """
    members = rng.random((size, dimensions))
    if seeds is not None:
        count = min(len(seeds), size)
        members[:count] = np.clip(seeds[:count], 0.0, 1.0)
    return members
