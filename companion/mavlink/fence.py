"""The vehicle's own fence: its list to zones, what is in force of it, and what is told of it.

Sources: ardupilot.md 4, px4.md 7, MAV_CMD 5000 to 5004 and 5100.  Where autopilots differ or a
fence is ambiguous, the more restrictive reading is taken and noted.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np
import shapely
from msgspec import structs

from companion.geodesy import LocalFrame, deg, parts_within, short_way
from companion.mavlink.dialect import AMSL_FRAMES, HOME_FRAMES, TERRAIN_FRAMES, enum_word, wire
from companion.mavlink.plan_client import FENCE, PlanClient, PlanItem
from companion.mission.events import FenceChanged, FenceReading, Vector
from companion.mission.mission import Mission
from companion.planner.settings import Task
from companion.world.zones import CircleZone, PolygonZone, Zone, gaps_m

if TYPE_CHECKING:  # it says of its fence what stands here
    from companion.mavlink.autopilots.common import Autopilot

Point = tuple[float, float]
"""North and east, metres."""
RETURN_POINT: Final = wire.MAV_CMD_NAV_FENCE_RETURN_POINT
POLYGON_IN: Final = wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
POLYGON_OUT: Final = wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
CIRCLE_IN: Final = wire.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
CIRCLE_OUT: Final = wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
_LARGEST_M = 2.1e7  # half of the way around the Earth
_CORNERS_AT_ONCE = 250
"""Enough for one event."""
_EARTH_M, _NEAR_M = 6.37e6, 1e6
_AROUND_M = (-5e5, 5e5)
"""Of what has corners beyond that, the part so near: farther than any flight."""
_STRAIGHT_M = 0.5
"""Allowed distance between an edge straight in degrees and one straight in the local frame."""
_MOST_PARTS = 512
_SAME_M = 1e-3
"""Corners nearer than that in a row are one."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FenceSettings:
    """What an autopilot's parameters say of its fence, besides the uploaded list."""

    margin_m: float = 0.0
    union: bool = False
    """Whether of several inclusion zones one is enough."""
    radius_m: float | None = None
    """Of a cylinder about home; None: unlimited."""
    above_m: float | None = None
    """Highest above home."""
    below_m: float | None = None
    """Lowest above home."""
    note: str = ""
    """To the operator, if there is a fence."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Fence:
    """A vehicle's own fence, as the planner needs it."""

    zones: tuple[Zone, ...] = ()
    floor_amsl_m: float | None = None
    ceiling_amsl_m: float | None = None
    notes: tuple[str, ...] = ()
    """Assumptions and changes, one line each, as text for the operator."""
    refusal: str = ""
    """Why this fence cannot be respected."""
    needs_home: bool = False
    """Whether a part is missing until home is known."""
    misread: str = ""
    """Which shapes the autopilot itself misreads, and the remedy; empty: none."""


# --- fence ----------------------------------------------------------------------------------------


def in_force(
    drawn: Fence,
    settings: FenceSettings,
    *,
    home_nea_m: Vector | None = None,
    here_ne_m: Point | None = None,
) -> Fence:
    """The fence in force: the uploaded one, and what parameters add or switch off.

    home_nea_m: the vehicle's home; without it nothing is drawn about it.  here_ne_m: where the
    vehicle is: of inclusion zones of which one is enough, those that it is in.
    """
    zones, notes, refusal = list(drawn.zones), list(drawn.notes), drawn.refusal
    inside = kept = [zone for zone in zones if zone.keep_in]
    if len(inside) > 1:
        if settings.union and here_ne_m is not None:  # their intersection lies inside the union
            kept = [zone for zone in inside if _distance_m(zone, here_ne_m) > 0.0] or inside
        zones = [zone for zone in zones if not zone.keep_in or zone in kept]
        names = ", ".join(zone.name for zone in kept)
        several = f"of {len(inside)} inclusion zones the vehicle stays inside of all of"
        notes.append(f"{several}: {names}")
    if settings.note and (drawn.zones or refusal):
        notes.append(settings.note)
    radius_m, above_m, below_m = settings.radius_m, settings.above_m, settings.below_m
    needs_home = home_nea_m is None and (radius_m, above_m, below_m) != (None, None, None)
    if needs_home:
        notes.append("fence about home: home is not known yet, so it is not drawn yet")
        radius_m = above_m = below_m = None
    north_m, east_m, up_m = home_nea_m or (0.0, 0.0, 0.0)
    margin_m = settings.margin_m
    if radius_m is not None and radius_m <= margin_m:
        wide = f"a radius of {radius_m:g} m, no more than its margin"
        refusal = refusal or f"fence about home has {wide}. Widen it"
    elif radius_m is not None:
        name = f"fence about home (radius {radius_m:g} m)"
        zones.append(_circle(name, (north_m, east_m), radius_m - margin_m, keep_in=True))
    return replace(
        drawn,
        zones=tuple(zones),
        notes=tuple(notes),
        refusal=refusal,
        needs_home=needs_home,
        ceiling_amsl_m=None if above_m is None else up_m + above_m - margin_m,
        floor_amsl_m=None if below_m is None else up_m + below_m + margin_m,
    )


def drawn(items: Sequence[PlanItem], frame: LocalFrame, margin_m: float) -> Iterator[Fence | None]:
    """The zones of a fence list, in small portions, so that nothing is delayed: at last the fence.

    Items that cannot be decoded prevent a flight, and are only noted during one.
    """
    zones, said, wrongs, corners = list[Zone](), list[str](), list[str](), 0
    for number, shape in enumerate(shapes_of(items), start=1):
        one = _drawn_one(shape, frame, margin_m, number)
        zones += [] if one.zone is None else [one.zone]
        said += [one.note] if one.note else []
        wrongs += [one.wrong] if one.wrong else []
        corners += len(shape)
        if corners >= _CORNERS_AT_ONCE:
            corners = 0
            yield None
    notes = (*said, *wrongs[1:])
    yield Fence(zones=tuple(zones), notes=notes, refusal=wrongs[0] if wrongs else "")


def shapes_of(items: Sequence[PlanItem]) -> Iterator[tuple[PlanItem, ...]]:
    """The items of each circle or polygon; others by themselves, but no return points."""
    index = 0
    while index < len(items):
        item, count = items[index], 1
        if item.command in (POLYGON_IN, POLYGON_OUT):
            wanted = item.parameters[0]
            while (
                count < wanted < math.inf
                and index + count < len(items)
                and items[index + count].command == item.command
            ):
                count += 1
        if item.command != RETURN_POINT:
            yield tuple(items[index : index + count])
        index += count


class _One(NamedTuple):
    """The zone of one shape, a note about it, and why it cannot be respected."""

    zone: Zone | None = None
    note: str = ""
    wrong: str = ""


def _unfit(why: str) -> _One:
    return _One(wrong=f"{why}. Draw it again")


def _drawn_one(
    shape: tuple[PlanItem, ...], frame: LocalFrame, margin_m: float, number: int
) -> _One:
    first, wanted = shape[0], shape[0].parameters[0]
    keep_in = first.command in (POLYGON_IN, CIRCLE_IN)
    name = f"fence {'inclusion' if keep_in else 'exclusion'} {number}"
    if first.command not in (POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT):
        what = enum_word("MAV_CMD", first.command) or first.command
        return _unfit(f"fence item {number} is no fence ({what})")
    placed = {*AMSL_FRAMES, *HOME_FRAMES, *TERRAIN_FRAMES}
    if frames := {item.frame for item in shape} - placed:
        return _unfit(f"{name}: frame {min(frames)} has no latitude and longitude")
    places = places_of(shape, frame)
    if places is None or any(item.x == item.y == 0 for item in shape):
        return _unfit(f"{name} has a corner that is nowhere on Earth")
    if first.command in (POLYGON_IN, POLYGON_OUT):
        whole = len(shape) == wanted and all(item.parameters[0] == wanted for item in shape)
        return _polygon(places, name, margin_m, keep_in=keep_in, whole=whole)
    if not 0.0 < wanted <= _LARGEST_M:
        return _unfit(f"{name}: a circle needs a radius, it has {wanted:g} m")
    radius_m = wanted - margin_m if keep_in else wanted + margin_m
    if radius_m <= 0.0:
        return _One(wrong=f"{name} is smaller than FENCE_MARGIN. Draw it larger")
    return _One(_circle(name, places[0], radius_m, keep_in=keep_in))


def _circle(name: str, centre_ne_m: Point, radius_m: float, *, keep_in: bool) -> CircleZone:
    north_m, east_m = centre_ne_m
    return CircleZone(name=name, north_m=north_m, east_m=east_m, radius_m=radius_m, keep_in=keep_in)


def _polygon(
    places: Sequence[Point], name: str, margin_m: float, *, keep_in: bool, whole: bool
) -> _One:
    """The zone of a polygon: its hull, where a margin or the rule of autopilots needs that.

    Out of one that crosses itself they keep by the even-odd rule, so it has holes: its hull has
    none.  Inside of one they keep by the same rule as the zone.
    """
    pairs = zip(places, (places[-1], *places), strict=False)
    vertices = tuple(one for one, before in pairs if math.dist(one, before) > _SAME_M)
    note = wrong = ""
    if len(vertices) < 3:
        return _unfit(f"{name} needs three corners")
    if not whole:
        wrong = f"{name} is incomplete: its corners are not as many as it says"
        if keep_in:
            return _unfit(wrong)
        wrong += ", the vehicle keeps out of their hull. Draw it again"
    elif not shapely.is_simple(shapely.LinearRing(vertices)):
        if keep_in:
            note = f"{name} crosses itself: it is kept by the even-odd rule, without FENCE_MARGIN"
            return _One(PolygonZone(name=name, vertices_ne_m=vertices, keep_in=True), note)
        note = f"{name} crosses itself: the vehicle keeps out of its hull"
    if note or wrong:
        vertices = _corners(shapely.MultiPoint(vertices).convex_hull)
        if len(vertices) < 3:
            return _unfit(f"{name} has no area")
    if margin_m != 0.0:
        outwards_m = -margin_m if keep_in else margin_m
        moved = _corners(shapely.Polygon(vertices).buffer(outwards_m, join_style="mitre"))
        if not moved:  # nothing is left, or parts that hang apart
            note = f"{name} is too jagged for FENCE_MARGIN: it is kept without"
        vertices = moved or vertices
    return _One(PolygonZone(name=name, vertices_ne_m=vertices, keep_in=keep_in), note, wrong)


def _corners(shape: Any) -> tuple[Point, ...]:
    """Of the outline of a polygon; of anything else none."""
    if shape.is_empty or shape.geom_type != "Polygon":
        return ()
    return tuple((north, east) for north, east in shape.exterior.coords[:-1])


def places_of(shape: Sequence[PlanItem], frame: LocalFrame) -> list[Point] | None:
    """Its corners here, with more between where a side that is straight in degrees is not here."""
    if any(abs(item.x) > 900_000_000 or abs(item.y) > 1_800_000_000 for item in shape):
        return None
    corners = [(deg(item.x), deg(item.y)) for item in shape]
    if len(corners) >= 3:
        corners = _straight(_part_near(short_way(corners) or corners, frame))
    places = np.stack(frame.to_local_m(*np.array(corners).T), axis=-1)
    if not np.isfinite(places).all():
        return None
    return [(north, east) for north, east in places.tolist()]


def _part_near(corners_deg: list[Point], frame: LocalFrame) -> list[Point]:
    """Of a polygon with far corners, the part about the origin; all of it if none is near."""
    if np.hypot(*frame.to_local_m(*np.array(corners_deg).T)).max() <= _NEAR_M:
        return corners_deg
    parts = parts_within(corners_deg, frame, _AROUND_M, _AROUND_M)
    return parts[0] if len(parts) == 1 else corners_deg


def _straight(corners_deg: list[Point]) -> list[Point]:
    """With so many places on each side that what is straight in degrees is straight enough here.

    A side bulges by length^2 (tan(latitude) + 1) / (8 R) at most, and by a quarter in each half.
    """
    begin = np.array(corners_deg)
    along = np.roll(begin, -1, axis=0) - begin
    ends = np.radians(np.abs([begin[:, 0], begin[:, 0] + along[:, 0]]))
    length_m = np.radians(np.hypot(along[:, 0], along[:, 1] * np.cos(ends.min(axis=0)))) * _EARTH_M
    bulge_m = length_m**2 * (np.tan(ends.max(axis=0)) + 1.0) / (8.0 * _EARTH_M)
    parts = np.clip(np.ceil(np.sqrt(bulge_m / _STRAIGHT_M)), 1, _MOST_PARTS).astype(int)
    share = np.concatenate([np.arange(count) / count for count in parts])
    places = np.repeat(begin, parts, axis=0) + share[:, None] * np.repeat(along, parts, axis=0)
    return [(latitude, longitude) for latitude, longitude in places.tolist()]


def _distance_m(zone: Zone, place_ne_m: Point) -> float:
    north, east = (np.asarray(value) for value in place_ne_m)
    return float(zone.distance_m(north, east))


def conflicts(fence: Fence, task: Task, targets_ne_m: Sequence[Point]) -> tuple[str, ...]:
    """Why a mission cannot keep to a fence, one line each: the place, the rule, the remedy."""
    found = [fence.refusal] if fence.refusal else []
    for number, target in enumerate(targets_ne_m, start=1):
        north, east = (np.asarray(value) for value in target)
        if gaps_m(fence.zones, north, east, task.zone_clearance_m) >= task.zone_clearance_m:
            continue
        for zone in sorted(fence.zones, key=lambda zone: isinstance(zone, PolygonZone)):
            short_m = task.zone_clearance_m - _distance_m(zone, target)
            if short_m > 0.0:
                side = "inside" if zone.keep_in else "outside"
                found.append(
                    f"target {number}: {short_m:.0f} m too far from being {side} of the vehicle's "
                    f"{zone.name} by the clearance of {task.zone_clearance_m:.0f} m. "
                    "Move the target, or change the fence"
                )
    low_m, high_m = task.limits.floor_amsl_m, task.limits.ceiling_amsl_m
    bottom_m = max(low_m, low_m if fence.floor_amsl_m is None else fence.floor_amsl_m)
    top_m = min(high_m, high_m if fence.ceiling_amsl_m is None else fence.ceiling_amsl_m)
    if top_m - bottom_m <= 2.2 * task.error_m:
        found.append(
            f"altitudes: the vehicle's fence leaves {bottom_m:.0f} to {top_m:.0f} m AMSL of the "
            f"mission's {low_m:.0f} to {high_m:.0f} m, less than its errors. "
            "Change the fence's heights or [altitude]"
        )
    return tuple(found)


# --- as list, parameters and home change ----------------------------------------------------------


@final
class OwnFence:
    """Follows the fence of one vehicle.  Until all of a new one is known the old stays in force."""

    def __init__(self, mission: Mission, autopilot: "Autopilot", plans: PlanClient) -> None:
        self.fence: Fence | None = None
        """As it stands, once it was read."""
        self.notes: list[str] = []
        """What a person should hear of, since last looked at."""
        self.warnings: list[str] = []
        """The same, of what is grave."""
        self._mission, self._autopilot, self._plans = mission, autopilot, plans
        self._drawing_of: tuple[int, float] | None = None
        self._drawing: Iterator[Fence | None] | None = None
        self._drawn: Fence | None = None
        """The newest list, once all of it is drawn."""
        self._made_of: object = None
        self._told: FenceChanged | None = None
        self._said: tuple[str, ...] = ()
        self._reading = 0

    @property
    def is_drawing(self) -> bool:
        """Whether it goes on with the next message."""
        return self._drawing is not None

    def rebooted(self) -> None:
        """The autopilot has rebooted: what is read again is held against the mission again."""
        self._reading, self._made_of = 0, None
        if self._told is not None and self._told.zones:
            self.notes.append(f"fence: read again, {len(self._told.zones)} zones stay in force")

    def reading(self, now_s: float) -> list[FenceReading]:
        """Whether one that has changed is being read, and drawn, by now."""
        items = self._plans.changing.get(FENCE, 0)
        if not items and self.is_drawing:
            items = self._reading
        if items == self._reading:
            return []
        self._reading = items
        return [FenceReading(time_s=now_s, items=items)]

    def update(
        self,
        parameters: Mapping[str, float],
        home_nea_m: Vector | None,
        here_ne_m: Point | None,
        now_s: float,
    ) -> tuple[list[FenceChanged], str] | None:
        """What is new, and why the mission conflicts with it; None while it is drawn.

        here_ne_m: where the vehicle is, as in `in_force`.
        """
        mission, plan = self._mission, self._plans.plans[FENCE]
        firmware, name = self._autopilot.firmware, self._autopilot.name
        settings = firmware.fence(parameters)
        if (plan.version, settings.margin_m) != self._drawing_of:
            self._drawing_of = (plan.version, settings.margin_m)
            self._drawing = drawn(plan.items, mission.frame, settings.margin_m)
        if self._drawing is not None:
            if (whole := next(self._drawing)) is None:
                return None
            self._drawing = None
            self._drawn = replace(whole, misread=firmware.misread(plan.items, name))
        made_of = self._drawing_of, settings, home_nea_m
        if made_of == self._made_of or self._drawn is None:
            return [], ""
        self._made_of = made_of
        whole = self.fence = in_force(
            self._drawn, settings, home_nea_m=home_nea_m, here_ne_m=here_ne_m
        )
        self.notes += [each for each in whole.notes if each not in self._said]
        self.warnings += [whole.misread] if whole.misread not in ("", *self._said) else []
        self._said = (*whole.notes, whole.misread)
        told = FenceChanged(
            time_s=now_s,
            zones=whole.zones,
            floor_amsl_m=whole.floor_amsl_m,
            ceiling_amsl_m=whole.ceiling_amsl_m,
            misread=bool(whole.misread),
        )
        against = conflicts(whole, mission.task, mission.targets_ne_m)
        before, same = self._told, structs.replace(told, time_s=0.0)
        is_news = same != before and not whole.needs_home
        self._told = before if whole.needs_home else same
        return [told] if is_news else [], against[0] if against else ""
