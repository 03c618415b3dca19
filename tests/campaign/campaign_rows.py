"""Rows of campaigns that were never flown."""

import numpy as np

from companion.campaign.store import COLUMNS, Row

BASE: Row = {"world": "hill", "mission": "hill", "profile": "flight", "optimiser": "refined-de"}
BASE |= {"budget": 3000, "planner": "ours", "knowledge": "scans", "over": "process"}
BASE |= {"outcome": "arrived", "arrived": True, "violations": 0, "folder": "", "version": "0.2.0"}
BASE |= {"cost": 10.0, "length_m": 1100.0, "straight_m": 1000.0, "clearance_least_m": 60.0}


def row(run: int, **values: object) -> Row:
    own = {"run": run, "key": f"hill/{run}", "seed": run}
    return {**dict.fromkeys(COLUMNS), **BASE, **own, **values}


def paired_rows(count: int = 40) -> list[Row]:
    """The second optimiser is better by a tenth or so in three runs of four, and fails thrice."""
    rng, rows = np.random.default_rng(5), []
    for seed in range(count):
        cost = float(rng.uniform(8.0, 20.0))
        gain = 1.0 - (0.1 if seed % 4 else -0.05) * rng.uniform(0.5, 1.5)
        rows.append(row(2 * seed, seed=seed, cost=cost))
        other = row(2 * seed + 1, seed=seed, optimiser="l-shade", cost=cost * float(gain))
        if seed < 3:
            other |= {"arrived": False, "outcome": "failed", "reason": "stuck", "cost": None}
        rows.append(other)
    return rows
