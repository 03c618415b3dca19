"""The vehicle's own fence: its list to zones, what is in force of it, and what is told of it.

Sources: ardupilot.md 4, px4.md 7, MAV_CMD 5000 to 5004 and 5100.  Where autopilots differ or a
fence is ambiguous, the more restrictive reading is taken and noted.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
import shapely
from msgspec import structs

from companion.geodesy import LocalFrame, deg, parts_within, short_way, straight_in_degrees
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
_POLYGONS: Final = (POLYGON_IN, POLYGON_OUT)
_EVEN_ODD: Final = "it is kept by the even-odd rule, without FENCE_MARGIN"
_LARGEST_M = 2.1e7  # half of the way around the Earth
_CORNERS_AT_ONCE = 250
"""Enough for one event."""
_NEAR_M = 1e6
_AROUND_M = (-5e5, 5e5)
"""Of what has corners beyond that, the part so near: farther than any flight."""
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

    @property
    def is_about_home(self) -> bool:
        """Whether there is none before home is known."""
        return (self.radius_m, self.above_m, self.below_m) != (None, None, None)


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
    if settings.union and here_ne_m is not None:  # their intersection lies inside the union
        north, east = map(np.asarray, here_ne_m)
        kept = [zone for zone in inside if zone.distance_m(north, east) > 0.0] or inside
    if len(inside) > 1:
        zones = [zone for zone in zones if not zone.keep_in or zone in kept]
        names = ", ".join(zone.name for zone in kept)
        several = f"of {len(inside)} inclusion zones the vehicle stays inside of all of"
        notes.append(f"{several}: {names}")
    if settings.note and (drawn.zones or refusal):
        notes.append(settings.note)
    radius_m, above_m, below_m = settings.radius_m, settings.above_m, settings.below_m
    if home_nea_m is None:
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
        ceiling_amsl_m=None if above_m is None else up_m + above_m - margin_m,
        floor_amsl_m=None if below_m is None else up_m + below_m + margin_m,
    )


def drawn(items: Sequence[PlanItem], frame: LocalFrame, margin_m: float) -> Iterator[Fence | None]:
    """The zones of a fence list, in small portions, so that nothing is delayed: at last the fence.

    Items that cannot be decoded prevent a flight, and are only noted during one.
    """
    parts, corners = list[Fence](), 0
    for number, shape in enumerate(shapes_of(items), start=1):
        parts.append(_drawn_one(shape, frame, margin_m, number))
        corners += len(shape)
        if corners >= _CORNERS_AT_ONCE:
            corners = 0
            yield None
    refusals = [part.refusal for part in parts if part.refusal]
    yield Fence(
        zones=tuple(chain.from_iterable(part.zones for part in parts)),
        notes=(*chain.from_iterable(part.notes for part in parts), *refusals[1:]),
        refusal=refusals[0] if refusals else "",
    )


def shapes_of(items: Sequence[PlanItem]) -> Iterator[tuple[PlanItem, ...]]:
    """The items of each circle or polygon; others by themselves, but no return points."""
    index = 0
    while index < len(items):
        item, count = items[index], 1
        if item.command in _POLYGONS:
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


def _unfit(why: str) -> Fence:
    return Fence(refusal=f"{why}. Draw it again")


def _drawn_one(
    shape: tuple[PlanItem, ...], frame: LocalFrame, margin_m: float, number: int
) -> Fence:
    """What one shape alone would be, circle or polygon."""
    first, wanted = shape[0], shape[0].parameters[0]
    keep_in, is_polygon = first.command in (POLYGON_IN, CIRCLE_IN), first.command in _POLYGONS
    name = f"fence {'inclusion' if keep_in else 'exclusion'} {number}"
    if not is_polygon and first.command not in (CIRCLE_IN, CIRCLE_OUT):
        what = enum_word("MAV_CMD", first.command) or first.command
        return _unfit(f"fence item {number} is no fence ({what})")
    if frames := {item.frame for item in shape} - {*AMSL_FRAMES, *HOME_FRAMES, *TERRAIN_FRAMES}:
        return _unfit(f"{name}: frame {min(frames)} has no latitude and longitude")
    places = places_of(shape, frame)
    if places is None or any(item.x == item.y == 0 for item in shape):
        return _unfit(f"{name} has a corner that is nowhere on Earth")
    if is_polygon:
        if len({(item.x, item.y) for item in shape}) < 3:  # before long sides get more corners
            return _unfit(f"{name} needs three corners")
        whole = len(shape) == wanted and all(item.parameters[0] == wanted for item in shape)
        return _polygon(places, name, margin_m, keep_in=keep_in, whole=whole)
    if not 0.0 < wanted <= _LARGEST_M:
        return _unfit(f"{name}: a circle needs a radius, it has {wanted:g} m")
    radius_m = wanted - margin_m if keep_in else wanted + margin_m
    if radius_m <= 0.0:
        return Fence(refusal=f"{name} is smaller than FENCE_MARGIN. Draw it larger")
    return Fence(zones=(_circle(name, places[0], radius_m, keep_in=keep_in),))


def _circle(name: str, centre_ne_m: Point, radius_m: float, *, keep_in: bool) -> CircleZone:
    north_m, east_m = centre_ne_m
    return CircleZone(name=name, north_m=north_m, east_m=east_m, radius_m=radius_m, keep_in=keep_in)


def _polygon(
    places: Sequence[Point], name: str, margin_m: float, *, keep_in: bool, whole: bool
) -> Fence:
    """The zone of a polygon: its hull, where a margin or the rule of autopilots needs that.

    Out of one that crosses itself they keep by the even-odd rule, so it has holes: its hull has
    none.  Inside of one they keep by the same rule as the zone.
    """
    pairs = zip(places, (places[-1], *places), strict=False)
    vertices = tuple(one for one, before in pairs if math.dist(one, before) > _SAME_M)
    if len(vertices) < 3:
        return _unfit(f"{name} needs three corners")
    crosses = whole and not shapely.is_simple(shapely.LinearRing(vertices))
    lacks = f"{name} is incomplete: its corners are not as many as it says"
    if keep_in and not whole:
        return _unfit(lacks)
    refusal = "" if whole else f"{lacks}, the vehicle keeps out of their hull. Draw it again"
    notes: tuple[str, ...] = ()
    if crosses and keep_in:
        notes, margin_m = (f"{name} crosses itself: {_EVEN_ODD}",), 0.0
    elif crosses:
        notes = (f"{name} crosses itself: the vehicle keeps out of its hull",)
    if not keep_in and (crosses or not whole):
        vertices = _corners(shapely.MultiPoint(vertices).convex_hull)
        if len(vertices) < 3:
            return _unfit(f"{name} has no area")
    if margin_m != 0.0:
        outwards_m = -margin_m if keep_in else margin_m
        moved = _corners(shapely.Polygon(vertices).buffer(outwards_m, join_style="mitre"))
        if not moved:  # nothing is left, or parts that hang apart
            notes = (f"{name} is too jagged for FENCE_MARGIN: it is kept without",)
        vertices = moved or vertices
    zone = PolygonZone(name=name, vertices_ne_m=vertices, keep_in=keep_in)
    return Fence(zones=(zone,), notes=notes, refusal=refusal)


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
        corners = straight_in_degrees(_part_near(short_way(corners) or corners, frame))
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


def conflicts(fence: Fence, task: Task, targets_ne_m: Sequence[Point]) -> tuple[str, ...]:
    """Why a mission cannot keep to a fence, one line each: the place, the rule, the remedy."""
    reasons, clearance_m = [fence.refusal] if fence.refusal else [], task.zone_clearance_m
    north, east = np.reshape(targets_ne_m, (-1, 2)).T
    for number in np.flatnonzero(gaps_m(fence.zones, north, east) < clearance_m):
        for zone in fence.zones:
            short_m = clearance_m - float(zone.distance_m(north[number], east[number]))
            if short_m > 0.0:
                side = "inside" if zone.keep_in else "outside"
                reasons.append(
                    f"target {number + 1}: {short_m:.0f} m too far from being {side} of the "
                    f"vehicle's {zone.name} by the clearance of {clearance_m:.0f} m. "
                    "Move the target, or change the fence"
                )
    low_m, high_m = task.limits.floor_amsl_m, task.limits.ceiling_amsl_m
    bottom_m = max(low_m, low_m if fence.floor_amsl_m is None else fence.floor_amsl_m)
    top_m = min(high_m, high_m if fence.ceiling_amsl_m is None else fence.ceiling_amsl_m)
    if top_m - bottom_m <= 2.2 * task.error_m:
        reasons.append(
            f"altitudes: the vehicle's fence leaves {bottom_m:.0f} to {top_m:.0f} m AMSL of the "
            f"mission's {low_m:.0f} to {high_m:.0f} m, less than its errors. "
            "Change the fence's heights or [altitude]"
        )
    return tuple(reasons)


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
        self._mission, self._autopilot, self._plans = mission, autopilot, plans.plans
        self._drawing_of: tuple[int, float] | None = None
        self._drawing: Iterator[Fence | None] | None = None
        self._drawn = Fence()
        """The newest list, once all of it is drawn."""
        self._made_of: object = None
        self._last_event: FenceChanged | None = None
        self._noted: tuple[str, ...] = ()
        self._reading = 0

    @property
    def is_drawing(self) -> bool:
        """Whether it goes on with the next message."""
        return self._drawing is not None

    def rebooted(self) -> None:
        """The autopilot has rebooted: what is read again is held against the mission again."""
        self._reading, self._made_of = 0, None
        if (before := self._last_event) is not None and before.zones:
            self.notes.append(f"fence: read again, {len(before.zones)} zones stay in force")

    def reading(self, now_s: float) -> list[FenceReading]:
        """Whether one that has changed is being read, and drawn, by now."""
        items = self._plans[FENCE].changing or (self._reading if self.is_drawing else 0)
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
        """What is new, and why the mission conflicts with it; None until it can be told.

        Not while it is drawn, nor without home where that is needed.  here_ne_m: where the vehicle
        is, as in `in_force`.
        """
        mission, plan, firmware = self._mission, self._plans[FENCE], self._autopilot.firmware
        settings = firmware.fence(parameters)
        if (plan.version, settings.margin_m) != self._drawing_of:
            self._drawing_of = (plan.version, settings.margin_m)
            self._drawing = drawn(plan.items, mission.frame, settings.margin_m)
        if self._drawing is not None:
            if (whole := next(self._drawing)) is None:
                return None
            misread = firmware.misread(plan.items, self._autopilot.name)
            self._drawing, self._drawn = None, replace(whole, misread=misread)
        if settings.is_about_home and home_nea_m is None:
            return None
        made_of = self._drawing_of, settings, home_nea_m
        if made_of == self._made_of:
            return [], ""
        self._made_of = made_of
        whole = self.fence = in_force(
            self._drawn, settings, home_nea_m=home_nea_m, here_ne_m=here_ne_m
        )
        self.notes += [note for note in whole.notes if note not in self._noted]
        self.warnings += [whole.misread] if whole.misread not in ("", *self._noted) else []
        self._noted = (*whole.notes, whole.misread)
        against = conflicts(whole, mission.task, mission.targets_ne_m)
        refusal = against[0] if against else ""
        event = FenceChanged(
            time_s=now_s,
            zones=whole.zones,
            floor_amsl_m=whole.floor_amsl_m,
            ceiling_amsl_m=whole.ceiling_amsl_m,
            misread=bool(whole.misread),
        )
        same = structs.replace(event, time_s=0.0)
        if same == self._last_event:
            return [], refusal
        self._last_event = same
        return [event], refusal
