"""The scanner that keeps the map of near things: what becomes known, and what is not believed."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from lidars import attitude, health, obstacle_distance
from msgspec.structs import replace as changed
from wires import wire

from companion.config import load_mission
from companion.mavlink.near_scanner import NearScanner
from companion.mavlink.poses import Poses
from companion.mission.events import ScanDone
from companion.mission.state import State
from companion.world.near_map import Sight

MISSION = load_mission("forest")
PERIOD_S = 0.1
HERE_NEA_M = (20.0, 20.0, 405.0)
THING_M = 5.0
"""There is one of 10 degrees width in the north; beyond it nothing is seen."""
GROUND_AMSL_M, CEILING_AMSL_M, RANGE_M = 400.5, 408.0, 16.0


def sweep(time_s: float, *, thing: bool = True, component: int = 196, **fields: Any) -> Any:
    told = [1601] * 72
    if thing:
        told[71] = told[0] = told[1] = round(100.0 * THING_M)
    values = {"distances": told, "increment_f": 5.0, **fields}
    return obstacle_distance(time_s, reach_cm=1600, source=(1, component), **values)


class Standing:
    """A scanner on a vehicle that stands still, at 10 Hz, and the map of its mission."""

    def __init__(self, sweeps: int = 20, *, thing: bool = True) -> None:
        assert MISSION.known is not None
        self.poses, self.state = Poses(MISSION.frame), State.of(MISSION, MISSION.known)
        self.scanner = NearScanner(MISSION, self.poses)
        self.now_s, self.here_nea_m = 100.0, HERE_NEA_M
        self.run(sweeps, thing=thing)

    def tick(self, *messages: Any, thing: bool = True) -> Any:
        """The messages, or one sweep, and a position after it; what it has seen."""
        for message in messages or (sweep(self.now_s, thing=thing),):
            self.scanner.on_message(message, self.now_s)
        return self.move_on()

    def move_on(self, by_s: float = PERIOD_S) -> Any:
        self.now_s += by_s
        self.poses.on_attitude(attitude(self.now_s))
        self.poses.on_position(self.now_s, self.here_nea_m)
        return self.scanner.seen(self.now_s)

    def run(self, count: int, *, thing: bool = True) -> None:
        for _ in range(count):
            self.tick(thing=thing)

    def begin(self) -> None:
        self.scanner.begun(self.here_nea_m, self.state, self.now_s)

    def done(self, *, takes: bool = True) -> ScanDone:
        """A scan that is over; takes: the mission puts it on its map."""
        done = self.scanner.done(self.now_s)
        if takes:
            known = self.state.flight.known.with_scan(done.scan)
            self.state = changed(self.state, flight=changed(self.state.flight, known=known))
        return done

    def scan(self, *, thing: bool = True, takes: bool = True) -> None:
        self.begin()
        self.tick(thing=thing)
        assert self.done(takes=takes).answered == 1

    def upper_m(self, north_m: float, east_m: float = 20.0) -> float:
        known = self.state.flight.known
        return float(known.upper_m[known.cell_of(north_m, east_m)])


def test_a_scan_puts_on_the_map_what_is_free_what_is_closed_and_nothing_else() -> None:
    """Nor what others say of obstacles, or we, when somebody mirrors it."""
    it = Standing()
    for component in (1, 195, 197) * 7:
        it.tick(sweep(it.now_s, component=component, distances=[100] * 72))
    it.scan()
    for north_m in (15.0, 19.0, 20.0, 22.0):  # behind, below and before it
        assert it.upper_m(north_m) == GROUND_AMSL_M
    assert it.upper_m(20.0 + THING_M) == CEILING_AMSL_M + RANGE_M
    assert it.upper_m(20.0 + THING_M + 3.0) == it.upper_m(60.0) == math.inf


def test_a_later_scan_takes_back_what_is_not_free_any_more_and_frees_what_has_gone() -> None:
    it = Standing(thing=False)
    it.begin()
    it.scan()
    it.run(10)
    it.scan()
    assert it.upper_m(20.0 + THING_M) > CEILING_AMSL_M
    it.run(40, thing=False)
    it.scan(thing=False)
    assert it.upper_m(20.0 + THING_M) == GROUND_AMSL_M


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
    it.begin()
    for wait_s in (0.0, 0.05):
        it.move_on(wait_s)
        assert it.scanner.done(it.now_s) is None
    it.move_on(1.0)
    done = it.done()
    assert (done.asked, done.answered) == (1, 0)
    np.testing.assert_array_equal(it.state.flight.known.upper_m, before.upper_m)


def test_a_healthy_sensor_of_the_autopilot_that_sees_nothing_has_answered() -> None:
    assert MISSION.near is not None
    assert MISSION.known is not None
    of = replace(MISSION, near=replace(MISSION.near, kind="distance_sensor", component_id=1))
    scanner, bit = NearScanner(of, Poses(of.frame)), wire.MAV_SYS_STATUS_SENSOR_PROXIMITY
    for now_s, answered in ((100.0, 1), (105.0, 0)):
        scanner.on_message(health(bit, well=bool(answered)), now_s)
        seen = scanner.seen(now_s)
        assert seen is not None
        assert seen.sight is (Sight.NOTHING_THERE if answered else Sight.NEVER_HEARD)
        scanner.begun(HERE_NEA_M, State.of(of, MISSION.known), now_s)
        done = scanner.done(now_s + 1.0)
        assert done.answered == answered


@pytest.mark.parametrize("clock_s", [None, 2.0], ids=["runs on", "begins anew"])
def test_silence_is_told_once_and_so_is_the_return_of_sight(clock_s: float | None) -> None:
    it = Standing()
    it.now_s = clock_s or it.now_s
    told = [it.move_on() for _ in range(30)]
    assert [seen.sight for seen in told if seen] == [Sight.DEAD]
    seen = [it.tick() for _ in range(3)]
    assert all(each is not None and each.sight is Sight.SEES for each in seen)
