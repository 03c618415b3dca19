"""Small worlds and missions for flights of one to two minutes, with real vehicles' speeds.

World k of a kind of vehicle is always the same: hills between start and target, some of them too
high to fly over, keep-outs that the mission names; every third one has a fence that the vehicle
itself carries, and every third one a radar.  A flood fill that knows nothing of planners proves
that there is a way through at the floor of the band; a world without one, or with a free straight
line, is drawn again.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from companion.campaign import truth
from companion.geodesy import LocalFrame
from companion.mission.mission import EndAction, Fallback, Mission
from companion.path.limits import Limits
from companion.planner.settings import PlannerSettings, Task
from companion.world.terrain import Peak, PeakTerrain
from companion.world.threats import CircleZone, PolygonZone, Radar, Zone
from vehicle_sim import world as sim

FloatArray = NDArray[np.float64]
Firmware = Literal["ardupilot", "px4"]
Kind = Literal["copter", "plane"]

LATITUDE_DEG, LONGITUDE_DEG, GROUND_AMSL_M = 47.397742, 8.545594, 488.0
_TRIES = 400


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Size:
    """What differs between the worlds of copters and of planes."""

    away_m: float
    """From the start to the target."""
    margin_m: float
    """From them to the edges of the map."""
    hills: tuple[int, int]
    foot_m: tuple[float, float]
    """Least and greatest radius of a hill at the height of the ground."""
    tops_m: tuple[float, float]
    """Heights of the hills above the ground."""
    climb_out_m: float
    """How far ahead of the start there is nothing."""
    band_m: tuple[float, float]
    """Floor and ceiling above the ground."""
    gap_m: float
    """Least room between hills and keep-outs."""
    wide_m: float
    """Width of the way through, beside the clearance."""


SIZES: dict[str, Size] = {
    "copter": Size(
        away_m=560.0,
        margin_m=350.0,
        hills=(6, 9),
        foot_m=(30.0, 75.0),
        gap_m=62.0,
        tops_m=(30.0, 120.0),
        climb_out_m=0.0,
        band_m=(16.0, 75.0),
        wide_m=8.0,
    ),
    "plane": Size(
        away_m=1900.0,
        margin_m=1100.0,
        hills=(3, 5),
        foot_m=(120.0, 260.0),
        gap_m=480.0,
        tops_m=(100.0, 260.0),
        climb_out_m=650.0,
        band_m=(70.0, 190.0),
        wide_m=60.0,
    ),
}


@final
@dataclass(frozen=True, kw_only=True)
class Scene:
    """One flight's world, mission, and the fence that the vehicle carries when it begins."""

    name: str
    autopilot: Firmware
    kind: Kind
    terrain: PeakTerrain
    """As a table of peaks; the heights are computed in `truth`."""
    mission: Mission
    fence: tuple[Zone, ...]
    heading_deg: float
    """Of the vehicle on the ground: a plane climbs out along it."""
    parameters: dict[str, float]

    @functools.cached_property
    def world(self) -> sim.World:
        """What the simulator flies in."""
        peaks = tuple(sim.Peak(**asdict(peak)) for peak in self.terrain.peaks)
        return sim.World(
            schema=1,
            name=self.name,
            origin=sim.Origin(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG),
            terrain=sim.TerrainTable(combine="maximum", ground_amsl_m=GROUND_AMSL_M, peaks=peaks),
            vehicle=sim.Vehicle(
                kind=self.kind,
                autopilot=self.autopilot,
                heading_deg=self.heading_deg,
                parameters=self.parameters,
            ),
            radars=tuple(
                sim.Threat(
                    name=radar.name,
                    north_m=radar.centre_nea_m[0],
                    east_m=radar.centre_nea_m[1],
                    altitude_amsl_m=radar.centre_nea_m[2],
                    range_m=radar.range_m,
                )
                for radar in self.mission.task.radars
            ),
            scanner=sim.Scanner(component_id=100, range_m=self.mission.task.settings.scan_range_m),
        )

    def through(self, *targets_ne_m: tuple[float, float]) -> "Scene":
        """The same world, with a mission to these targets."""
        return replace(self, mission=replace(self.mission, targets_ne_m=targets_ne_m))

    @property
    def safety_m(self) -> float:
        """d_s."""
        return self.mission.task.settings.safety_distance_m


VEHICLES = ("ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane")


def scene_of(vehicle: str, number: int) -> Scene:
    """World `number` for one of `VEHICLES`."""
    autopilot, kind = vehicle.split("-")
    return scene(autopilot, kind, number)  # type: ignore[arg-type]


@functools.cache
def scene(autopilot: Firmware, kind: Kind, number: int) -> Scene:
    """World `number` for this vehicle; the hills are the same for both autopilots."""
    size = SIZES[kind]
    for attempt in range(_TRIES):
        drawn = _drawn(autopilot, kind, number, attempt)
        if _has_a_way(drawn, size):
            return drawn
    raise AssertionError(f"no world {number} for a {kind} in {_TRIES} tries")


def _drawn(autopilot: Firmware, kind: Kind, number: int, attempt: int) -> Scene:
    rng = np.random.default_rng([1 if kind == "copter" else 2, number, attempt])
    size = SIZES[kind]
    bearing = rng.uniform(-math.pi, math.pi)
    along = np.array([math.cos(bearing), math.sin(bearing)])
    across = np.array([-along[1], along[0]])
    target = size.away_m * along
    spots: list[tuple[FloatArray, float]] = []
    peaks, keep_outs = [], []
    for each in (1, 2):
        radius = float(rng.uniform(0.04, 0.06) * size.away_m)
        at = _spot(rng, target, across, size, radius, spots, aside=0.08)
        if at is not None:
            keep_outs.append(
                CircleZone(
                    name=f"keep-out {each}",
                    north_m=float(at[0]),
                    east_m=float(at[1]),
                    radius_m=radius,
                )
            )
    for _ in range(rng.integers(size.hills[0], size.hills[1] + 1)):
        foot = float(rng.uniform(*size.foot_m))
        at = _spot(rng, target, across, size, foot, spots, aside=0.22)
        if at is not None:
            peaks.append(_hill(at, rng.uniform(*size.tops_m), foot))
    radars = ()
    if number % 3 == 1:
        range_m = float(rng.uniform(0.08, 0.12) * size.away_m)
        at = _spot(rng, target, across, size, 0.7 * range_m, spots, aside=0.15)
        if at is not None:
            centre = (float(at[0]), float(at[1]), GROUND_AMSL_M)
            radars = (Radar(name="radar", centre_nea_m=centre, range_m=range_m),)
    terrain = PeakTerrain(peaks=tuple(peaks), ground_amsl_m=GROUND_AMSL_M, sum_of_peaks=False)
    fence = _fence(rng, target, across, size) if number % 3 == 0 else ()
    mission = _mission(f"{kind}-{number}", kind, autopilot, target, size, tuple(keep_outs), radars)
    return Scene(
        name=mission.name,
        autopilot=autopilot,
        kind=kind,
        terrain=terrain,
        mission=mission,
        fence=fence,
        heading_deg=math.degrees(bearing + float(rng.uniform(-math.pi, math.pi))) % 360.0,
        parameters=_parameters(autopilot, kind),
    )


def _spot(
    rng: np.random.Generator,
    target: FloatArray,
    across: FloatArray,
    size: Size,
    radius_m: float,
    spots: list[tuple[FloatArray, float]],
    *,
    aside: float,
) -> FloatArray | None:
    """A place near the straight line for something so large, with room to pass all round."""
    for _ in range(30):
        at: FloatArray = (
            rng.uniform(0.2, 0.8) * target + rng.normal(0.0, aside) * size.away_m * across
        )
        rooms = [float(np.linalg.norm(at - there)) - radius_m - other for there, other in spots]
        if min(rooms, default=math.inf) > size.gap_m:
            spots.append((at, radius_m))
            return at
    return None


def _hill(at_ne_m: FloatArray, top_m: float, foot_m: float) -> Peak:
    """A mountain of eq. 1 that rises out of the ground at this radius."""
    height = GROUND_AMSL_M + top_m
    spread = foot_m / math.sqrt(math.log(height / GROUND_AMSL_M))
    return truth.mountain(float(at_ne_m[0]), float(at_ne_m[1]), height, (spread, spread))


def _fence(
    rng: np.random.Generator, target: FloatArray, across: FloatArray, size: Size
) -> tuple[Zone, ...]:
    """A polygon to stay out of, and one to stay inside of that holds start and target."""
    middle = rng.uniform(0.3, 0.7) * target + rng.normal(0.0, 0.08) * size.away_m * across
    angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, 6))
    corners = middle + 0.05 * size.away_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ahead = target / np.linalg.norm(target)
    reach = 0.8 * size.margin_m
    inside = [
        -reach * ahead - reach * across,
        target + reach * ahead - reach * across,
        target + reach * ahead + reach * across,
        -reach * ahead + reach * across,
    ]
    return (
        PolygonZone(name="fence out", vertices_ne_m=_pairs(corners)),
        PolygonZone(name="fence in", vertices_ne_m=_pairs(inside), keep_in=True),
    )


def _pairs(points: Sequence[FloatArray] | FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple((float(n), float(e)) for n, e in points)


def _mission(
    name: str,
    kind: Kind,
    autopilot: Firmware,
    target: FloatArray,
    size: Size,
    zones: tuple[Zone, ...],
    radars: tuple[Radar, ...],
) -> Mission:
    north, east = sorted((0.0, float(target[0]))), sorted((0.0, float(target[1])))
    edges = [(low - size.margin_m, high + size.margin_m) for low, high in (north, east)]
    floor, ceiling = (GROUND_AMSL_M + height for height in size.band_m)
    copter = kind == "copter"
    limits = Limits(
        speed_m_s=8.0 if copter else 18.0 if autopilot == "ardupilot" else 15.0,
        acceleration_m_s2=2.0,
        climb_rate_m_s=1.5 if copter else 3.0,
        turn_radius_m=25.0 if copter else 100.0,
        climb_angle_rad=math.radians(12.0 if copter else 6.0),
        dive_angle_rad=math.radians(10.0 if copter else 6.0),
        floor_amsl_m=floor,
        ceiling_amsl_m=ceiling,
        north_m=edges[0],
        east_m=edges[1],
        tracking_error_m=4.0 if copter else 15.0,
        navigation_error_m=3.0 if copter else 4.0,
        dead_man_s=3.5 if autopilot == "ardupilot" else 1.5,
        loiter_radius_m=0.0 if copter else 100.0 if autopilot == "ardupilot" else 80.0,
    )
    settings = PlannerSettings(
        scan_range_m=280.0 if copter else 1400.0,
        safety_distance_m=12.0 if copter else 30.0,
        planning_time_s=1.0,
        scan_time_s=4.0,
        overlap_m=40.0 if copter else 140.0,
        evaluations=1500,
    )
    return Mission(
        name=name,
        frame=LocalFrame(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG),
        targets_ne_m=((float(target[0]), float(target[1])),),
        task=Task(limits=limits, settings=settings, radars=radars, zones=zones),
        end_action=EndAction.HOLD,
        system_id=1,
        autopilot=autopilot,
        kind=kind,
        position_rate_hz=10.0,
        fallback=Fallback.HOLD,
    )


def _parameters(autopilot: Firmware, kind: Kind) -> dict[str, float]:
    """What an operator has set on the vehicle before the companion ever sees it."""
    if autopilot == "px4":
        lasts = {"SIM_BAT_DRAIN": 1800.0}
        return lasts | ({"SIH_KDV": 0.25} if kind == "copter" else {})
    lasts = {"BATT_CAPACITY": 20_000.0}
    return lasts if kind == "copter" else lasts | {"AIRSPEED_CRUISE": 18.0}


def _has_a_way(drawn: Scene, size: Size) -> bool:
    """Whether a wide way through exists at the floor of the band, and no straight one."""
    task, target = drawn.mission.task, np.array(drawn.mission.targets_ne_m[-1])
    limits, step = task.limits, size.wide_m / 4.0
    axes = [np.arange(low, high, step) for low, high in (limits.north_m, limits.east_m)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    need_m = task.search_clearance_m + limits.loiter_radius_m
    height = truth.height_m(drawn.terrain, grid[..., 0], grid[..., 1])
    blocked = height > limits.floor_amsl_m + 2.0 * task.error_m
    flat = grid.reshape(-1, 2)
    for zone in (*task.zones, *drawn.fence):
        gap = truth.keep_out_distance_m(flat, zone).reshape(blocked.shape)
        blocked |= (gap > 0.0) if zone.keep_in else (gap < 0.0)
    room = distance_transform_edt(~blocked) * step
    ends = [tuple(np.argmin(np.abs(a - v)) for a, v in zip(axes, p, strict=True))
            for p in (np.zeros(2), target)]  # fmt: skip
    if min(float(room[end]) for end in ends) < need_m + size.wide_m:
        return False
    heading = math.radians(drawn.heading_deg)
    climb = np.linspace(0.0, size.climb_out_m, 50)[:, None]
    ahead = climb * (math.cos(heading), math.sin(heading))
    if not (_at(room, axes, ahead, step) > need_m).all():
        return False
    open_, _ = label(room > need_m + size.wide_m)
    line = np.linspace(0.0, 1.0, 200)[:, None] * target
    straight = bool((_at(room, axes, line, step) > need_m).all())
    return bool(open_[ends[0]] == open_[ends[1]] != 0) and not straight


def _at(
    room: FloatArray, axes: Sequence[FloatArray], points: FloatArray, step: float
) -> FloatArray:
    """The room at points of the map; none beyond its edges.  (S, 2) -> (S,)."""
    rows = [((points[:, k] - axes[k][0]) / step).astype(int) for k in range(2)]
    on = np.all([(r >= 0) & (r < len(a)) for r, a in zip(rows, axes, strict=True)], axis=0)
    inside = tuple(np.clip(r, 0, len(a) - 1) for r, a in zip(rows, axes, strict=True))
    return np.where(on, room[inside], 0.0)
