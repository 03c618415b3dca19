"""Whether a mission gets on: what its legs cost beyond what guidance promised may not add up.

Guidance promises what is left to fly from a place; a leg that takes a turn, or a way that cannot be
proven, costs more.  Such excess is owed.  A place from which less is left than from any before is a
record: there nothing is owed any more.  When more is owed than may be (`planner.price`), the
vehicle stops; standing it goes on by a straight piece along the way (`planner.way_out`), unless a
leg costs less than that by more than what is owed already.

So a mission ends.  While the map stays as it is, guidance without guesses promises the same from
the same place each time.  A leg that is hardly dearer than promised then leaves less to fly by
what it costs, but for `SLACK`, which is less than a leg costs; dearer ones owe, and more than may
be is never owed in flight.  So every flight between stops comes to a record.  Standing, what is
owed grows until a straight piece is cheaper, and those leave less to fly, or climb to where the way
on begins.  Where there is none it grows until it is more than a way all round what is in sight, and
then the answer is that no way on was found (not among near things, whose map forgets).  Records are
apart by no less than a leg, or a cell, leaves off.

Guesses promise what cannot be flown where ground is hidden that is not as low as they say.  They
are given up where the best that a standing vehicle can do costs more than was promised by more than
may be owed, and where in all much more is left than was thought, though nothing new was seen.  What
a sight line bounds is then taken to be as high as that, so that what is promised can be proven; or
to be free, where no way is left by such bounds: it has not been looked at.  And guesses are
believed again where less is left by them than there, by a cell, so it ends (Lumelsky and Stepanov
1987, Bug2: leave an obstacle where the target is nearer than where it was met).

And scans show something new only as often as there are cells to see.  (Where near cells are
forgotten this does not hold; there stops are counted, as everywhere.)
"""

import math
from dataclasses import dataclass, replace
from typing import final

SLACK = 0.05
"""Of R: excess that a leg may have without owing it, as the lattice of guidance knows no turns.

Legs are longer than this up to p_prog, as L is at most 0.6 of the circle about p_scan; among near
things none is left before (`Leg.wants_successor`)."""

BELIEVED = 1.0
"""Of R: how much more may be left than was thought, with nothing new seen, before guesses go.

Chosen on 12 `walls` worlds (20261127) and a wall with one gap: with less, ways that were right are
given up; counted with what scans show, too, dead ends are looked into to the end."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Of the way to one target, in metres of level flight at the floor of the band."""

    record_m: float = math.inf  # the least that was left to fly from any start of a leg
    owed_m: float = 0.0  # what legs since then cost beyond what was promised
    expected_m: float = math.inf  # what the plan before thought to be left from here
    end_m: float = math.inf  # and from the end of the leg that it chose
    doubt_m: float = 0.0  # by how much plans were wrong about that, in all, with nothing new seen
    seen: int = 0  # cells of the map that the plan before knew
    believed_below_m: float = math.inf  # guesses are believed where less is left by them

    def at(self, left_m: float, least_m: float, *, seen: int, few: float) -> "Progress":
        """At the start of a plan, from where so much is left by the map as it is now.

        least_m: a record is beaten by this, not by where a straight piece happens to end.
        seen: cells that are known; few: so many more say nothing new.
        """
        rise_m = max(left_m - self.expected_m, 0.0)
        is_new = abs(seen - self.seen) > few
        doubt_m = self.doubt_m + (0.0 if is_new else rise_m)
        after = replace(self, doubt_m=doubt_m, seen=seen)
        record_m = self.record_m + (rise_m if is_new else 0.0)
        if left_m < record_m - least_m:
            return replace(after, record_m=left_m, owed_m=0.0)
        return replace(after, record_m=record_m)

    def disbelieving(self, left_m: float, least_m: float) -> "Progress":
        """Anew, without guesses, until so much less is left by them than was ever, or is now."""
        left_m = min(left_m, self.record_m)
        return Progress(seen=self.seen, believed_below_m=left_m - least_m)

    def owing(self, excess_m: float, range_m: float) -> float:
        """What is owed with one more leg that costs so much more than was promised."""
        return self.owed_m + max(excess_m - SLACK * range_m, 0.0)


NO_PROGRESS = Progress()  # on the way to a new target
