"""Which items ArduPilot takes, and what it makes of them.

Sources: ardupilot.md 4, AP_Mission.cpp and AC_PolyFence_loader.cpp.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from vehicle_sim.autopilots import Text
from vehicle_sim.plans import PlanItem, PlanKind
from vehicle_sim.wire.mission_items import GLOBAL_FRAMES, MissionResult

RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004
"""MAV_CMD of fence items: polygon vertices and circles."""
RALLY_POINT: Final = 5100
_DO_JUMP: Final = 177
_POLYGONS: Final = frozenset({INCLUSION, EXCLUSION})
_CIRCLES: Final = frozenset({CIRCLE_IN, CIRCLE_OUT})
_SHAPE_NUMBERS: Final = {
    INCLUSION: 98,
    EXCLUSION: 97,
    RETURN_POINT: 95,
    CIRCLE_OUT: 93,
    CIRCLE_IN: 92,
}
"""AC_PolyFenceType, as its texts show it."""
_STORED_FRAME: Final = {0: 0, 5: 0, 2: 0, 3: 3, 6: 3, 10: 10, 11: 10}
"""Of items with a place: the frame that they come back in."""
_WITH_PLACE: Final = frozenset(
    {16, 17, 18, 19, 21, 22, 30, 31, 82, 84, 85, 94, 179, 188, 189, 191, 195, 201}
)
_WITHOUT_PLACE: Final = frozenset(
    {
        *(20, 83, 92, 93, 112, 114, 115, 177, 178, 181, 182, 183, 184, 194, 196, 197),
        *(202, 203, 205, 206, 207, 208, 210, 211, 212, 213, 215, 216, 217, 218, 222, 223),
        *(600, 601, 1000, 2000, 2001, 2500, 2501, 3000, 42600, 42702, 42703),
    }
)
_YAW_MAY_BE_NAN: Final = frozenset({16, 17, 18, 19, 21, 22, 31, 84, 85})
_HIGHEST_M: Final = 83_000.0
_LATITUDE_MAX_E7, _LONGITUDE_MAX_E7 = 900_000_000, 1_800_000_000
_INFO, _WARNING = 6, 4
"""MAV_SEVERITY."""


def stored(item: PlanItem, kind: PlanKind, last: int) -> PlanItem | MissionResult:
    """The item as ArduPilot stores it, so as it comes back; or why it does not take it.

    last: number of the last item of this upload, to which a jump may lead.
    """
    if kind is PlanKind.MISSION:
        if item.command == _DO_JUMP and not 0 < item.parameters[0] <= last:
            return MissionResult.ERROR
        return _stored_mission(item)
    if item.frame not in GLOBAL_FRAMES:
        return MissionResult.UNSUPPORTED_FRAME
    if kind is PlanKind.RALLY:
        if item.command != RALLY_POINT:
            return MissionResult.UNSUPPORTED
        return PlanItem(
            frame=_STORED_FRAME[item.frame],
            command=item.command,
            x=item.x,
            y=item.y,
            z_m=_finite(item.z_m),
        )
    if item.command not in _SHAPE_NUMBERS:
        return MissionResult.UNSUPPORTED
    shape = _finite(item.parameters[0])
    if item.command in _POLYGONS:
        shape = float(max(0, min(int(shape), 255)))  # a vertex count, in one byte
    return PlanItem(
        frame=0,
        command=item.command,
        parameters=(0.0 if item.command == RETURN_POINT else shape, 0.0, 0.0, 0.0),
        x=item.x,
        y=item.y,
        autocontinue=False,
    )


def _stored_mission(item: PlanItem) -> PlanItem | MissionResult:
    command = item.command
    if command not in _WITH_PLACE and command not in _WITHOUT_PLACE:
        return MissionResult.UNSUPPORTED
    for k, value in enumerate(item.parameters):
        allowed = k == 3 and command in _YAW_MAY_BE_NAN
        if math.isinf(value) or (math.isnan(value) and not allowed):
            return MissionResult(MissionResult.INVALID_PARAM1 + k)
    p1, p2, p3, p4 = (_finite(value) for value in item.parameters)
    frame, z_m = 0, item.z_m
    if command in _WITH_PLACE:
        if item.frame not in _STORED_FRAME:
            return MissionResult.UNSUPPORTED_FRAME
        if abs(item.x) > _LATITUDE_MAX_E7:
            return MissionResult.INVALID_PARAM5_X
        if abs(item.y) > _LONGITUDE_MAX_E7:
            return MissionResult.INVALID_PARAM6_Y
        if not abs(z_m) < _HIGHEST_M:  # so also what is not a number
            return MissionResult.INVALID_PARAM7
        frame = _STORED_FRAME[item.frame]
    return replace(
        item, frame=frame, parameters=(p1, p2, p3, p4), z_m=_finite(z_m), autocontinue=True
    )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def fence_fault(items: Sequence[PlanItem]) -> Text | None:
    """What is wrong with a whole fence; a polygon that crosses itself is taken."""
    left, wanted, count = 0, 0, 0
    has_return_point = False
    for item in items:
        command, size = item.command, item.parameters[0]
        if command in _POLYGONS:
            if size < 3:
                return _warning(f"Invalid vertex count ({int(size)})")
            if not left:
                left, wanted, count = int(size), command, int(size)
            elif command != wanted:
                return _warning(_mixed("vertex type", wanted, command))
            elif int(size) != count:
                return _warning(f"Unexpected vertex count want={count} got={int(size)}")
            left -= 1
        elif left:
            return _warning(_mixed("type", wanted, command))
        elif command in _CIRCLES and not size > 0:
            return _warning("Non-positive circle radius")
        elif command == RETURN_POINT:
            if has_return_point:
                return _warning("Multiple return points")
            has_return_point = True
        if abs(item.x) > _LATITUDE_MAX_E7 or abs(item.y) > _LONGITUDE_MAX_E7:
            return _warning("Bad lat or lon")
    return Text(severity=_INFO, text="Incorrect item count") if left else None


def only_circles_after_polygons(items: Sequence[PlanItem], before: Sequence[PlanItem]) -> bool:
    """Whether a fence of circles alone takes the place of one with a polygon."""
    has_polygon = [any(item.command in _POLYGONS for item in each) for each in (items, before)]
    return bool(items) and has_polygon == [False, True]


def _mixed(what: str, wanted: int, got: int) -> str:
    return f"Received incorrect {what} (want={_SHAPE_NUMBERS[wanted]} got={_SHAPE_NUMBERS[got]})"


def _warning(text: str) -> Text:
    return Text(severity=_WARNING, text=text)
