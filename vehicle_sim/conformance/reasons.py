"""Why a row may differ: a reason names its recording, kind, name, and how far it reaches.

A row that does not agree and has no reason fails the suite, and so does a reason that no row of a
recording needs.  The table itself is in known.py.
"""

import fnmatch
import math
import re
from dataclasses import dataclass
from typing import final

from vehicle_sim.conformance.rows import Row


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """Why some rows of some recordings do not agree."""

    recordings: str
    """Shell pattern of the file's name."""
    kind: str
    names: str
    """Regular expression for the whole name of the row."""
    why: str
    shown: str = ".*"
    """The same for what the simulated one shows."""
    most: float = math.inf
    """It explains differences up to so many tolerances."""

    def explains(self, recording: str, row: Row) -> bool:
        """Whether this row is one of them."""
        return (
            fnmatch.fnmatchcase(recording, self.recordings)
            and row.kind == self.kind
            and re.fullmatch(self.names, row.name) is not None
            and re.fullmatch(self.shown, row.simulated) is not None
            and row.difference <= self.most
        )
