"""Random scenes of profile `flight`, with everything in them that its objective knows."""

import math
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray
from planning import ARDUCOPTER, drawn_zones, limits

from companion.objective import TERMS, Scene, Workspace, radar_table, rows_of, weights_of
from companion.path.envelope import envelope_of
from companion.path.subpath import Pose
from companion.planner.procedure import hover_pose
from companion.profiles import Weights
from companion.world.columns import Surface
from companion.world.radars import Radar
from companion.world.zones import PolygonZone, near_cells, packed

FloatArray = NDArray[np.float64]

R_M = 2_000.0
RADAR_MARGIN_M = 2.5
LIMITS = limits(
    speed_m_s=60.0,
    turn_radius_m=400.0,
    climb_angle_rad=0.1,
    dive_angle_rad=0.15,
    ceiling_amsl_m=800.0,
    north_m=(1_500.0, 5_500.0),
    east_m=(1_500.0, 5_500.0),
)


def random_pose(rng: np.random.Generator) -> Pose:
    """In the middle of the map, in any bend and climb that is not too steep."""
    heading, climb = rng.uniform(-math.pi, math.pi), rng.uniform(-0.2, 0.2)
    tangent = np.array([math.cos(heading), math.sin(heading), climb]) / math.hypot(1.0, climb)
    bend = rng.normal(0.0, 1.0 / 900.0, 3)
    return Pose(
        position_nea_m=np.append(rng.uniform(3_000.0, 4_000.0, 2), rng.uniform(400.0, 600.0)),
        tangent_nea=tangent,
        curvature_nea_1_m=bend - (bend @ tangent) * tangent,
    )


def random_scene(
    rng: np.random.Generator,
    *,
    points: int | None = None,
    from_rest: bool | None = None,
    is_final: bool | None = None,
    samples: int | None = None,
) -> Scene:
    """A scene in which random candidates break every bound now and then."""
    from_rest = bool(rng.random() < 0.5) if from_rest is None else from_rest
    is_final = bool(rng.random() < 0.3) if is_final is None else is_final
    start = random_pose(rng)
    if from_rest:
        start = hover_pose(start.position_nea_m, rng.uniform(-math.pi, math.pi))
    north, east, _ = start.point_nea_m
    weights = rng.uniform(0.05, 1.0, len(fields(Weights))).tolist()
    zones = drawn_zones(rng, int(rng.integers(0, 5)), 3_500.0, 1_500.0, 500.0, 0.3)
    polygons = tuple(zone for zone in zones if isinstance(zone, PolygonZone))
    near = near_cells(polygons, LIMITS.north_m, LIMITS.east_m, 75.0)
    drawn = Weights(**dict(zip(TERMS, weights, strict=False)))
    table = packed(zones)
    count = points or int(rng.integers(5, 7))
    radars = tuple(
        Radar(name="r", centre_nea_m=(*rng.uniform(2e3, 5e3, 2), 100.0), range_m=1_200.0)
        for _ in range(rng.integers(0, 4))
    )
    flies = LIMITS if rng.random() < 0.8 else replace(LIMITS, loiter_radius_m=80.0)
    motion = envelope_of(flies, ARDUCOPTER)
    if flies.hovers:  # bends that its turn radius allows are slow, too
        motion = motion._replace(lateral_m_s2=2.0)
    return Scene(
        weights=weights_of(drawn),
        margin=1.06,
        motion=motion,
        start=rows_of(start),
        from_rest=from_rest,
        shortest_m=0.0 if from_rest else float(rng.choice([200.0, 1_500.0])),
        scan_ne_m=(north + rng.uniform(-300.0, 300.0), east + rng.uniform(-300.0, 300.0)),
        scan_range_m=R_M,
        end_radius_m=1_700.0,
        is_final=is_final,
        final_ne_m=(north + rng.uniform(-1e3, 1e3), east + 400.0),
        guide_rad=rng.uniform(-math.pi, math.pi),
        to_go=lattice(rng, 100.0, 4_000.0),
        needed=lattice(rng, 90.0, 900.0),
        descent_m=900.0,
        safety_distance_m=60.0,
        clearance_m=75.0,
        surface=lattice(rng, 40.0, 500.0),
        contact=lattice(rng, 40.0, 450.0),
        band_amsl_m=(315.0, 785.0),
        north_m=LIMITS.north_m,
        east_m=LIMITS.east_m,
        radars=radar_table(radars, RADAR_MARGIN_M),
        zones=table,
        near_polygons=near if rng.random() < 0.5 else near._replace(near=near.near[:0, :0]),
        at=Workspace.of(count, samples or int(rng.choice([12, 13, 40])), len(polygons)),
    )


def lattice(rng: np.random.Generator, cell_m: float, most_m: float) -> Surface:
    """A rough surface over most of where candidates come."""
    count = math.ceil(6_000.0 / cell_m)
    south, west = rng.uniform(-100.0, 1_500.0, 2)
    return Surface(
        north_min_m=float(south),
        east_min_m=float(west),
        cell_m=cell_m,
        vertex_m=rng.uniform(0.0, most_m, (count, count + 3)),
    )


def cube(rng: np.random.Generator, scene: Scene, count: int) -> FloatArray:
    """Candidates, some of them on faces and corners of the cube."""
    return np.clip(rng.uniform(-0.15, 1.15, (count, scene.variables)), 0.0, 1.0)
