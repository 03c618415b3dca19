"""What a refined search (`refined_de`) is told, remembers, and has found.

The state is a tuple of arrays and nothing else, so that the same functions run on it compiled and
as they are.  All that is random in a search is drawn when it begins.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import numpy.typing as npt

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.optimise.loop import first_members

IntArray = npt.NDArray[np.int64]

FEWEST = 4
"""Members that eq. 17 needs: a parent and three others."""
_PER_ROOT = 1.1  # members at the start for each square root of an evaluation
_LEAST, _MOST = 20, 150  # members at the start


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The refined DE's parameters; the defaults were measured by scripts/benchmarks/quality.py."""

    population: int | None = None
    """Members at the start; None: as the budget allows, 60 for 3,000 evaluations."""
    smallest: int = 6
    """Members at the end of the linear reduction."""
    p_best: float = 0.2
    """Share of the population among which x_best of eq. 17 is drawn."""
    own: float = 0.5
    """Share of trials whose x_r1 of eq. 17 is the member itself: it keeps basins apart."""
    archive: float = 1.0
    """Beaten parents that are kept, per member."""
    memory: int = 5
    """Pairs of a and Cr that are remembered."""
    spread: float = 0.1
    """Of a and Cr about what is remembered."""
    k1: tuple[float, float] = (0.0, 0.0)
    """k1 goes from the first to the second value (eq. 18; in the paper from 0 to 0.5)."""
    k2: tuple[float, float] = (1.0, 1.0)
    """k2 goes from the first to the second value (eq. 18; in the paper from 1 to 0.5)."""
    polish: float = 0.15
    """Share of the budget that goes to the simplex, at the end."""
    edge: float = 0.05
    """Of a new simplex."""

    def __post_init__(self) -> None:
        if self.smallest < FEWEST:
            rule = f"eq. 17 needs {FEWEST} members"
            raise InputError("smallest", self.smallest, rule, f"Set {FEWEST} or more.")
        if self.population is not None and self.population < self.smallest:
            rule = "the population cannot be smaller than at its end"
            raise InputError("population", self.population, rule, f"Set {self.smallest} or more.")
        for name in ("p_best", "own", "spread", "polish", "edge"):
            value = getattr(self, name)
            if not 0.0 <= value < 1.0:
                raise InputError(name, value, "not a share", "Set 0 or more, and less than 1.")
        if self.memory < 1:
            raise InputError("memory", self.memory, "nothing could be remembered", "Set 1 or more.")
        if self.archive < 0.0:
            raise InputError("archive", self.archive, "a number of members", "Set 0 or more.")

    def members(self, evaluations: int) -> int:
        """Members at the start of a search with so many evaluations."""
        if self.population is not None:
            return self.population
        wanted = round(_PER_ROOT * math.sqrt(max(evaluations, 0)))
        return max(min(max(wanted, _LEAST), _MOST), self.smallest)


class State(NamedTuple):
    """A search under way: arrays alone, changed in place.  NP members, D variables."""

    population: FloatArray  # (NP, D): the first counters[SIZE] rows count
    costs: FloatArray  # (NP,)
    order: IntArray  # (NP,): members, best first
    pull: FloatArray  # (NP,): 1 - a of the trials under way
    cr: FloatArray  # (NP,)
    trial: FloatArray  # (max(NP, D), D): what ask() wants to know
    trial_costs: FloatArray  # (max(NP, D),): the answer
    trial_bounds: FloatArray  # (max(NP, D),): a trial that costs more is sure to be rejected
    archive: FloatArray  # (A, D): the first counters[ARCHIVED] rows count
    memory: FloatArray  # (H, 2): 1 - a and Cr that succeeded
    simplex: FloatArray  # (D + 1, D): vertices, best first
    simplex_costs: FloatArray  # (D + 1,)
    centre: FloatArray  # (D,): of all vertices but the worst
    reflected: FloatArray  # (1, D): the worst vertex reflected at the centre
    uniforms: FloatArray  # (E, U_CROSS + D): row e is for evaluation e of the evolution
    deviates: FloatArray  # (E, 2): Cauchy's for a, normal ones for Cr
    numbers: FloatArray  # settings and scalars, by the names below
    counters: IntArray  # by the names below


# State.counters
SPENT, BUDGET, POLISH_AT, SIZE, FIRST, SMALLEST, ARCHIVED, SLOT, PHASE = range(9)
# State.numbers
P_BEST, OWN, ARCHIVE, SPREAD, K1_FROM, K1_TO, K2_FROM, K2_TO, EDGE, REFLECTED_COST = range(10)
# State.counters[PHASE]: what the trials under way are
START, EVOLVE, BUILD, REFLECT, EXPAND, OUTSIDE, INSIDE, SHRINK = range(8)
# columns of State.uniforms; the crossover of the variables follows
U_SLOT, U_P_BEST, U_R1, U_R2, U_R3, U_KEPT, U_ARCHIVE, U_CROSS = range(8)


def begin(
    dimensions: int,
    evaluations: int,
    seeds: FloatArray,
    settings: Settings,
    rng: np.random.Generator,
) -> State:
    """A search of the unit cube that has not evaluated anything.

    evaluations: the budget; seeds: candidates to start from, (K, D).  The more seeds, the fewer
    random members.  All that is random in the search is drawn here.
    """
    polish_at = max(evaluations - int(settings.polish * evaluations), 1)
    size = min(settings.members(evaluations), polish_at)
    rows = max(size, dimensions)
    trial = np.zeros((rows, dimensions))
    trial[:size] = first_members(size, dimensions, rng, seeds)
    numbers = np.zeros(REFLECTED_COST + 1)
    numbers[:K1_FROM] = settings.p_best, settings.own, settings.archive, settings.spread
    numbers[K1_FROM:REFLECTED_COST] = *settings.k1, *settings.k2, settings.edge
    counters = np.zeros(9, dtype=np.int64)
    counters[:ARCHIVED] = 0, evaluations, polish_at, size, size, min(settings.smallest, size)
    deviates = np.stack([rng.standard_cauchy(polish_at), rng.standard_normal(polish_at)], axis=1)
    return State(
        population=np.zeros((size, dimensions)),
        costs=np.full(size, math.inf),
        order=np.arange(size),
        pull=np.zeros(size),
        cr=np.zeros(size),
        trial=trial,
        trial_costs=np.full(rows, math.inf),
        trial_bounds=np.full(rows, math.inf),
        archive=np.zeros((int(settings.archive * size), dimensions)),
        memory=np.full((settings.memory, 2), 0.5),
        simplex=np.zeros((dimensions + 1, dimensions)),
        simplex_costs=np.full(dimensions + 1, math.inf),
        centre=np.zeros(dimensions),
        reflected=np.zeros((1, dimensions)),
        uniforms=rng.random((polish_at, U_CROSS + dimensions)),
        deviates=deviates,
        numbers=numbers,
        counters=counters,
    )


def ranked(state: State) -> tuple[FloatArray, FloatArray]:
    """What is worth a closer look: population and simplex without repetitions, best first.

    -> (M, D) in the unit cube, and their costs (M,); nothing before the first tell().
    """
    phase = int(state.counters[PHASE])
    size = int(state.counters[SIZE]) if phase != START else 0
    vertices = state.simplex_costs < math.inf  # the others have not been evaluated
    pending = int(phase in (EXPAND, OUTSIDE))  # a reflected vertex may be the best so far
    x = np.concatenate(
        [state.simplex[vertices], state.reflected[:pending], state.population[:size]]
    )
    costs = np.concatenate(
        [
            state.simplex_costs[vertices],
            state.numbers[REFLECTED_COST : REFLECTED_COST + pending],
            state.costs[:size],
        ]
    )
    order = np.argsort(costs, kind="stable")
    x, costs = x[order], costs[order]
    first = np.sort(np.unique(x, axis=0, return_index=True)[1])
    return x[first], costs[first]
