"""What the companion does not do at the places of a mission, wherever the mission comes from."""

from collections.abc import Iterator, Sequence
from typing import Final

from companion.mavlink.dialect import wire

_LOITER: Final = "loiter at a waypoint"
_INSTEAD: Final = {
    wire.MAV_CMD_NAV_SPLINE_WAYPOINT: "spline at a waypoint",
    wire.MAV_CMD_NAV_LOITER_TURNS: _LOITER,
    wire.MAV_CMD_NAV_LOITER_TIME: _LOITER,
    wire.MAV_CMD_NAV_LOITER_TO_ALT: _LOITER,
}
"""Commands that go to a place, and what of them is not done."""
_OF_WAYPOINTS: Final = (
    "waiting at a waypoint",
    "acceptance radius of a waypoint",
    "passing beside a waypoint",
    "heading at a waypoint",
)
"""Parameters 1 to 4 of a waypoint; 0, like no number, asks for nothing (4: north, which also stands
for nothing in most files)."""


def not_done(command: int, parameters: Sequence[float | None]) -> Iterator[str]:
    """What of an item that goes to a place is left out, in words; parameters: 1 to 4."""
    if command in _INSTEAD:
        yield _INSTEAD[command]
    if command in (wire.MAV_CMD_NAV_WAYPOINT, wire.MAV_CMD_NAV_SPLINE_WAYPOINT):
        for value, words in zip(parameters, _OF_WAYPOINTS, strict=False):
            if value is not None and abs(value) > 0.0:  # not what is no number
                yield words
