"""The radar's component: who gets what and when, and what each fault does to it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from harness import GENTLE
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.conditions import RadarConditions
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.sensors.terrain_radar import (
    UNSEEN_M,
    ScanRequest,
    TerrainRadar,
    Viewpoint,
)
from vehicle_sim.terrain import PeakTerrain
from vehicle_sim.wire.frames import Packer, StreamParser
from vehicle_sim.wire.radar import RadarComponent

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
RANGE_M = 4000.0
TICK_US, STEP_US = 50_000, 10_000
ALL_BLOCKS = (1 << 56) - 1
FINE = RadarConditions()
S = 1_000_000
WALL = [(2000.0, float(e), 1000.0, 200.0, 400.0) for e in range(-6000, 6001, 250)]
TERRAIN = PeakTerrain(WALL, combine="maximum", ground_amsl_m=100.25)


def vehicle(north_m: float = 0.0, altitude_amsl_m: float = 500.0) -> Copter:
    latitude_deg, longitude_deg = FRAME.to_geographic(north_m, 0.0)
    return Copter(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_amsl_m=altitude_amsl_m,
        limits=GENTLE,
    )


def request(mask: int = ALL_BLOCKS, spacing_m: int = 200) -> Any:
    place = (round(1e7 * at) for at in FRAME.to_geographic(-14.0 * spacing_m, -16.0 * spacing_m))
    return mavlink.MAVLink_terrain_request_message(*place, spacing_m, mask)


Said = Sequence[tuple[int, int | None, Any]]
"""When, on which link (None: on all), and what."""


class Run:
    """Steps of 10 ms, ticks of 50 ms; it is the radio too."""

    def __init__(self, conditions: RadarConditions = FINE, seed: int = 1) -> None:
        radar = TerrainRadar(TERRAIN, FRAME, range_m=RANGE_M)
        self.component = RadarComponent(radar, np.random.default_rng(seed), self, 100)
        self.conditions = conditions
        self.vehicle = vehicle()
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
        self.now_us = now_us
        tick = now_us % TICK_US == 0
        self.component.step(now_us, self.vehicle, self.conditions, tick=tick)

    def until(self, time_us: int) -> Said:
        """What is said on the way."""
        before = len(self.said)
        while self.now_us < time_us:
            self.step(self.now_us + STEP_US)
        return self.said[before:]


def of(said: Said, name: str) -> list[Any]:
    """The messages of this name."""
    return [message for _, _, message in said if message.get_type() == name]


def times_of(said: Said, name: str) -> list[int]:
    return [time_us for time_us, _, message in said if message.get_type() == name]


def heights(said: Said) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    return np.array([block.data for block in of(said, "TERRAIN_DATA")], dtype=np.int64).ravel()


def answered(conditions: RadarConditions = FINE, seed: int = 1) -> Said:
    run = Run(conditions, seed)
    run.ask(request())
    return run.until(500_000)


def test_a_request_is_answered_at_the_end_of_its_tick_and_only_once() -> None:
    run = Run()
    run.until(20_000)
    asked = request()
    run.ask(asked, 3)
    said = run.until(900_000)
    assert {(time_us, link) for time_us, link, _ in said} == {(50_000, 3)}
    blocks, (report,) = of(said, "TERRAIN_DATA"), of(said, "TERRAIN_REPORT")
    assert [block.gridbit for block in blocks] == list(range(56))
    assert {(block.lat, block.lon, block.grid_spacing) for block in blocks} == {
        (asked.lat, asked.lon, 200)
    }
    assert (report.loaded, report.pending, report.spacing) == (56, 0, 200)
    assert report.terrain_height == pytest.approx(TERRAIN.height_at_amsl_m(-2800.0, -3200.0))
    assert report.current_height == pytest.approx(500.0 - report.terrain_height)


def test_untouched_it_says_what_the_radar_says() -> None:
    run = Run()
    run.ask(request())
    said = run.until(100_000)
    view = Viewpoint(
        latitude_deg=run.vehicle.latitude_deg,
        longitude_deg=run.vehicle.longitude_deg,
        altitude_amsl_m=run.vehicle.altitude_amsl_m,
    )
    asked = request()
    scan = ScanRequest(
        latitude_deg=asked.lat / 1e7, longitude_deg=asked.lon / 1e7, spacing_m=200, mask=ALL_BLOCKS
    )
    truth = TerrainRadar(TERRAIN, FRAME, range_m=RANGE_M).answer(scan, view)
    got = [(block.gridbit, tuple(block.data)) for block in of(said, "TERRAIN_DATA")]
    assert got == [(block.gridbit, block.heights_amsl_m) for block in truth]


def test_a_newer_request_takes_the_place_of_one_not_yet_looked_at() -> None:
    run = Run()
    run.ask(request(mask=0b1))
    run.ask(request(mask=0b110))
    said = run.until(200_000)
    assert [block.gridbit for block in of(said, "TERRAIN_DATA")] == [1, 2]
    assert len(of(said, "TERRAIN_REPORT")) == 1


def test_its_heart_beats_once_a_second_whatever_is_asked() -> None:
    run = Run()
    for k in range(1, 60):
        run.ask(request(mask=1 << k % 56))
        run.until(k * 100_000)
    assert times_of(run.said, "HEARTBEAT") == [S, 2 * S, 3 * S, 4 * S, 5 * S]


def test_late_beats_are_not_made_up_for() -> None:
    run = Run()
    for now_us in (10 * S + STEP_US, 11 * S):
        run.step(now_us)
    assert times_of(run.said, "HEARTBEAT") == [10 * S + STEP_US, 11 * S]


def test_silent_it_says_nothing_and_forgets_what_it_was_asked() -> None:
    run = Run(RadarConditions(silent=True))
    run.ask(request())
    assert not run.until(3 * S)
    run.conditions = FINE
    said = run.until(4 * S)
    assert [message.get_type() for _, _, message in said] == ["HEARTBEAT"]


def test_blind_it_answers_in_full_and_sees_nothing() -> None:
    said = answered(RadarConditions(blind=True))
    assert len(said) == 57
    assert set(heights(said)) == {UNSEEN_M}


@pytest.mark.parametrize("delay_s", [0.1, 0.77])
def test_a_delay_delays_the_answer_and_not_the_look(delay_s: float) -> None:
    run = Run(RadarConditions(delay_s=delay_s))
    run.ask(request())
    run.until(60_000)
    run.vehicle = vehicle(north_m=3000.0)  # far away when the answer goes out
    said = run.until(900_000)
    assert {time_us for time_us, _, _ in said} == {50_000 + round(delay_s * S)}
    assert np.array_equal(heights(said), heights(answered()))


def test_it_holds_one_answer_at_a_time_however_many_are_asked_for() -> None:
    run = Run(RadarConditions(delay_s=1.0))
    for k in range(200):
        run.ask(request(mask=1 << k % 56))
        run.until((k + 1) * TICK_US)
    reports = times_of(run.said, "TERRAIN_REPORT")
    assert len(reports) == 9  # 10 s, one a second and a tick
    assert min(np.diff(reports)) >= S


def test_a_rate_is_kept_to_the_beats_of_the_sweep() -> None:
    run = Run(RadarConditions(rate_hz=4.0))
    for k in range(100):
        run.ask(request(mask=1))
        run.until((k + 1) * TICK_US)
    reports = times_of(run.said, "TERRAIN_REPORT")
    assert len(reports) == 21  # the first at once
    assert {time_us % 250_000 for time_us in reports[1:]} == {0}


def test_lost_frames_are_missing_and_the_report_still_counts_them() -> None:
    said = answered(RadarConditions(frames_lost=0.3))
    blocks = of(said, "TERRAIN_DATA")
    assert 56 * 0.5 < len(blocks) < 56 * 0.9
    assert said[-1][2].loaded == 56
    truth = {block.gridbit: block.data for block in of(answered(), "TERRAIN_DATA")}
    assert all(truth[block.gridbit] == block.data for block in blocks)


def test_missed_cells_are_unseen_and_no_other_changes() -> None:
    truth, got = heights(answered()), heights(answered(RadarConditions(cells_missed=0.25)))
    seen = truth != UNSEEN_M
    missed = seen & (got == UNSEEN_M)
    assert missed.sum() / seen.sum() == pytest.approx(0.25, abs=0.05)
    assert np.array_equal(got[~missed], truth[~missed])


def test_noise_never_lowers_a_cell_unless_it_says_so() -> None:
    truth = heights(answered())
    seen = truth != UNSEEN_M
    assert seen.sum() > 500
    up = heights(answered(RadarConditions(noise_m=5.0)))
    error = (up - truth)[seen]
    assert np.array_equal(up == UNSEEN_M, ~seen)
    assert error.min() >= 0
    assert error.mean() == pytest.approx(5.0 * np.sqrt(2.0 / np.pi) + 0.5, abs=0.5)
    either = heights(answered(RadarConditions(noise_m=5.0, either_way=True)))
    error = (either - truth)[seen]
    assert error.std() == pytest.approx(5.0, rel=0.1)
    assert error.mean() == pytest.approx(0.0, abs=0.6)
    assert np.array_equal(either == UNSEEN_M, ~seen)


def test_noise_as_high_as_the_sky_stays_a_height() -> None:
    for either_way in (False, True):
        got = heights(answered(RadarConditions(noise_m=10_000.0, either_way=either_way)))
        assert np.all((got >= -32768) & (got <= 32767))
        assert np.array_equal(got == UNSEEN_M, heights(answered()) == UNSEEN_M)


def test_the_same_seed_spoils_the_same() -> None:
    bad = RadarConditions(noise_m=4.0, cells_missed=0.1, frames_lost=0.1)
    assert np.array_equal(heights(answered(bad)), heights(answered(bad)))
    assert not np.array_equal(heights(answered(bad)), heights(answered(bad, seed=2)))
