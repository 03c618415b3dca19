"""What depth cameras say, point by point: OBSTACLE_DISTANCE_3D."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mavlink.near_scanner import NearScanner
from companion.mavlink.near_sensing import NearSensing, Poses, Sight
from companion.world.near_map import NearMap, NearSensor, Rules, Sweep
from companion.world.rays import Lattice

FloatArray = NDArray[np.float64]
BEAM_RAD = math.radians(4.0)
REACH_M = 12.0
CAMERA = NearSensor(
    kind="obstacle_distance_3d",
    component_id=196,
    range_m=REACH_M,
    latency_s=0.0,
    beam_rad=BEAM_RAD,
    speaks_for_m=2.0,
)
NOW_S = 10.0
HEIGHT_M = 3.0
"""Of the vehicle above the ground, which is at 0."""


def poses(
    yaw_rad: float = 0.0, roll_rad: float = 0.0, pitch_rad: float = 0.0, at_s: float = NOW_S
) -> Poses:
    known = Poses()
    for time_s in (at_s - 0.2, at_s, at_s + 0.2):
        known.on_position(time_s, (3.0, 4.0, HEIGHT_M), 0.0)
        known.on_attitude(time_s, roll_rad, pitch_rad, yaw_rad)
    return known


def point(x: float, y: float, z: float, **fields: Any) -> Any:
    values = {
        "time_boot_ms": round(NOW_S * 1e3),
        "sensor_type": 4,
        "frame": wire.MAV_FRAME_BODY_FRD,
        "obstacle_id": 65_535,
        "min_distance": 0.2,
        "max_distance": REACH_M,
    }
    return wire.MAVLink_obstacle_distance_3d_message(x=x, y=y, z=z, **{**values, **fields})


def sensing(known: Poses, sensor: NearSensor = CAMERA) -> NearSensing:
    return NearSensing(sensor, known, lambda _north_m, _east_m: 0.0)


def read(points: Iterable[Any], known: Poses, sensor: NearSensor = CAMERA) -> Sweep:
    """The one sweep of a picture: it is over when the next begins."""
    it = sensing(known, sensor)
    for message in (*points, point(1.0, 0.0, 0.0, time_boot_ms=10_050)):
        it.on_obstacle_distance_3d(message, NOW_S)
    (sweep,) = it.sweeps()
    assert not it.refused
    return sweep


def clear_m(sweep: Sweep, bearing_deg: float) -> float:
    bearing = np.array([math.radians(bearing_deg)])
    return float(sweep.clear_between_m(bearing, np.full(1, 1e-6))[0])


def test_a_ray_clears_its_beam_up_to_its_point_and_nothing_is_said_beside_it() -> None:
    sweep = read([point(0.0, 6.0, 0.0)], poses())
    assert clear_m(sweep, 90.0) == pytest.approx(6.0)
    assert clear_m(sweep, 86.9) == clear_m(sweep, 93.1) == clear_m(sweep, 0.0) == 0.0
    touched = sweep.width_rad * np.flatnonzero(np.isfinite(sweep.echo_m))
    assert (np.abs(touched - math.radians(90.0)) <= 0.8 * BEAM_RAD).all()
    assert sweep.echo_m.min() == pytest.approx(6.0)
    assert sweep.sensor_ne_m == (3.0, 4.0)


def test_the_same_point_is_told_in_any_frame_and_from_any_mounting() -> None:
    """One thing 6 m away in the true direction of 61 degrees, seen at a heading of 130."""
    north, east = 6.0 * math.cos(math.radians(61.0)), 6.0 * math.sin(math.radians(61.0))
    off = math.radians(61.0 - 130.0)
    x, y = 6.0 * math.cos(off), 6.0 * math.sin(off)
    known = poses(yaw_rad=math.radians(130.0))
    turned = NearSensor(
        kind="obstacle_distance_3d",
        component_id=196,
        range_m=REACH_M,
        latency_s=0.0,
        beam_rad=BEAM_RAD,
        yaw_rad=math.radians(90.0),
    )
    offset_ned = wire.MAV_FRAME_LOCAL_OFFSET_NED
    for sweep in (
        read([point(x, y, 0.0)], known),
        read([point(x, y, 0.0, frame=wire.MAV_FRAME_BODY_NED)], known),
        read([point(north, east, 0.0, frame=offset_ned)], known),
        read([point(y, -x, 0.0)], known, turned),
    ):
        assert clear_m(sweep, 61.0) == pytest.approx(6.0)


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0, -15.0])
def test_a_ray_to_the_ground_clears_the_way_to_where_it_leaves_the_slab(tilt_deg: float) -> None:
    """However the vehicle leans: 5 m away and 3 m down is the ground, no thing in its way."""
    tilt = math.radians(tilt_deg)
    x = 5.0 * math.cos(tilt) - HEIGHT_M * math.sin(tilt)
    z = 5.0 * math.sin(tilt) + HEIGHT_M * math.cos(tilt)
    sweep = read([point(x, 0.0, z)], poses(pitch_rad=tilt))
    assert clear_m(sweep, 0.0) == pytest.approx(5.0 * CAMERA.speaks_for_m / HEIGHT_M)
    assert not np.isfinite(sweep.echo_m).any()


def test_the_nearest_of_two_rays_of_one_direction_counts() -> None:
    low, high = point(5.0, 0.0, 0.2), point(9.0, 0.0, -0.4)
    for order in ((low, high), (high, low)):
        assert clear_m(read(order, poses()), 0.0) == pytest.approx(5.0)


NOT_BELIEVED: list[tuple[dict[str, Any], str]] = [
    ({"x": math.nan}, "a point is not finite"),
    ({"z": -math.inf}, "a point is not finite"),
    ({"x": REACH_M}, "a point is outside its limits"),
    ({"x": 9999.0, "y": 9999.0, "z": 9999.0}, "a point is outside its limits"),
    ({"x": 3e38, "y": 3e38}, "a point is outside its limits"),
    ({"x": 0.1}, "a point is outside its limits"),
    ({"x": 0.0, "min_distance": 0.0}, "a point is outside its limits"),
    ({"min_distance": math.nan}, "max_distance is no more than min_distance"),
    ({"max_distance": math.inf}, "max_distance is no more than min_distance"),
    ({"max_distance": 0.1}, "max_distance is no more than min_distance"),
    ({"frame": wire.MAV_FRAME_LOCAL_NED}, "frame is neither the body's nor north's about"),
    ({"frame": wire.MAV_FRAME_GLOBAL}, "frame is neither the body's nor north's about"),
    ({"frame": 255}, "frame is neither the body's nor north's about"),
]


@pytest.mark.parametrize(("fields", "why"), NOT_BELIEVED)
def test_a_point_that_cannot_be_believed_is_counted_and_says_nothing(
    fields: dict[str, Any], why: str
) -> None:
    it = sensing(poses())
    wrong = point(**{"x": 6.0, "y": 0.0, "z": 0.0, **fields})
    for message in (wrong, point(1.0, 0.0, 0.0, time_boot_ms=10_050)):
        it.on_obstacle_distance_3d(message, NOW_S)
    assert it.sweeps() == []
    assert it.sight(NOW_S) is Sight.SEES  # by the second
    ((told, count),) = it.refused.items()
    assert told.startswith(why)
    assert count == 1


def test_points_of_an_unbelievable_sensor_alone_are_no_sight() -> None:
    it = sensing(poses())
    it.on_obstacle_distance_3d(point(9999.0, 9999.0, 9999.0), NOW_S)
    assert it.sight(NOW_S) is Sight.NEVER_HEARD


@pytest.mark.parametrize("stamp_ms", [0, 4_294_967_295, round(NOW_S * 1e3)])
def test_a_stamp_that_stands_still_or_is_of_another_clock_ends_no_picture_late(
    stamp_ms: int,
) -> None:
    it = sensing(poses())
    for k in range(10):
        for x in (5.0, 6.0):
            it.on_obstacle_distance_3d(point(x, 0.0, 0.0, time_boot_ms=stamp_ms), NOW_S + 0.02 * k)
    assert len(it.sweeps()) == 1
    it.on_obstacle_distance_3d(point(5.0, 0.0, 0.0, time_boot_ms=stamp_ms), NOW_S - 50.0)
    assert bool(it.refused) == (stamp_ms != round(NOW_S * 1e3))


def test_a_flood_in_one_moment_is_worked_off_in_parts() -> None:
    it = sensing(poses())
    for _ in range(12_000):
        it.on_obstacle_distance_3d(point(5.0, 0.0, 0.0), NOW_S)
    assert len(it.sweeps()) == 1
    assert it.refused == {"more than 30 sweeps a second": 1}


def test_the_scanner_of_a_mission_keeps_a_map_of_points() -> None:
    forest = load_mission("forest")
    assert forest.near is not None
    near = replace(forest.near, kind="obstacle_distance_3d", beam_rad=BEAM_RAD)
    scanner, now_s, free = NearScanner(replace(forest, near=near)), NOW_S, 0
    for _ in range(6):
        for off in np.arange(-0.5, 0.5, BEAM_RAD):
            message = point(
                9.0 * math.cos(off), 9.0 * math.sin(off), 0.0, time_boot_ms=round(1e3 * now_s)
            )
            message.pack(wire.MAVLink(None, srcSystem=1, srcComponent=196))
            scanner.on_message(message, now_s)
        now_s += 0.1
        attitude = wire.MAVLink_attitude_message(round(now_s * 1e3), 0, 0, 0, 0, 0, 0)
        scanner.on_message(attitude, now_s)
        scanner.on_position(now_s, (20.0, 20.0, 405.0))
        if (seen := scanner.seen(now_s)) is not None:
            free = int(seen.near.free().sum())
    assert free * forest.task.settings.cell_m**2 > 15.0  # of 40 m2


# --- against scenes of which every point is known

LATTICE = Lattice(cell_m=0.25, north_min_m=-15.0, east_min_m=-15.0, shape=(140, 140))
ROWS_RAD = np.radians([-16.0, -8.0, 0.0, 8.0, 16.0, 24.0])


def posts(random: np.random.Generator) -> FloatArray:
    """Footprints of what stands from the ground to above the slab, (M, 2)."""
    rings = [np.full((1, 2), 100.0)]
    for _ in range(random.integers(0, 14)):
        radius, turn = random.uniform(0.02, 1.0), np.linspace(0.0, math.tau, 90)
        middle = random.uniform(-14.0, 14.0, 2)
        rings.append(middle + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    points = np.concatenate(rings)
    return points[np.hypot(*points.T) > 2.0]


def body_to_north(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Aerospace rotation, Z Y' X'': columns are the body's axes in north, east, down."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def picture(things: FloatArray, turned: FloatArray, half_view: float) -> FloatArray:
    """The nearest true point in the beam of each ray of a grid, in the body's axes.  (3, N).

    A thing in a beam is one whose footprint comes within half the beam's width of its middle.
    """
    across = np.arange(-half_view, half_view, BEAM_RAD)
    off, low = (each.ravel() for each in np.meshgrid(across, ROWS_RAD))
    body = np.stack([np.cos(low) * np.cos(off), np.cos(low) * np.sin(off), np.sin(low)])
    north, east, down = turned @ body
    level = np.hypot(north, east)
    away, bearing = np.hypot(*things.T), np.arctan2(things[:, 1], things[:, 0])
    aside = np.abs(np.mod(np.arctan2(east, north)[:, None] - bearing + math.pi, math.tau) - math.pi)
    inside = aside * level[:, None] <= 0.5 * BEAM_RAD
    thing_m = np.where(inside, away, np.inf).min(axis=1) / level
    ground_m = np.where(down > 0.0, HEIGHT_M / np.maximum(down, 1e-9), np.inf)
    met_m = np.minimum(thing_m, ground_m)
    seen = met_m < REACH_M
    return body[:, seen] * met_m[seen]


def flown(seed: int) -> tuple[NearMap, FloatArray]:
    random = np.random.default_rng(seed)
    things, near = posts(random), NearMap.empty(LATTICE, Rules())
    lost, dust = random.uniform(0.0, 0.1), random.uniform(0.0, 0.01)
    half_view, turning = random.uniform(0.3, math.pi), random.uniform(-1.0, 1.0)
    in_body = random.random() < 0.7
    for k in range(int(random.integers(4, 14))):
        yaw, (roll, pitch) = turning * 0.1 * k, random.uniform(-0.2, 0.2, 2)
        known, turned = Poses(), body_to_north(roll, pitch, yaw)
        for time_s in (NOW_S, NOW_S + 0.05):
            known.on_position(time_s, (0.0, 0.0, HEIGHT_M), 0.0)
            known.on_attitude(time_s, roll, pitch, yaw)
        points = picture(things, turned, half_view)
        points = points[:, random.random(points.shape[1]) >= lost]
        away = np.hypot(points[0], np.hypot(points[1], points[2]))
        points = points * (1.0 + random.uniform(-0.09, 0.09, len(away)) / np.maximum(away, 1.0))
        dusty = random.random(len(away)) < dust
        points[:, dusty] *= random.uniform(0.2, 1.0, int(dusty.sum()))
        frame = wire.MAV_FRAME_BODY_FRD if in_body else wire.MAV_FRAME_LOCAL_OFFSET_NED
        told = points if in_body else turned @ points
        it = sensing(known)
        for x, y, z in told.T.tolist():
            it.on_obstacle_distance_3d(point(x, y, z, frame=frame), NOW_S)
        it.on_obstacle_distance_3d(point(1.0, 0.0, 0.0, time_boot_ms=10_050), NOW_S)
        for sweep in it.sweeps():
            near.add(sweep)
    return near, things


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 100))]
)
def test_what_is_free_holds_no_point_of_any_thing(part: int) -> None:
    free = 0
    low = np.array([LATTICE.north_min_m, LATTICE.east_min_m])
    for seed in range(20 * part, 20 * part + 20):
        near, things = flown(seed)
        cells = np.floor((things - low) / LATTICE.cell_m).astype(int)
        cells = cells[((cells >= 0) & (cells < LATTICE.shape)).all(axis=1)]
        assert not near.free()[cells[:, 0], cells[:, 1]].any(), seed
        free += int(near.free().sum())
    assert free > 6_000  # it says something
