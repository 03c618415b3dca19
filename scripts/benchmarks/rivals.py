"""Planners of whole routes beside ours in the same random worlds, with scans and with all known.

    scripts/bench rivals [--worlds 3] [--seed 41] [--family copter] [--planner a-star] [--json F]

Every planner of `companion.planners` flies every world twice: planning once with full knowledge,
and planning again and again as the ground comes in sight.  Costs and bounds are measured by
`companion.campaign.rivals.measure` for all of them alike.  What each is: docs/results/campaigns.md.
The bar: ours arrives in every world with scans and keeps every bound.
"""

import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import running
from rich.table import Table

from companion.campaign import families
from companion.campaign.rivals import flight, ours
from companion.campaign.rivals.measure import measured
from companion.campaign.rivals.registry import PLANNERS

OURS = "ours"
_ONCE = 5
"""How many times the budget of one plan has who plans only once."""
_BOUNDS = ("keeps_clearance", "keeps_turns", "keeps_slopes")


def fly(family: str, seed: int, index: int, planner: str, knowledge: Any) -> dict[str, Any]:
    """One flight, measured."""
    world = families.world(family, seed, index)
    if planner == OURS:
        flown = ours.fly(world, knowledge=knowledge)
    else:
        evaluations = flight.EVALUATIONS * (_ONCE if knowledge == "full" else 1)
        flown = flight.fly(world, PLANNERS[planner], knowledge=knowledge, evaluations=evaluations)
    found = (
        asdict(measured(world, flown.points_nea_m, flown.stops))
        if len(flown.points_nea_m) > 1
        else {}
    )
    return {
        "family": family,
        "world": world.name,
        "planner": planner,
        "knowledge": knowledge,
        "arrived": flown.arrived,
        "why": flown.why,
        "plan_s": flown.plan_s,
        "scans": flown.scans,
        "required_m": world.task.required_clearance_m,
        **found,
    }


Found = list[dict[str, Any]]


def ratios(mine: Found, reference: dict[str, float]) -> list[float]:
    """J over that of ours with scans, of flights that arrived."""
    return [each["cost"] / reference[each["world"]] for each in mine
            if each["arrived"] and each["world"] in reference]  # fmt: skip


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):.3f}" if values else ""


def tables(found: Found) -> tuple[Table, Table]:
    """All flights by planner; and the cost by family."""
    reference = {
        each["world"]: each["cost"]
        for each in found
        if (each["planner"], each["knowledge"]) == (OURS, "scans") and each["arrived"]
    }
    kinds = list(dict.fromkeys((each["planner"], each["knowledge"]) for each in found))
    names = list(dict.fromkeys(each["family"] for each in found))
    overall = running.figures(
        "Whole routes", "planner, knowledge", "arrived", "J / ours: median", "worst",
        "clearance kept", "least / required", "turns kept", "climbs kept", "plans",
        "s a plan", "s a flight",
    )  # fmt: skip
    by_family = running.figures("J / ours (with scans), median", "planner, knowledge", *names)
    for kind in kinds:
        mine = [each for each in found if (each["planner"], each["knowledge"]) == kind]
        flown = [each for each in mine if each["arrived"]]
        costs, plans = ratios(mine, reference), [s for each in mine for s in each["plan_s"]]
        overall.add_row(
            ", ".join(kind), f"{len(flown)} of {len(mine)}", _median(costs),
            f"{max(costs):.3f}" if costs else "",
            *(str(sum(each[name] for each in flown)) if name != "least" else
              f"{min((e['clearance_m'] / e['required_m'] for e in flown), default=np.nan):.2f}"
              for name in ("keeps_clearance", "least", "keeps_turns", "keeps_slopes")),
            f"{np.median([len(each['plan_s']) for each in mine]):.0f}",
            f"{np.median(plans):.3f}" if plans else "",
            f"{np.median([sum(each['plan_s']) for each in mine]):.2f}",
        )  # fmt: skip
        by_family.add_row(", ".join(kind), *(
            _median(ratios([each for each in mine if each["family"] == name], reference))
            for name in names
        ))  # fmt: skip
    return overall, by_family


def main() -> int:
    """Fly them all, print the tables."""
    options, console = running.begin(
        __doc__,
        worlds=(3, "of each family"),
        seed=(41, "which worlds are drawn"),
        jobs=2,
        family=({"action": "append", "choices": families.FAMILIES}, "this one; several: again"),
        planner=({"action": "append", "choices": [OURS, *PLANNERS]}, "beside ours; likewise"),
    )
    planners = dict.fromkeys([OURS, *(options.planner or PLANNERS)])
    todo = [
        (family, options.seed, index, planner, knowledge)
        for planner in planners
        for knowledge in ("scans", "full")
        for family in options.family or families.FAMILIES
        for index in range(options.worlds)
    ]
    flown = running.in_processes(fly, todo, options.jobs, "rivals", console)
    found = [future.result() for _, future in flown]
    for table in tables(found):
        console.print(table)
    for each in found:
        if not each["arrived"]:
            console.print(f"{each['world']}, {each['planner']}, {each['knowledge']}: {each['why']}")
    running.store(options.json, found)
    mine = [each for each in found if (each["planner"], each["knowledge"]) == (OURS, "scans")]
    kept = all(each["arrived"] and all(each[name] for name in _BOUNDS) for each in mine)
    return running.ended(console, kept=kept)


if __name__ == "__main__":
    sys.exit(main())
