"""Against a radar of the test's own, made from the message definition and geodesics alone.

TERRAIN_REQUEST: "SW corner of first grid", "grid spacing in meters", "bitmask of requested 4x4
grids (row major 8x7 array of grids, 56 bits)".  TERRAIN_DATA: "bit within the terrain request
mask", "terrain data MSL"; data[x * 4 + y] with x north and y east (ArduPilot's AP_Terrain).
"""

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wires import FRAME, GEOD, heard

from companion.config import load_mission
from companion.mavlink.terrain_download import TerrainRadar, areas
from companion.mission.events import ScanDone
from companion.mission.state import State
from companion.world.known_map import NOT_SEEN, KnownMap, Scan, empty_map

CELL_M = 250.0
CORNER = (100_000.0, 100_000.0)
HERE = (100_000.0, 100_000.0, 3000.0)
MAP = empty_map(CELL_M, (-5000.0, 105_000.0), (-5000.0, 105_000.0))
DEADLINE_S = 4.0
VALLEY = load_mission("valley")
DRIFT_M = 30.0
MISSION = replace(
    VALLEY, frame=FRAME, position_rate_hz=2.0 * VALLEY.task.limits.speed_m_s / DRIFT_M
)


def height_m(north_m: Any, east_m: Any) -> Any:
    """A slope that is steep to the north and less so to the east: no flip leaves it the same."""
    return 0.1 * (north_m - 100_000.0) + 0.013 * (east_m - 100_000.0) + 1000.0


def true_heights(request: Any, bit: int) -> list[int]:
    """At the middles of the cells, which lie true north and true east of the request's corner."""
    (row, column), (x, y) = divmod(bit, 8), np.indices((4, 4)).reshape(2, 16)
    north_m, east_m = CELL_M * (4 * row + x + 0.5), CELL_M * (4 * column + y + 0.5)
    azimuth, away_m = np.degrees(np.arctan2(east_m, north_m)), np.hypot(north_m, east_m)
    corner, origin = np.ones(16) * 1e-7, np.ones(16)
    places = GEOD.fwd(request.lon * corner, request.lat * corner, azimuth, away_m)
    azimuth, _, away_m = GEOD.inv(8.0 * origin, 47.0 * origin, *places[:2])  # the frame's
    turn = np.radians(azimuth)
    heights = height_m(away_m * np.cos(turn), away_m * np.sin(turn))
    return [round(height) for height in heights]


def bits(mask: int) -> list[int]:
    return [bit for bit in range(64) if mask >> bit & 1]


def block(request: Any, bit: int, data: list[int], **changes: int) -> Any:
    values = {"lat": request.lat, "lon": request.lon, "grid_spacing": request.grid_spacing}
    return heard("TERRAIN_DATA", **{"gridbit": bit, "data": data, **values, **changes})


def report(request: Any, pending: int = 0) -> Any:
    return heard("TERRAIN_REPORT", lat=request.lat, lon=request.lon, pending=pending)


def answers(request: Any, heights: tuple[int, ...] = (500,) * 16) -> list[Any]:
    """All blocks that are asked for, and the report."""
    blocks = (block(request, bit, [*heights]) for bit in bits(request.mask))
    return [*blocks, report(request)]


class Download:
    """A scan about a place, looked at when the test says so."""

    def __init__(
        self, centre: tuple[float, ...] = CORNER, range_m: float = 2000.0, known: KnownMap = MAP
    ) -> None:
        settings = replace(MISSION.task.settings, scan_range_m=range_m, scan_time_s=DEADLINE_S)
        task, to_the_north = replace(MISSION.task, settings=settings), (centre[0] + 1e5, centre[1])
        mission = replace(MISSION, task=task, targets_ne_m=(to_the_north,))
        self.radar, self.done = TerrainRadar(mission), list[ScanDone]()
        self.radar.begin((*centre[:2], 0.0), State.of(mission, known), 0.0)

    def asks(self, now_s: float, place: Any = HERE) -> Any:
        """What it asks for now; of a scan that is over, nothing, and it is not asked again."""
        told = None if self.done else self.radar.go_on(now_s, place)
        if isinstance(told, ScanDone):
            self.done.append(told)
        return None if self.done else told

    def is_over(self, now_s: float) -> bool:
        self.asks(now_s)
        return bool(self.done)

    def scan(self) -> Scan:
        """What it says of it in the end."""
        assert self.is_over(DEADLINE_S)
        return self.done[0].scan


def on_map(scan: Scan) -> Any:
    whole = np.full(MAP.upper_m.shape, math.nan)
    rows, columns = scan.heights_m.shape
    whole[scan.row : scan.row + rows, scan.column : scan.column + columns] = scan.heights_m
    return whole


def told(scan: Scan) -> set[float]:
    """The heights that were answered."""
    return set(scan.heights_m[~np.isnan(scan.heights_m)])


NORTH_M, EAST_M = np.broadcast_arrays(*MAP.middles_m())


def test_one_request_is_outstanding_until_its_report_or_its_answers_stop() -> None:
    """For a second before the first answer, and for 0.4 s after one."""
    task = Download(range_m=10_000.0)
    first = task.asks(0.0)
    assert task.asks(0.9) is None
    *blocks, over = answers(first)
    for message in (*blocks, report(first, pending=3)):
        task.radar.on_message(message, 0.96)
        assert task.asks(0.96) is None
    task.radar.on_message(over, 0.97)
    second = task.asks(0.97)
    for at_s, message in zip((1.0, 1.3), answers(second), strict=False):
        task.radar.on_message(message, at_s)
        assert task.asks(at_s) is None
    assert task.asks(1.6) is None
    third = task.asks(1.75)
    assert len({(each.lat, each.lon) for each in (first, second, third)}) == 3
    silent = Download(range_m=6000.0)
    asked = [silent.asks(tick / 10) for tick in range(40)]
    assert sum(request is not None for request in asked) == 4
    assert [silent.is_over(at_s) for at_s in (DEADLINE_S - 0.1, DEADLINE_S)] == [False, True]
    assert (silent.radar.answered, told(silent.scan())) == (0, set())
    alone = Download(range_m=1000.0)
    again = [request for tick in range(35) if (request := alone.asks(tick / 10)) is not None]
    assert (len(again), {each.mask for each in again}) == (3, {again[0].mask})
    assert alone.is_over(3.4)


def spoilt(request: Any, bit: int) -> list[Any]:
    """Of other requests, not asked for, or beside the mask."""
    unasked = [bit for bit in range(56) if not request.mask >> bit & 1]
    others = ({"lat": 470_000_000}, {"lon": 80_000_000}, {"grid_spacing": 100})
    wrong_bits = ({"gridbit": each} for each in (*unasked[:2], 56, 63, 64, 255))
    return [block(request, bit, [9] * 16, **each) for each in (*others, *wrong_bits)]


@given(
    st.sampled_from([CORNER, (0.0, 0.0), (50_000.0, 100_000.0), (-4e3, 103_000.0)]),
    st.sampled_from([1000.0, 2000.0]),
    st.sampled_from([0.6, 1.0]),
    st.randoms(use_true_random=False),
)
def test_each_cell_within_range_gets_its_height_or_if_that_is_lost_or_spoilt_it_is_unknown(
    centre: tuple[float, float], range_m: float, told_share: float, rng: Any
) -> None:
    """What is lost is asked for twice more, alone; what is known is not asked for again."""
    task, asked, told = Download(centre, range_m), Counter[Any](), set[Any]()
    for tick in range(40):
        if (request := task.asks(tick / 10)) is None:
            continue
        for bit in bits(request.mask):
            place = request.lat, request.lon, bit
            assert place not in told
            asked[place] += 1
            messages = spoilt(request, bit)
            if rng.random() < told_share:
                told.add(place)
                again = block(request, bit, [9] * 16)
                messages += [block(request, bit, true_heights(request, bit)), again]
            for message in messages:
                task.radar.on_message(message, tick / 10)
        task.radar.on_message(report(request), tick / 10)
    assert (task.radar.answered, task.radar.asked) == (len(told), len(asked))
    assert {place for place, times in asked.items() if times == 3} >= asked.keys() - told
    assert max(asked.values()) <= 3
    scan = task.scan()
    heights_m, known = on_map(scan), MAP.with_scan(scan)
    seen = ~np.isnan(heights_m)
    slack_m = 0.6 + scan.registration_m * math.hypot(0.1, 0.013)
    assert slack_m < 0.1 * CELL_M / 2  # less than a cell's error would be
    assert np.abs(heights_m - height_m(NORTH_M, EAST_M))[seen].max(initial=0.0) < slack_m
    assert not known.seen[~seen].any()  # nor sheltered
    assert np.isinf(known.upper_m[~seen]).all()
    if told_share == 1.0:
        assert seen[np.hypot(NORTH_M - centre[0], EAST_M - centre[1]) <= range_m].all()
        assert list(areas(known, centre, range_m - 2 * CELL_M, FRAME)) == []
        again = Download(centre, range_m, known)
        assert (again.radar.asked, again.is_over(0.0)) == (0, True)


def test_heights_are_kept_with_the_place_of_the_radar_and_minus_32768_is_not_seen() -> None:
    task, said = Download(), (-32768, -32767, -1, 0, 1, 32767, *(5,) * 10)
    first, *others = answers(task.asks(0.0), said)
    for at_s, place, messages in ((0.1, (1.0, 2.0, 3.0), [first]), (0.2, HERE, others)):
        assert task.asks(at_s, place) is None
        for message in messages:
            task.radar.on_message(message, at_s)
    scan = task.scan()
    places = {tuple(radar) for radar in scan.radar_nea_m[~np.isnan(scan.heights_m)]}
    assert places == {(1.0, 2.0, 3.0), HERE}
    assert told(scan) == {NOT_SEEN, *said[1:]}
    assert (scan.range_m, scan.drift_m) == (2000.0, pytest.approx(DRIFT_M))
