"""Against a radar of the test's own, made from the message definition and geodesics alone.

TERRAIN_REQUEST: "SW corner of first grid", "grid spacing in meters", "bitmask of requested 4x4
grids (row major 8x7 array of grids, 56 bits)".  TERRAIN_DATA: "bit within the terrain request
mask", "terrain data MSL"; data[x * 4 + y] with x north and y east (ArduPilot's AP_Terrain).
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from wires import FRAME, GEOD, wire

from companion.config import load_mission
from companion.mavlink.terrain_download import TerrainDownload, areas
from companion.mission.state import State
from companion.world.known_map import NOT_SEEN, KnownMap, Scan, empty_map

CELL_M = 250.0
RANGE_M = 6000.0
CORNER = (100_000.0, 100_000.0)
HERE = (100_000.0, 100_000.0, 3000.0)
MAP = empty_map(CELL_M, (-5000.0, 105_000.0), (-5000.0, 105_000.0))
DEADLINE_S = 4.0
VALLEY = load_mission("valley")
MISSION = replace(
    VALLEY,
    frame=FRAME,
    position_rate_hz=VALLEY.task.limits.speed_m_s / 15.0,  # drift: 30 m
)


def local(latitude: float, longitude: float) -> tuple[float, float]:
    """North, east in the azimuthal equidistant frame, by the geodesic from its origin."""
    azimuth, _, distance = GEOD.inv(8.0, 47.0, longitude, latitude)
    return distance * math.cos(math.radians(azimuth)), distance * math.sin(math.radians(azimuth))


def place(request: Any, north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude, longitude of a point true north and true east of the request's corner."""
    azimuth = math.degrees(math.atan2(east_m, north_m))
    longitude, latitude, _ = GEOD.fwd(
        request.lon * 1e-7, request.lat * 1e-7, azimuth, math.hypot(north_m, east_m)
    )
    return latitude, longitude


def height_m(north_m: float, east_m: float) -> float:
    """A slope that is steep to the north and less so to the east: no flip leaves it the same."""
    return 0.1 * (north_m - 100_000.0) + 0.013 * (east_m - 100_000.0) + 1000.0


def heights(request: Any, bit: int) -> list[int]:
    """Of the 16 cells of a block, at their middles: x (north) is the slower index."""
    row, column = divmod(bit, 8)
    cells = [(4 * row + x + 0.5, 4 * column + y + 0.5) for x in range(4) for y in range(4)]
    s = request.grid_spacing
    return [round(height_m(*local(*place(request, s * x, s * y)))) for x, y in cells]


def bits(mask: int) -> list[int]:
    return [bit for bit in range(64) if mask >> bit & 1]


def block(request: Any, bit: int, data: list[int], **changes: int) -> Any:
    values = {"lat": request.lat, "lon": request.lon, "grid_spacing": request.grid_spacing}
    return wire.MAVLink_terrain_data_message(gridbit=bit, data=data, **{**values, **changes})


def report(request: Any, pending: int = 0) -> Any:
    corner = (request.lat, request.lon, request.grid_spacing)
    return wire.MAVLink_terrain_report_message(*corner, 0.0, 0.0, pending, 1)


def answers(
    request: Any, data: Any = lambda *_: [500] * 16, lost: Any = lambda *_: False
) -> list[Any]:
    """All blocks that are asked for, with these heights, and the report."""
    there = [bit for bit in bits(request.mask) if not lost(request, bit)]
    return [*(block(request, bit, data(request, bit)) for bit in there), report(request)]


def run(task: TerrainDownload, *how: Any, **keywords: Any) -> list[Any]:
    """All requests; the radar answers within a tenth of a second."""
    requests = []
    for at_s in (tick / 10 for tick in range(round(DEADLINE_S * 10) + 1)):
        if task.is_over(at_s):
            break
        if (request := task.on_time(at_s)) is not None:
            requests.append(request)
            for message in answers(request, *how, **keywords):
                task.on_message(message, HERE)
    return requests


def download(
    centre: tuple[float, ...] = CORNER,
    range_m: float = RANGE_M,
    towards_ne_m: tuple[float, float] | None = None,
    known: KnownMap = MAP,
) -> TerrainDownload:
    """To the north, if nothing else is said."""
    settings = replace(MISSION.task.settings, scan_range_m=range_m, scan_time_s=DEADLINE_S)
    task = replace(MISSION.task, settings=settings)
    targets = (towards_ne_m or (centre[0] + 1e5, centre[1]),)
    mission = replace(MISSION, task=task, targets_ne_m=targets)
    state = State.of(mission, known)
    return TerrainDownload(mission, (centre[0], centre[1], 0.0), state, now_s=0.0)


def on_map(scan: Scan) -> np.ndarray[Any, np.dtype[np.float64]]:
    whole = np.full(MAP.upper_m.shape, math.nan)
    rows, columns = scan.heights_m.shape
    whole[scan.row : scan.row + rows, scan.column : scan.column + columns] = scan.heights_m
    return whole


def middle_of(row: int, column: int) -> tuple[float, float]:
    return -5000.0 + (row + 0.5) * CELL_M, -5000.0 + (column + 0.5) * CELL_M


def told(scan: Scan) -> set[float]:
    """The heights that were answered."""
    return set(scan.heights_m[~np.isnan(scan.heights_m)])


@pytest.mark.parametrize("centre", [CORNER, (0.0, 0.0), (50_000.0, 100_000.0)])
def test_every_height_lands_in_the_cell_that_it_belongs_to(centre: tuple[float, float]) -> None:
    task = download(centre, 3000.0)
    run(task, heights)
    scan = task.scan()
    rows, columns = np.nonzero(np.isfinite(on_map(scan)))
    assert rows.size > 400
    slack = 0.6 + scan.registration_m * math.hypot(0.1, 0.013)
    assert slack < 0.1 * CELL_M / 2  # less than a cell's error would be
    for row, column in zip(rows, columns, strict=True):
        expected = height_m(*middle_of(row, column))
        assert on_map(scan)[row, column] == pytest.approx(expected, abs=slack)


def test_all_that_is_within_range_and_on_the_map_is_asked_for_once() -> None:
    task = download()
    run(task)
    answered = np.isfinite(on_map(task.scan()))
    for row, column in np.ndindex(MAP.upper_m.shape):
        if math.dist(middle_of(row, column), CORNER) <= RANGE_M:
            assert answered[row, column], (row, column)
    assert task.asked == task.answered
    seen = MAP.with_scan(task.scan())
    assert list(areas(seen, CORNER, RANGE_M - 2 * CELL_M, FRAME)) == []
    again = download(known=seen)
    assert again.asked == 0
    assert again.is_over(0.0)
    assert again.on_time(0.0) is None


@pytest.mark.parametrize("centre", [(104_000.0, 104_000.0), (-4000.0, 103_000.0), CORNER])
def test_registration_bounds_the_offset_of_every_corner(centre: tuple[float, float]) -> None:
    found = list(areas(MAP, centre, 9000.0, FRAME))
    scan = download(centre, 9000.0).scan()
    assert scan.registration_m == max(area.registration_m for area in found) < CELL_M / 2
    for area in found:
        corner = (area.latitude_e7, area.longitude_e7, round(CELL_M))
        request = wire.MAVLink_terrain_request_message(*corner, area.mask)
        south, west = -5000.0 + area.row * CELL_M, -5000.0 + area.column * CELL_M
        offsets_m = [
            math.dist(local(*place(request, north_m, east_m)), (south + north_m, west + east_m))
            for north_m in CELL_M * np.arange(0, 29, 4)
            for east_m in CELL_M * np.arange(0, 33, 4)
        ]
        assert area.registration_m == pytest.approx(max(offsets_m), abs=1e-3)  # and no more


def test_one_request_is_outstanding_until_its_report_or_its_answers_stop() -> None:
    """For a second before the first answer, and for 0.4 s after one."""
    task = download(range_m=10_000.0)
    first = task.on_time(0.0)
    assert task.on_time(0.9) is None
    *blocks, over = answers(first)
    for message in blocks:
        task.on_message(message, HERE)
    assert task.on_time(0.95) is None
    task.on_message(report(first, pending=3), HERE)
    assert task.on_time(0.96) is None
    task.on_message(over, HERE)
    second = task.on_time(0.97)
    for at_s, message in zip((1.0, 1.3), answers(second), strict=False):
        task.on_message(message, HERE)
        assert task.on_time(at_s) is None
    assert task.on_time(1.6) is None
    third = task.on_time(1.75)
    assert len({(each.lat, each.lon) for each in (first, second, third)}) == 3


def test_a_lost_block_alone_is_asked_for_twice_more_and_then_unknown_and_not_sheltered() -> None:
    task = download(range_m=2000.0)
    first, *_ = areas(MAP, CORNER, 2000.0, FRAME)
    gone = bits(first.mask)[3]
    requests = run(task, lost=lambda request, bit: (request.lat, bit) == (first.latitude_e7, gone))
    of_first = [each.mask for each in requests if each.lat == first.latitude_e7]
    assert of_first == [first.mask, 1 << gone, 1 << gone]
    assert task.answered == task.asked - 1
    scan = task.scan()
    assert not np.isneginf(scan.heights_m).any()
    after, unknown = MAP.with_scan(scan), np.isnan(on_map(scan))
    assert np.isinf(after.upper_m[unknown]).all()
    assert not after.seen[unknown].any()
    silent = download()
    asked = [silent.on_time(tick / 10) for tick in range(50)]
    assert [silent.is_over(at_s) for at_s in (DEADLINE_S - 0.1, DEADLINE_S)] == [False, True]
    assert (silent.answered, sum(request is not None for request in asked)) == (0, 4)
    assert told(silent.scan()) == set()


def test_blocks_of_other_requests_not_asked_for_or_told_again_are_ignored() -> None:
    task = download(range_m=2000.0)
    request = task.on_time(0.0)
    wanted = bits(request.mask)
    for spoil in ({"lat": 470_000_000}, {"lon": 80_000_000}, {"grid_spacing": 100}):
        task.on_message(block(request, wanted[0], [9] * 16, **spoil), HERE)
    for bit in (*(set(range(56)) - set(wanted)), 56, 63, 64, 255):
        task.on_message(block(request, bit, [9] * 16), HERE)
    assert task.answered == 0
    for height in (100, 200):
        task.on_message(block(request, wanted[0], [height] * 16), HERE)
    assert (task.answered, told(task.scan())) == (1, {100.0})
    for message in 2 * answers(request):  # nothing is asked for any more
        task.on_message(message, HERE)
    assert task.answered == len(wanted)


def test_heights_are_kept_with_the_place_of_the_radar_and_minus_32768_is_not_seen() -> None:
    task = download(range_m=2000.0)
    said = [-32768, -32767, -1, 0, 1, 32767] + [5] * 10
    first, *others = answers(task.on_time(0.0), lambda *_: said)
    task.on_message(first, (1.0, 2.0, 3.0))
    for message in others:
        task.on_message(message, HERE)
    scan = task.scan()
    places = {tuple(radar) for radar in scan.radar_nea_m[~np.isnan(scan.heights_m)]}
    assert places == {(1.0, 2.0, 3.0), HERE}
    assert told(scan) == {NOT_SEEN, *said[1:]}
    assert (scan.range_m, scan.drift_m) == (2000.0, 30.0)
