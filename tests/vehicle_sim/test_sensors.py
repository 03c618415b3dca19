"""The terrain radar against brute force, its component, the lidar, and ArduPilot's rangefinder.

A cell may be called hidden only if it is (nothing is ever hidden that is in sight), and what is
called seen although it is hidden lies so little behind a ridge that the ridge hardly hides it.
ArduPilot's eight sectors are seen by the rows of arducopter-lidar.tlog (conformance/lidar.py).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness import ZERO, Rig, command_long, placed
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as mavlink
from pyproj import Geod

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import FloatArray, LocalFrame
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, TerrainRadar
from vehicle_sim.terrain import PeakRow, PeakTerrain
from vehicle_sim.world import Peak

approx = pytest.approx
Height = Callable[[FloatArray, FloatArray], FloatArray]
NE = tuple[float, float]
Request = tuple[LocalFrame, int]
"""South-west corner and spacing."""
WGS84 = Geod(ellps="WGS84")
FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
ALL_BLOCKS, RANGE_M = (1 << 56) - 1, 4000.0
HERE: NE = (0.0, 0.0)
FAR: NE = (9e4, 9e4)
"""A corner of the map, where true north and the local frame's north differ."""
ROW, COLUMN = np.meshgrid(np.arange(28), np.arange(32), indexing="ij")
"""Cells to the north and to the east."""


def peaks(rng: np.random.Generator, number: tuple[int, int], centre_ne_m: NE) -> list[PeakRow]:
    """North, east, height and two spreads."""
    places = ((centre_m - 4e3, centre_m + 4e3) for centre_m in centre_ne_m)
    low, high = zip(*places, *[(200.0, 1500.0)] * 3, strict=True)
    return [tuple(rng.uniform(low, high).tolist()) for _ in range(int(rng.integers(*number)))]


def viewpoint(ne_m: NE, altitude_amsl_m: float) -> Vehicle:
    return Vehicle(**placed((*FRAME.to_geographic(*ne_m), altitude_amsl_m)))


def request_about(ne_m: NE, spacing_m: int) -> Request:
    corner = FRAME.to_geographic(ne_m[0] - 14 * spacing_m, ne_m[1] - 16 * spacing_m)
    latitude_deg, longitude_deg = (round(angle, 7) for angle in corner)
    return LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg), spacing_m


def spots(request: Request, count: int) -> tuple[FloatArray, FloatArray]:
    """So many points a side of each cell, edges included, in the world's frame: by geodesics from
    the corner.  -> two of (28 * 32 * count^2,).
    """
    corner, spacing_m = request
    at = np.linspace(0.0, spacing_m, count)
    north = (ROW[..., None, None] * spacing_m + at[:, None] + 0.0 * at).ravel()
    east = (COLUMN[..., None, None] * spacing_m + 0.0 * at[:, None] + at).ravel()
    ones, azimuth = np.ones_like(north), np.degrees(np.arctan2(east, north))
    start = (corner.longitude_deg * ones, corner.latitude_deg * ones)
    lon, lat, _ = WGS84.fwd(*start, azimuth, np.hypot(north, east))
    azimuth, _, distance = WGS84.inv(8.0 * ones, 47.0 * ones, lon, lat)
    return distance * np.cos(np.radians(azimuth)), distance * np.sin(np.radians(azimuth))


def cells(radar: TerrainRadar, request: Request, view: Vehicle) -> NDArray[np.int64]:
    """The answer as an array by cell (28 north, 32 east), put together by the definition."""
    grid = np.full((28, 32), 99999, dtype=np.int64)
    for bit, heights in radar.answer(*request, ALL_BLOCKS, view).items():
        row, column = divmod(bit, 8)
        part = np.array(heights).reshape(4, 4)
        grid[4 * row : 4 * row + 4, 4 * column : 4 * column + 4] = part
    return grid


# --- what is seen and what is hidden: rays marched over the true ground in small steps ------------

EARTH_M, STEPS = 6_371_009.0, 400
"""Steps of a ray."""


def marched(height: Height, eye: tuple[float, float, float], points_ne_m: FloatArray) -> FloatArray:
    """How far the ground rises above the line from the eye to each point.  (K, 2) -> (K,).

    The line is straight in the space about a sphere of radius R: between two points at distances
    r1 and r2 from its middle, 1 / r goes with the sines of the angles to them.
    """
    most = np.empty(len(points_ne_m))
    share = ((np.arange(STEPS) + 0.5) / STEPS)[:, None]
    for start in range(0, len(points_ne_m), 256):
        north, east = points_ne_m[start : start + 256].T
        top = height(north, east)
        ground = height(eye[0] + share * (north - eye[0]), eye[1] + share * (east - eye[1]))
        angle = np.hypot(north - eye[0], east - eye[1]) / EARTH_M
        over = np.sin((1.0 - share) * angle) / (EARTH_M + eye[2])
        over += np.sin(share * angle) / (EARTH_M + top)
        line = np.sin(angle) / over - EARTH_M
        most[start : start + 256] = (ground - line).max(axis=0)
    return most


@pytest.mark.parametrize(
    ("seed", "centre", "combine", "spacing_m", "above_ground_m"),
    [
        (0, HERE, "maximum", 200, 20.0),
        (3, HERE, "sum", 160, 5.0),
        (2, FAR, "maximum", 60, 9000.0),  # from so high everything is in sight
    ],
)
def test_nothing_is_hidden_that_a_ray_reaches_and_what_is_seen_is_its_highest_ground_rounded_up(
    seed: int, centre: NE, combine: Any, spacing_m: int, above_ground_m: float
) -> None:
    rows = peaks(np.random.default_rng(seed), (3, 14), centre)

    def height(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Written down once more from eq. 1."""
        total = np.zeros(np.broadcast(north_m, east_m).shape)
        for n, e, h, sn, se in rows:
            peak = h * np.exp(-(((north_m - n) / sn) ** 2) - ((east_m - e) / se) ** 2)
            total = np.maximum(total, peak) if combine == "maximum" else total + peak
        return np.maximum(total, 100.0)

    terrain = PeakTerrain(rows, combine=combine, ground_amsl_m=100.0)
    eye = (*centre, float(height(*np.array(centre)[:, None])[0]) + above_ground_m)
    request = request_about(centre, spacing_m)
    radar = TerrainRadar(terrain, FRAME, range_m=RANGE_M)
    got = cells(radar, request, viewpoint(centre, eye[2]))
    # corners, middles of the sides and the middle of every cell, as the message defines them
    points = np.stack(spots(request, 3), axis=-1)
    covered_m = marched(height, eye, points).reshape(28, 32, 9).min(axis=-1)
    away_m = points.reshape(28, 32, 9, 2)[:, :, 4] - centre
    in_range, hidden = np.hypot(*away_m.T).T < RANGE_M - 1.0, got == UNSEEN_M
    false_seen = ~hidden & in_range & (covered_m > 0.0)
    assert not np.any(hidden & in_range & (covered_m <= 0.0))
    assert (hidden & in_range).sum() > 100 or centre is FAR
    assert false_seen.sum() <= 0.15 * in_range.sum()
    # its bounds are those of cells of a four-hundredth of its range, and of those around; slopes
    # are up to 1.5
    assert np.max(covered_m[false_seen], initial=0.0) <= 1.5 * RANGE_M / 400.0 * 5.0
    brute_m = height(*spots(request, 13)).reshape(28, 32, -1).max(axis=-1)
    over_m = (got - brute_m)[~hidden]
    assert over_m.min() >= -1e-6
    if combine == "maximum":  # 1 / 12 of a cell between samples, slopes up to about 7
        assert over_m.max() <= 1.0 + 5.0 * spacing_m / 12.0
        assert np.mean(over_m <= 2.0) > 0.5  # and mostly not more than the rounding


@pytest.mark.parametrize("eye_m", [3.0, 25.0])
@pytest.mark.parametrize("mast_m", [0.0, 12.0])
def test_the_horizon_is_where_the_earth_curves_away(eye_m: float, mast_m: float) -> None:
    """At R acos(R / (R + h)), and of a mast by as much farther as its own horizon is away."""
    earth_m, way = 6_371_000.0, (-0.6, 0.8)
    horizon_m = sum(earth_m * math.acos(earth_m / (earth_m + h)) for h in (eye_m, mast_m))
    for away_m, seen in ((0.97 * horizon_m, True), (1.05 * horizon_m, False)):
        north_m, east_m = (away_m * share for share in way)
        rows = [(north_m, east_m, mast_m, 400.0, 400.0)] if mast_m else []
        terrain = PeakTerrain(rows, combine="maximum", ground_amsl_m=0.0)
        at = FRAME.to_geographic(north_m, east_m)
        corner = LocalFrame(latitude_deg=at[0], longitude_deg=at[1])
        radar = TerrainRadar(terrain, FRAME, range_m=5e4)
        (heights,) = radar.answer(corner, 1, 1, viewpoint(HERE, eye_m)).values()
        assert (heights[0] != UNSEEN_M) == seen


# --- its component --------------------------------------------------------------------------------

TOP_M, TICK_S, RADAR = 500.0, 0.1, (1, 100)
RIDGE = [(2000.0, float(e), 1000.0, 200.0, 400.0) for e in range(-6000, 6001, 250)]
ROWS: list[PeakRow] = [*RIDGE, (0.0, 0.0, TOP_M, 30.0, 30.0)]
"""A ridge, and a hill on which the vehicle stands."""
TERRAIN = PeakTerrain(ROWS, combine="maximum", ground_amsl_m=100.25)
CONE = [dict(zip(Peak.model_fields, row, strict=False)) for row in ROWS]


def request(mask: int = ALL_BLOCKS) -> Any:
    corner, _ = request_about(HERE, 200)
    place = (round(1e7 * at) for at in (corner.latitude_deg, corner.longitude_deg))
    return mavlink.MAVLink_terrain_request_message(*place, 200, mask)


def standing(fault: str = "turbulence 0 m/s") -> Rig:
    """On the hill, after a second of this."""
    table: dict[str, Any] = {"component_id": 100, "range_m": RANGE_M}
    it = Rig("ideal", "copter", (47.0, 8.0, 100.25), links=4, scanner=table, peaks=CONE, seed=1)
    it.fault(fault)
    it.run(1.0).heard.clear()
    return it


def answered(*fault: str) -> Rig:
    """0.9 s after a request, of a vehicle that is elsewhere in the next tick."""
    it = standing(*fault)
    it.send(request())
    it.run(TICK_S).vehicle.latitude_deg += 0.03
    return it.run(0.8)


def blocks_of(it: Rig) -> list[Any]:
    return it.said("TERRAIN_DATA", RADAR)


def heights(it: Rig) -> Any:
    return np.array([block.data for block in blocks_of(it)], dtype=np.int64).ravel()


def test_a_request_is_answered_once_at_the_end_of_its_tick_with_what_the_radar_sees() -> None:
    it, asked = standing(), request()
    it.run(0.05).send(request(mask=1), asked, link=3)  # the newest counts
    said = [each for each in it.run(0.4).heard if each.source == RADAR]
    assert {(round(each.at_s, 3), each.link) for each in said} == {(1.0 + TICK_S, 3)}
    *blocks, report = (each.message for each in said)
    for each in (*blocks, report):
        spacing_m = each.spacing if each is report else each.grid_spacing
        assert (each.lat, each.lon, spacing_m) == (asked.lat, asked.lon, 200)
    assert (report.loaded, report.pending) == (56, 0)
    assert report.terrain_height == approx(TERRAIN.height_at_amsl_m(-2800.0, -3200.0))
    assert report.current_height == approx(TOP_M - report.terrain_height)
    radar, view = TerrainRadar(TERRAIN, FRAME, range_m=RANGE_M), viewpoint(HERE, TOP_M)
    truth = radar.answer(*request_about(HERE, 200), ALL_BLOCKS, view)
    assert {block.gridbit: list(block.data) for block in blocks} == truth
    for spacing_m, latitude_deg in ((0, 47.0), (100, 91.0), (100, -214.0)):  # nonsense
        corner = LocalFrame(latitude_deg=latitude_deg, longitude_deg=8.0)
        assert radar.answer(corner, spacing_m, ALL_BLOCKS, view) == {}


@pytest.mark.parametrize(("fault", "beats"), [("turbulence 0 m/s", 3), ("radar_off", 0)])
def test_its_heart_beats_once_a_second_and_it_obeys_nobody(fault: str, beats: int) -> None:
    it = standing(fault)
    it.send(*(command_long(400, target=(1, to)) for to in (0, 100)), request())
    heard = it.run(3.0).heard
    said = [each.kind for each in heard if (each.source, each.link) == (RADAR, 0)]
    assert (said.count("HEARTBEAT"), "COMMAND_ACK" in said) == (beats, False)
    assert ("TERRAIN_REPORT" in said) is bool(beats)


@pytest.mark.parametrize(
    ("fault", "reports", "apart_s"), [("radar_delay 1000 ms", 9, 1.0), ("radar_rate 2 Hz", 21, 0.5)]
)
def test_it_holds_one_answer_and_keeps_its_rate(fault: str, reports: int, apart_s: float) -> None:
    """It is asked for two blocks twenty times a second, for 10 s."""
    it = standing(fault)
    it.streamed = request(mask=0b1001)
    times = [each.at_s for each in it.run(10.0).all("TERRAIN_REPORT")]
    blocks = [each.message for each in it.all("TERRAIN_DATA")]
    assert [block.gridbit for block in blocks] == [0, 3] * reports
    every = {block.gridbit: block.data for block in blocks_of(answered())}
    assert all(block.data == every[block.gridbit] for block in blocks)
    assert len(times) == reports
    assert min(np.diff(times[1:])) >= apart_s - 1e-6


def test_a_fault_spoils_what_it_says_in_its_share_and_nothing_else() -> None:
    said = answered()
    truth, by_bit = heights(said), blocks_of(said)
    seen = truth != UNSEEN_M
    late = answered("radar_delay 770 ms")  # of the answer, and not of the look
    assert {round(each.at_s - 1.0 - TICK_S, 3) for each in late.all("TERRAIN_DATA")} == {0.77}
    assert np.array_equal(heights(late), truth)
    blind = answered("radar_blind")
    assert (len(blocks_of(blind)), set(heights(blind))) == (56, {UNSEEN_M})
    lossy = answered("radar_loss 30 %")
    blocks = blocks_of(lossy)
    assert 56 * 0.5 < len(blocks) < 56 * 0.9
    assert lossy.said("TERRAIN_REPORT", RADAR)[0].loaded == 56  # the report counts them
    assert all(by_bit[block.gridbit].data == block.data for block in blocks)
    got = heights(answered("radar_drop 25 %"))
    missed = seen & (got == UNSEEN_M)
    assert missed.sum() / seen.sum() == approx(0.25, abs=0.05)
    assert np.array_equal(got[~missed], truth[~missed])


@pytest.mark.parametrize("noise_m", [5.0, 10_000.0])
def test_noise_never_lowers_a_cell_unless_it_says_so(noise_m: float) -> None:
    truth = heights(answered())
    seen = truth != UNSEEN_M
    line = f"radar_noise {noise_m} m"
    above, either = (heights(answered(each)) for each in (line, f"{line} either_way"))
    for got in (above, either):
        assert np.array_equal(got == UNSEEN_M, ~seen)
        assert np.all((got >= -32768) & (got <= 32767))
    assert (above - truth)[seen].min() >= 0
    if noise_m == 5.0:
        assert (above - truth)[seen].mean() == approx(5 * np.sqrt(2 / np.pi) + 0.5, abs=0.5)
        assert (either - truth)[seen].std() == approx(5.0, rel=0.1)
        assert (either - truth)[seen].mean() == approx(0.0, abs=0.6)


# --- the lidar ------------------------------------------------------------------------------------

NOT_THERE, NOT_KNOWN, PROXIMITY = 1601, 65535, 0x4000000
DRIVER = (1, 196)
POST = {"north_m": 10.0, "east_m": 0.0, "radius_m": 1.0, "height_m": 50.0}
AT_ONCE = {"kind": "sectors"}
"""Takes a tenth of the time of beam after beam."""
HELD_M = 5.0


class Bench(Rig):
    """A vehicle that is held where the test wants it, and what it says."""

    def __init__(
        self, seconds: float, lidar: Any = (), asks: Any = (), turn_rad: Any = ZERO, **fields: Any
    ) -> None:
        super().__init__(lidar={"range_m": 16.0} | dict(lidar), **fields)
        self.turn_rad, flies = turn_rad, self.autopilot.step

        def held(*arguments: Any) -> Any:
            replies, vehicle = flies(*arguments), self.vehicle
            vehicle.altitude_amsl_m = self.home[2] + HELD_M
            vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad = self.turn_rad
            return replies

        self.autopilot.step = held
        self.run(0.1 if asks else 0.0)
        for number in asks:
            self.command(511, number, 100_000)
        self.run(seconds)

    def maps(self, since_s: float = 0.0) -> list[Any]:
        return self.said("OBSTACLE_DISTANCE", DRIVER, since_s)


@pytest.mark.parametrize("bearing_deg", [0.0, 200.0, 357.0])
def test_a_post_is_in_its_sector_by_mavlink_and_told_on_every_link(bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    place = {"north_m": 10 * math.cos(bearing), "east_m": 10 * math.sin(bearing), "radius_m": 0.2}
    lidar = {"step_deg": 0.5, "latency_s": 0.06}
    bench = Bench(2.0, lidar=lidar, trees=[POST | place], links=2)
    maps = bench.all("OBSTACLE_DISTANCE")
    assert len(bench.all("OBSTACLE_DISTANCE", link=1)) == len(maps) == approx(20, abs=2)
    told = maps[-1].message
    assert 0.059 <= maps[-1].at_s - told.time_usec * 1e-6 <= 0.08
    assert (told.frame, told.increment, told.min_distance, told.max_distance) == (12, 5, 20, 1600)
    met = [k for k, cm in enumerate(told.distances) if cm < NOT_THERE]
    off_deg = [abs(math.remainder(told.angle_offset + 5.0 * k - bearing_deg, 360.0)) for k in met]
    assert min(off_deg) <= 2.5
    assert max(off_deg) <= 5.0
    assert min(told.distances) == approx(980, abs=1)
    assert {(m.type, m.autopilot) for m in bench.said("HEARTBEAT", DRIVER)} == {(18, 8)}


def test_nearer_than_the_least_distance_nothing_is_known() -> None:
    near = POST | {"north_m": 1.3}
    told, known = (
        Bench(1.0, trees=[near], lidar={"min_m": least_m}).maps()[-1].distances
        for least_m in (0.5, 0.1)
    )
    unknown = {k for k, cm in enumerate(told) if cm == NOT_KNOWN}
    assert set() < unknown <= {*range(14), *range(58, 72)}  # the post's sectors
    assert min(known) == 30


def test_noise_and_lost_echoes_have_the_size_that_the_world_says_and_are_the_seeds() -> None:
    lidar = AT_ONCE | {"noise_m": 0.1, "lost_share": 0.2, "step_deg": 5.0}

    def ahead(seed: int, seconds: float) -> Any:
        bench = Bench(seconds, trees=[POST | {"radius_m": 3.0}], lidar=lidar, seed=seed)
        return np.array([m.distances[0] for m in bench.maps()])

    told = ahead(3, 60.0)[5:]
    assert np.mean(told == NOT_THERE) == approx(0.2, abs=0.06)
    met = told[told != NOT_THERE] * 0.01
    assert met.mean() == approx(7.0, abs=0.02)
    assert met.std() == approx(0.1, abs=0.02)
    assert not np.array_equal(ahead(4, 4.0), ahead(3, 4.0))


SEES: dict[str, Callable[[Any, Any, int], Any]] = {  # maps, their distances, beats
    "lidar_dead": lambda maps, _, beats: not maps and beats == 3,
    "lidar_off": lambda maps, _, beats: not maps and beats == 0,
    "lidar_loss 100 %": lambda maps, _, beats: not maps and beats == 3,
    "lidar_blind": lambda _, cm, __: set(cm.flat) == {NOT_THERE},
    "lidar_turned 180 deg": lambda _, cm, __: set(cm.argmin(axis=1)) <= {35, 36, 37},
    "lidar_dust 10 %": lambda _, cm, __: 0.05 < np.mean(cm < 320) < 0.25 and cm[:, 36].min() < 320,
    "lidar_clock 5000 ms": lambda maps, _, __: abs(maps[0].time_usec - 6_200_000) < 100_000,
    "lidar_rate 100 Hz": lambda maps, _, __: abs(len(maps) - 285) <= 4,
}


@pytest.mark.parametrize("line", SEES)
def test_a_client_sees_the_fault(line: str) -> None:
    bench = Bench(4.0, trees=[POST], lidar=AT_ONCE, faults=f"at 1 s: {line}")
    maps, beats = bench.maps(1.15), bench.said("HEARTBEAT", DRIVER, 1.15)
    assert SEES[line](maps, np.array([m.distances for m in maps]), len(beats))


def test_a_stuck_lidar_repeats_itself_with_new_stamps() -> None:
    bench = Bench(1.2, trees=[POST], lidar=AT_ONCE, faults="at 1 s: lidar_stuck")
    bench.turn_rad = (0.0, 0.0, 2.0)
    maps = bench.run(2.0).maps(1.15)
    assert len({tuple(m.distances) for m in maps}) == 1
    assert len({m.time_usec for m in maps}) == len(maps)


def test_a_leaning_vehicles_lidar_and_rangefinder_measure_slant_ranges_to_the_ground() -> None:
    told = Bench(1.0, turn_rad=(0.0, math.radians(-30.0), 1.0)).maps()[-1].distances
    assert (told[0], told[36]) == (approx(1030, abs=3), NOT_THERE)  # 5.15 m / sin 30 deg
    how: dict[str, Any] = {"turn_rad": (math.radians(20.0), math.radians(-10.0), 1.0)}
    how |= {"asks": (132, 173), "RNGFND1_TYPE": 100.0, "RNGFND1_MAX": 4.0}
    bench = Bench(2.0, faults="at 3 s: rangefinder_off", **how)
    slant_m = HELD_M / (math.cos(math.radians(20.0)) * math.cos(math.radians(10.0)))
    m = bench.last("DISTANCE_SENSOR")
    assert m.current_distance == approx(slant_m * 100, abs=1)  # also beyond its maximum
    assert (m.id, m.orientation, m.type, m.min_distance, m.max_distance) == (0, 25, 4, 20, 400)
    assert bench.last("RANGEFINDER").distance == approx(slant_m, abs=0.01)
    bench.run(2.0)
    assert bench.said("DISTANCE_SENSOR", since_s=3.05) == []
    assert {m.distance for m in bench.said("RANGEFINDER", since_s=3.05)} == {0.0}


@pytest.mark.parametrize("dead", [False, True])
def test_a_second_lidar_is_told_by_sectors_and_its_death_by_a_bit(*, dead: bool) -> None:
    second = {"second_lidar": {"range_m": 12.0, "output": "autopilot"}}
    fault = "at 1 s: lidar_dead" if dead else ""
    bench = Bench(3.0, trees=[POST], lidar={"range_m": 40.0}, asks=(132, 1), faults=fault, **second)
    sectors = bench.said("DISTANCE_SENSOR", since_s=1.5)
    assert dead or min(bench.maps()[-1].distances) == approx(900, abs=1)
    assert bool(sectors) is not dead
    assert dead or min(m.current_distance for m in sectors) == approx(900, abs=5)
    assert {(m.type, m.max_distance, m.id - m.orientation) for m in sectors} <= {(0, 1200, 10)}
    status = bench.last("SYS_STATUS")
    assert status.onboard_control_sensors_present & PROXIMITY
    assert bool(status.onboard_control_sensors_health & PROXIMITY) is not dead
