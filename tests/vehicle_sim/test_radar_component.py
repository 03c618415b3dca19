"""The radar's component: who gets what and when, and what each fault does to it."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest
from harness import GENTLE
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.faults import RadarConditions
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, ScanRequest, TerrainRadar, Viewpoint
from vehicle_sim.terrain import PeakTerrain
from vehicle_sim.wire.components import RadarComponent
from vehicle_sim.wire.frames import Packer, StreamParser

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
TICK_US, STEP_US, S = 50_000, 10_000, 1_000_000
ALL_BLOCKS = (1 << 56) - 1
FINE = RadarConditions()
WALL = [(2000.0, float(e), 1000.0, 200.0, 400.0) for e in range(-6000, 6001, 250)]
TERRAIN = PeakTerrain(WALL, combine="maximum", ground_amsl_m=100.25)
RADAR = TerrainRadar(TERRAIN, FRAME, range_m=4000.0)
Said = Sequence[tuple[int, int | None, Any]]
"""When, on which link (None: on all), and what."""


def vehicle(north_m: float = 0.0) -> Copter:
    latitude_deg, longitude_deg = FRAME.to_geographic(north_m, 0.0)
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    return Copter(**place, altitude_amsl_m=500.0, limits=GENTLE)


def request(mask: int = ALL_BLOCKS, spacing_m: int = 200) -> Any:
    place = (round(1e7 * at) for at in FRAME.to_geographic(-14.0 * spacing_m, -16.0 * spacing_m))
    return mavlink.MAVLink_terrain_request_message(*place, spacing_m, mask)


class Run:
    """Steps of 10 ms, ticks of 50 ms; it is the radio too."""

    def __init__(self, conditions: RadarConditions = FINE, seed: int = 1) -> None:
        radio: Any = self
        self.component = RadarComponent(RADAR, np.random.default_rng(seed), radio, 100)
        self.conditions, self.vehicle = conditions, vehicle()
        self.now_us = 0
        self.said: list[tuple[int, int | None, Any]] = []

    def send(self, message: Any, link: int | None, component: int) -> None:
        assert component == 100
        ((_, heard),) = StreamParser(datagrams=True).feed(Packer(1, component).frame(message))
        self.said.append((self.now_us, link, heard))

    def broadcast(self, message: Any, component: int) -> None:
        self.send(message, None, component)

    def ask(self, message: Any, link: int = 0) -> None:
        self.component.receive(message, Sender(system=255, component=190, link=link))

    def step(self, now_us: int) -> None:
        self.now_us, tick = now_us, now_us % TICK_US == 0
        self.component.step(now_us, self.vehicle, self.conditions, tick=tick)

    def until(self, time_us: int) -> Said:
        """What is said on the way."""
        before = len(self.said)
        while self.now_us < time_us:
            self.step(self.now_us + STEP_US)
        return self.said[before:]

    def flooded(self, ticks: int) -> list[int]:
        """When it reports, if it is asked for a block at each tick."""
        for k in range(ticks):
            self.ask(request(mask=1 << k % 56))
            self.until((k + 1) * TICK_US)
        return times_of(self.said, "TERRAIN_REPORT")


def of(said: Said, name: str) -> list[Any]:
    return [message for _, _, message in said if message.get_type() == name]


def times_of(said: Said, name: str) -> list[int]:
    return [time_us for time_us, _, message in said if message.get_type() == name]


def heights(said: Said) -> Any:
    return np.array([block.data for block in of(said, "TERRAIN_DATA")], dtype=np.int64).ravel()


def answered(conditions: RadarConditions = FINE, seed: int = 1) -> Said:
    run = Run(conditions, seed)
    run.ask(request())
    return run.until(500_000)


def test_a_request_is_answered_once_at_the_end_of_its_tick_with_what_the_radar_sees() -> None:
    run, asked = Run(), request()
    run.until(20_000)
    run.ask(asked, 3)
    said = run.until(900_000)
    assert {(time_us, link) for time_us, link, _ in said} == {(50_000, 3)}
    blocks, (report,) = of(said, "TERRAIN_DATA"), of(said, "TERRAIN_REPORT")
    for each in (*blocks, report):
        spacing_m = each.spacing if each is report else each.grid_spacing
        assert (each.lat, each.lon, spacing_m) == (asked.lat, asked.lon, 200)
    assert (report.loaded, report.pending) == (56, 0)
    assert report.terrain_height == pytest.approx(TERRAIN.height_at_amsl_m(-2800.0, -3200.0))
    assert report.current_height == pytest.approx(500.0 - report.terrain_height)
    place = {"latitude_deg": asked.lat / 1e7, "longitude_deg": asked.lon / 1e7}
    scan = ScanRequest(**place, spacing_m=200, mask=ALL_BLOCKS)
    truth = RADAR.answer(scan, Viewpoint(*FRAME.to_geographic(0.0, 0.0), 500.0))
    assert [(block.gridbit, tuple(block.data)) for block in blocks] == [
        (block.gridbit, block.heights_amsl_m) for block in truth
    ]


def test_a_newer_request_takes_the_place_of_one_not_yet_looked_at() -> None:
    run = Run()
    run.ask(request(mask=0b1))
    run.ask(request(mask=0b110))
    said = run.until(200_000)
    assert [block.gridbit for block in of(said, "TERRAIN_DATA")] == [1, 2]
    assert len(of(said, "TERRAIN_REPORT")) == 1


def test_its_heart_beats_once_a_second_and_late_beats_are_not_made_up_for() -> None:
    run = Run()
    run.flooded(101)
    assert times_of(run.said, "HEARTBEAT") == [S, 2 * S, 3 * S, 4 * S, 5 * S]
    late = Run()
    for now_us in (10 * S + STEP_US, 11 * S):
        late.step(now_us)
    assert times_of(late.said, "HEARTBEAT") == [10 * S + STEP_US, 11 * S]


def test_a_command_that_names_it_is_refused() -> None:
    run = Run()
    for target in (0, 100):
        run.ask(mavlink.MAVLink_command_long_message(1, target, 400, 0, *[0.0] * 7), 2)
    ((_, link, ack),) = run.said
    assert (link, ack.command, ack.result, ack.target_system) == (2, 400, 3, 255)


def test_silent_it_says_nothing_and_forgets_what_it_was_asked() -> None:
    run = Run(RadarConditions(silent=True))
    run.ask(request())
    assert not run.until(3 * S)
    run.conditions = FINE
    assert [message.get_type() for _, _, message in run.until(4 * S)] == ["HEARTBEAT"]


@pytest.mark.parametrize("delay_s", [0.1, 0.77])
def test_a_delay_delays_the_answer_and_not_the_look(delay_s: float) -> None:
    run = Run(RadarConditions(delay_s=delay_s))
    run.ask(request())
    run.until(60_000)
    run.vehicle = vehicle(north_m=3000.0)  # far away when the answer goes out
    said = run.until(900_000)
    assert {time_us for time_us, _, _ in said} == {50_000 + round(delay_s * S)}
    assert np.array_equal(heights(said), heights(answered()))


def test_it_holds_one_answer_at_a_time_and_keeps_a_rate_to_the_beats_of_its_sweep() -> None:
    reports = Run(RadarConditions(delay_s=1.0)).flooded(200)
    assert len(reports) == 9  # 10 s, one a second and a tick
    assert min(np.diff(reports)) >= S
    reports = Run(RadarConditions(rate_hz=4.0)).flooded(100)
    assert len(reports) == 21  # the first at once
    assert {time_us % 250_000 for time_us in reports[1:]} == {0}


def test_what_is_lost_or_missed_is_so_in_its_share_and_nothing_else_changes() -> None:
    truth = heights(answered())
    blind = answered(RadarConditions(blind=True))
    assert (len(blind), set(heights(blind))) == (57, {UNSEEN_M})
    lossy = answered(RadarConditions(frames_lost=0.3))
    blocks = of(lossy, "TERRAIN_DATA")
    assert 56 * 0.5 < len(blocks) < 56 * 0.9
    assert lossy[-1][2].loaded == 56  # the report counts them
    by_bit = {block.gridbit: block.data for block in of(answered(), "TERRAIN_DATA")}
    assert all(by_bit[block.gridbit] == block.data for block in blocks)
    got = heights(answered(RadarConditions(cells_missed=0.25)))
    seen = truth != UNSEEN_M
    missed = seen & (got == UNSEEN_M)
    assert missed.sum() / seen.sum() == pytest.approx(0.25, abs=0.05)
    assert np.array_equal(got[~missed], truth[~missed])


def test_noise_never_lowers_a_cell_unless_it_says_so() -> None:
    truth = heights(answered())
    seen = truth != UNSEEN_M
    assert seen.sum() > 500
    for noise_m, either_way in product((5.0, 10_000.0), (False, True)):
        got = heights(answered(RadarConditions(noise_m=noise_m, either_way=either_way)))
        assert np.array_equal(got == UNSEEN_M, ~seen)
        assert np.all((got >= -32768) & (got <= 32767))
        error_m = (got - truth)[seen]
        assert either_way or error_m.min() >= 0
        if (noise_m, either_way) == (5.0, False):
            assert error_m.mean() == pytest.approx(5.0 * np.sqrt(2.0 / np.pi) + 0.5, abs=0.5)
        elif noise_m == 5.0:
            assert error_m.std() == pytest.approx(5.0, rel=0.1)
            assert error_m.mean() == pytest.approx(0.0, abs=0.6)


def test_the_same_seed_spoils_the_same() -> None:
    bad = RadarConditions(noise_m=4.0, cells_missed=0.1, frames_lost=0.1)
    assert np.array_equal(heights(answered(bad)), heights(answered(bad)))
    assert not np.array_equal(heights(answered(bad)), heights(answered(bad, seed=2)))
