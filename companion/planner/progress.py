"""Whether a mission gets on: what its legs cost beyond what guidance promised may not add up.

Guidance promises what is left to fly from a place; a leg that takes a turn, or a way that cannot be
proven, costs more.  Such excess is owed.  A place from which less is left than from any before is a
record: there nothing is owed any more.  When more is owed than one stop costs, the vehicle stops;
standing it goes on by straight pieces along the route, each of which leaves less to fly
(`planner.way_out`).

So a mission ends.  While the map stays as it is: a leg that is hardly dearer than promised leaves
less to fly by what it costs, but for `SLACK`, which is less than a leg costs; dearer ones owe; and
more than a stop's cost is never owed in flight.  So every flight between stops comes to a record,
and so does every row of stops, and records are apart by no less than a leg, or a cell, leaves off.
What a scan adds to what is left raises the record by as much, and scans add something only as often
as there are cells to see: a cell that was seen stays seen.  (Where near cells are forgotten this
does not hold; there stops are counted, as everywhere.)
"""

import math
from dataclasses import dataclass, replace
from typing import final

SLACK = 0.05
"""Of R: excess that a leg may have without owing it, as the lattice of guidance knows no turns.

Legs are longer than this up to p_prog, as L is at most 0.6 of the circle about p_scan."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Of the way to one target, in metres of level flight at the floor of the band."""

    record_m: float = math.inf
    """The least that was left to fly from any start of a leg."""
    owed_m: float = 0.0
    """What legs since then cost beyond what was promised."""
    expected_m: float = math.inf
    """What the plan before thought to be left from where this one starts."""

    def at(self, left_m: float) -> "Progress":
        """At the start of a plan, from where so much is left by the map as it is now."""
        learned_m = max(left_m - self.expected_m, 0.0)
        if left_m < self.record_m + learned_m:
            return Progress(record_m=left_m)
        return replace(self, record_m=self.record_m + learned_m)

    def owing(self, excess_m: float, range_m: float) -> float:
        """What is owed with one more leg that costs so much more than was promised."""
        return self.owed_m + max(excess_m - SLACK * range_m, 0.0)

    def after(self, owed_m: float, expected_m: float) -> "Progress":
        """When a leg has been planned: from its p_prog so much is left by the same map."""
        return replace(self, owed_m=owed_m, expected_m=expected_m)


NO_PROGRESS = Progress()
"""On the way to a new target."""
