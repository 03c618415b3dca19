"""The map of near things: what becomes known, what is not believed, and real posts."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from held import recorded
from lidars import attitude, beam, health, obstacle_distance, tell
from msgspec.structs import replace as changed
from wires import wire

from companion.config import load_mission
from companion.geodesy import LocalFrame
from companion.mavlink.autopilots.messages import position
from companion.mavlink.near_sensing import NearScanner, NearSensing
from companion.mavlink.poses import Poses
from companion.mission.state import State
from companion.world.known_map import Lattice
from companion.world.near_map import NearMap, NearSensor, Sight

MISSION: Any = load_mission("forest")
THING_M = 5.0
"""There is one of 10 degrees width in the north; beyond it nothing is seen."""
GROUND_AMSL_M, CEILING_AMSL_M, RANGE_M = 400.5, 408.0, 16.0


def sweep(time_s: float, *, component: int = 196, **fields: Any) -> Any:
    told = [1601] * 72
    told[71] = told[0] = told[1] = round(100.0 * THING_M)
    values = {"distances": told, "increment_f": 5.0, **fields}
    return obstacle_distance(time_s, reach_cm=1600, source=(1, component), **values)


class Standing:
    """A scanner on a vehicle that stands still, at 10 Hz, and the map of its mission."""

    def __init__(self) -> None:
        self.poses, self.state = Poses(MISSION.frame), State.of(MISSION, MISSION.known)
        self.scanner = NearScanner(MISSION, self.poses)
        self.now_s, self.here_nea_m = 100.0, (20.0, 20.0, 405.0)
        self.run(20)

    def run(self, count: int = 1, **fields: Any) -> list[Any]:
        """So many sweeps, and a position after each; what it has seen."""
        told = []
        for _ in range(count):
            tell(self.scanner, sweep(self.now_s, **fields), self.now_s)
            told.append(self.move_on())
        return told

    def move_on(self, by_s: float = 0.1) -> Any:
        self.now_s += by_s
        self.poses.on_attitude(attitude(self.now_s))
        self.poses.on_position(self.now_s, self.here_nea_m)
        return self.scanner.seen(self.now_s, self.state.flight.known)

    def scan(self, *, takes: bool = True) -> None:
        """One sweep is enough; takes: the mission puts it on its map."""
        self.scanner.begin(self.here_nea_m, self.state, self.now_s)
        self.run()
        done: Any = self.scanner.go_on(self.now_s, self.here_nea_m)
        assert done.answered == 1
        if takes:
            known = self.state.flight.known.with_scan(done.scan)
            self.state = changed(self.state, flight=changed(self.state.flight, known=known))

    def upper_m(self, north_m: float) -> float:
        known = self.state.flight.known
        return float(known.upper_m[known.cell_of(north_m, 20.0)])


def test_a_scan_puts_on_the_map_what_is_free_what_is_closed_and_nothing_else() -> None:
    """Nor what others say of obstacles, or we, when somebody mirrors it."""
    it = Standing()
    for component in (1, 195, 197) * 7:
        it.run(component=component, distances=[100] * 72)
    it.scan()
    free = dict.fromkeys((15.0, 19.0, 20.0, 22.0), GROUND_AMSL_M)  # behind, below and before it
    closed = {20.0 + THING_M: CEILING_AMSL_M + RANGE_M}
    expected = {**free, **closed, 20.0 + THING_M + 3.0: math.inf, 60.0: math.inf}
    assert {north_m: it.upper_m(north_m) for north_m in expected} == expected


def test_what_a_scan_told_that_nobody_took_is_told_again() -> None:
    """As after a stop in the moment of a scan; from where it is next, nothing of it is seen."""
    one, other = Standing(), Standing()
    for it in (one, other):
        it.scan(takes=it is one)
        it.here_nea_m = (60.0, 20.0, 405.0)
        it.move_on(1.0)
        it.run(3)
        it.scan()
    np.testing.assert_array_equal(one.state.flight.known.upper_m, other.state.flight.known.upper_m)
    assert other.upper_m(20.0) == GROUND_AMSL_M


def test_a_scan_waits_for_a_new_sweep_and_no_longer_than_it_may_and_changes_nothing_then() -> None:
    it = Standing()
    it.scan()
    before = it.state.flight.known
    it.scanner.begin(it.here_nea_m, it.state, it.now_s)
    for wait_s in (0.0, 0.05):
        it.move_on(wait_s)
        assert it.scanner.go_on(it.now_s, it.here_nea_m) is None
    it.move_on(1.0)
    done: Any = it.scanner.go_on(it.now_s, it.here_nea_m)
    assert (done.asked, done.answered) == (1, 0)
    np.testing.assert_array_equal(before.with_scan(done.scan).upper_m, before.upper_m)


def test_the_silence_of_a_lidar_of_the_autopilot_is_an_answer_while_it_is_well() -> None:
    of = replace(MISSION, near=replace(MISSION.near, kind="distance_sensor", component_id=1))
    scanner = NearScanner(of, Poses(of.frame))
    for now_s, message, sight in (
        (90.0, health(well=True), Sight.NOTHING_THERE),
        (95.0, health(well=False), Sight.NEVER_HEARD),
        (100.0, beam(100.0), Sight.SEES),
        (101.0, health(well=True), Sight.NOTHING_THERE),
        (102.0, health(well=False), Sight.DEAD),
    ):
        tell(scanner, message, now_s)
        seen: Any = scanner.seen(now_s, MISSION.known)
        assert seen.sight is sight
        scanner.begin((20.0, 20.0, 405.0), State.of(of, MISSION.known), now_s)
        done: Any = scanner.go_on(now_s + 1.0, None)
        assert done.answered == (not sight.is_blind)


@pytest.mark.parametrize("clock_s", [None, 2.0], ids=["runs on", "begins anew"])
def test_silence_is_told_once_and_so_is_the_return_of_sight(clock_s: float | None) -> None:
    it = Standing()
    it.now_s = clock_s or it.now_s
    told = [it.move_on() for _ in range(30)]
    assert [seen.sight for seen in told if seen] == [Sight.DEAD]
    assert [seen.sight for seen in it.run(3)] == [Sight.SEES] * 3


# --- what a lidar behind a real autopilot saw among posts of known place (recordings/README.md)

HOME = LocalFrame(latitude_deg=51.8752066, longitude_deg=14.6487830)
LIDAR = NearSensor(kind="distance_sensor", component_id=1, range_m=16.0, blind_m=0.2)
CELL_M = 0.25
LATTICE = Lattice(cell_m=CELL_M, north_min_m=-150.0, east_min_m=-150.0, shape=(1200, 1200))
NORTH_M, EAST_M = LATTICE.middles_m()
FROM_POST_M = np.abs((NORTH_M - 8.0) % 10.0 - 5.0), np.abs((EAST_M - 7.0) % 10.0 - 5.0)
"""North and east: there is one of 1 m radius at 3 and 2 m, and 10 m on another, and so on."""
OF_POSTS = np.hypot(*(np.maximum(off_m - 0.5 * CELL_M, 0.0) for off_m in FROM_POST_M)) < 1.0
BETWEEN = np.hypot(*FROM_POST_M) > 1.75


def seen(until_s: float) -> Iterator[tuple[float, tuple[float, float], NearSensing]]:
    """Vehicle time, place and what the lidar says, at each position."""
    poses, now_s, where = Poses(HOME), 0.0, wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
    sensing = NearSensing(LIDAR, poses)
    read = {where, *(number for _, number in sensing.reads)}
    for _, message in recorded("arducopter-lidar.tlog", frozenset(wire.mavlink_map) - read):
        if (message.get_srcSystem(), message.get_srcComponent()) != (1, 1):
            continue
        tell(sensing, message, now_s)
        if message.get_msgId() == where and (told := position(message, 0.0, HOME)) is not None:
            now_s = told.time_s
            if now_s >= until_s:
                return
            poses.on_position(now_s, told.position_nea_m)
            yield now_s, told.position_nea_m[:2], sensing


def test_times_of_silence_are_told_apart() -> None:
    """219.7 to 244.2 s no sector had an echo, which counts after half a second; it was well."""
    seconds, before_s = Counter[Sight](), 210.0
    for now_s, _, sensing in seen(250.0):
        if now_s > before_s:
            seconds[sensing.sight(now_s)] += now_s - before_s
            before_s = now_s
    assert seconds[Sight.NOTHING_THERE] == pytest.approx(24.0, abs=0.5)
    assert seconds[Sight.SEES] == pytest.approx(16.0, abs=0.5)


@pytest.mark.parametrize("until_s", [110.0, pytest.param(220.0, marks=pytest.mark.nightly)])
def test_at_no_time_is_a_post_free_and_the_space_between_is(until_s: float) -> None:
    near, share, looked_s = NearMap(LATTICE), [], 55.0
    for now_s, here, sensing in seen(until_s):
        for each in sensing.sweeps():
            near.add(each)
        if now_s >= looked_s:
            looked_s, free = now_s + 2.0, near.free()
            assert not free[OF_POSTS].any(), now_s
            about = np.hypot(NORTH_M - here[0], EAST_M - here[1]) < 4.0
            share.append(free[about & BETWEEN].mean())
    assert len(share) > 0.45 * (until_s - 55.0)
    assert np.mean(share) > 0.85
