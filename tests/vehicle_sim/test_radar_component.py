"""The radar's component: who gets what and when, and what each fault does to it."""

from collections.abc import Sequence

import numpy as np
import pytest

from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.sensors.radar_component import (
    RadarBeat,
    RadarBlock,
    RadarComponent,
    RadarConditions,
    RadarReply,
    RadarReport,
    TerrainCheck,
)
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, ScanRequest, TerrainRadar, Viewpoint
from vehicle_sim.terrain import PeakTerrain

FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
RANGE_M = 4000.0
TICK_US, STEP_US = 50_000, 10_000
ALL_BLOCKS = (1 << 56) - 1
FINE = RadarConditions()
S = 1_000_000
WALL = [(2000.0, float(e), 1000.0, 200.0, 400.0) for e in range(-6000, 6001, 250)]
TERRAIN = PeakTerrain.of(WALL, combine="maximum", ground_amsl_m=100.25)
LIMITS = Limits(
    speed_m_s=50.0,
    acceleration_m_s2=9.0,
    speed_vertical_m_s=5.0,
    acceleration_vertical_m_s2=5.0,
)


def vehicle(north_m: float = 0.0, altitude_amsl_m: float = 500.0) -> Copter:
    latitude_deg, longitude_deg = FRAME.to_geographic(north_m, 0.0)
    return Copter(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_amsl_m=altitude_amsl_m,
        limits=LIMITS,
    )


def request(mask: int = ALL_BLOCKS, spacing_m: int = 200) -> ScanRequest:
    corner = FRAME.to_geographic(-14.0 * spacing_m, -16.0 * spacing_m)
    return ScanRequest(
        latitude_deg=corner[0], longitude_deg=corner[1], spacing_m=spacing_m, mask=mask
    )


def component(seed: int = 1) -> RadarComponent:
    radar = TerrainRadar(TERRAIN, FRAME, range_m=RANGE_M)
    return RadarComponent(radar, np.random.default_rng(seed))


class Run:
    """Steps of 10 ms, ticks of 50 ms."""

    def __init__(self, conditions: RadarConditions = FINE, seed: int = 1) -> None:
        self.component, self.conditions = component(seed), conditions
        self.vehicle = vehicle()
        self.now_us = 0
        self.said: list[tuple[int, RadarReply]] = []

    def until(self, time_us: int) -> Sequence[tuple[int, RadarReply]]:
        """What is said on the way."""
        before = len(self.said)
        while self.now_us < time_us:
            self.now_us += STEP_US
            replies = self.component.step(
                self.now_us,
                ends_tick=self.now_us % TICK_US == 0,
                vehicle=self.vehicle,
                conditions=self.conditions,
            )
            self.said += [(self.now_us, reply) for reply in replies]
        return self.said[before:]


def heights(
    said: Sequence[tuple[int, RadarReply]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    rows = [reply.block.heights_amsl_m for _, reply in said if isinstance(reply, RadarBlock)]
    return np.array(rows, dtype=np.int64).ravel()


def answered(conditions: RadarConditions = FINE, seed: int = 1) -> Sequence[tuple[int, RadarReply]]:
    run = Run(conditions, seed)
    run.component.ask(request(), 0)
    return run.until(500_000)


def test_a_request_is_answered_at_the_end_of_its_tick_and_only_once() -> None:
    run = Run()
    run.until(20_000)
    run.component.ask(request(), 3)
    said = run.until(900_000)
    assert {time_us for time_us, _ in said} == {50_000}
    blocks = [reply for _, reply in said if isinstance(reply, RadarBlock)]
    assert [reply.block.gridbit for reply in blocks] == list(range(56))
    report = said[-1][1]
    assert isinstance(report, RadarReport)
    assert (report.blocks, report.spacing_m) == (56, 200)
    assert report.ground_amsl_m == pytest.approx(TERRAIN.height_at_amsl_m(-2800.0, -3200.0))
    assert report.above_ground_m == pytest.approx(500.0 - report.ground_amsl_m)
    assert all(not isinstance(reply, RadarBeat) and reply.link == 3 for _, reply in said)


def test_untouched_it_says_what_the_radar_says() -> None:
    run = Run()
    run.component.ask(request(), 0)
    said = run.until(100_000)
    view = Viewpoint(
        latitude_deg=run.vehicle.latitude_deg,
        longitude_deg=run.vehicle.longitude_deg,
        altitude_amsl_m=run.vehicle.altitude_amsl_m,
    )
    truth = TerrainRadar(TERRAIN, FRAME, range_m=RANGE_M).answer(request(), view)
    assert [reply.block for _, reply in said if isinstance(reply, RadarBlock)] == list(truth)


def test_a_newer_request_takes_the_place_of_one_not_yet_looked_at() -> None:
    run = Run()
    run.component.ask(request(mask=0b1), 0)
    run.component.ask(request(mask=0b110), 0)
    said = run.until(200_000)
    assert [reply.block.gridbit for _, reply in said if isinstance(reply, RadarBlock)] == [1, 2]
    assert sum(isinstance(reply, RadarReport) for _, reply in said) == 1


def test_its_heart_beats_once_a_second_whatever_is_asked() -> None:
    run = Run()
    for k in range(1, 60):
        run.component.ask(request(mask=1 << k % 56), 0)
        run.until(k * 100_000)
    beats = [time_us for time_us, reply in run.said if isinstance(reply, RadarBeat)]
    assert beats == [S, 2 * S, 3 * S, 4 * S, 5 * S]


def test_late_beats_are_not_made_up_for() -> None:
    radar, copter = component(), vehicle()
    said = radar.step(10 * S + STEP_US, ends_tick=False, vehicle=copter, conditions=FINE)
    assert said == [RadarBeat()]
    said = radar.step(11 * S, ends_tick=False, vehicle=copter, conditions=FINE)
    assert said == [RadarBeat()]


def test_silent_it_says_nothing_and_forgets_what_it_was_asked() -> None:
    run = Run(RadarConditions(silent=True))
    run.component.ask(request(), 0)
    assert not run.until(3 * S)
    run.conditions = FINE
    said = run.until(4 * S)
    assert [type(reply) for _, reply in said] == [RadarBeat]


def test_blind_it_answers_in_full_and_sees_nothing() -> None:
    said = answered(RadarConditions(blind=True))
    assert len(said) == 57
    assert set(heights(said)) == {UNSEEN_M}


@pytest.mark.parametrize("delay_s", [0.1, 0.77])
def test_a_delay_delays_the_answer_and_not_the_look(delay_s: float) -> None:
    run = Run(RadarConditions(delay_s=delay_s))
    run.component.ask(request(), 0)
    run.until(60_000)
    run.vehicle = vehicle(north_m=3000.0)  # far away when the answer goes out
    said = [item for item in run.until(900_000) if not isinstance(item[1], RadarBeat)]
    assert {time_us for time_us, _ in said} == {50_000 + round(delay_s * S)}
    assert np.array_equal(heights(said), heights(answered()))


def test_it_holds_one_answer_at_a_time_however_many_are_asked_for() -> None:
    run = Run(RadarConditions(delay_s=1.0))
    for k in range(200):
        run.component.ask(request(mask=1 << k % 56), 0)
        run.until((k + 1) * TICK_US)
    reports = [time_us for time_us, reply in run.said if isinstance(reply, RadarReport)]
    assert len(reports) == 9  # 10 s, one a second and a tick
    assert min(np.diff(reports)) >= S


def test_a_rate_is_kept_to_the_beats_of_the_sweep() -> None:
    run = Run(RadarConditions(rate_hz=4.0))
    for k in range(100):
        run.component.ask(request(mask=1), 0)
        run.until((k + 1) * TICK_US)
    reports = [time_us for time_us, reply in run.said if isinstance(reply, RadarReport)]
    assert len(reports) == 21  # the first at once
    assert {time_us % 250_000 for time_us in reports[1:]} == {0}


def test_lost_frames_are_missing_and_the_report_still_counts_them() -> None:
    said = answered(RadarConditions(frames_lost=0.3))
    blocks = [reply.block for _, reply in said if isinstance(reply, RadarBlock)]
    assert 56 * 0.5 < len(blocks) < 56 * 0.9
    assert isinstance(said[-1][1], RadarReport)
    assert said[-1][1].blocks == 56
    truth = {
        reply.block.gridbit: reply.block for _, reply in answered() if isinstance(reply, RadarBlock)
    }
    assert all(truth[block.gridbit] == block for block in blocks)


def test_missed_cells_are_unseen_and_no_other_changes() -> None:
    truth, got = heights(answered()), heights(answered(RadarConditions(cells_missed=0.25)))
    seen = truth != UNSEEN_M
    missed = seen & (got == UNSEEN_M)
    assert missed.sum() / seen.sum() == pytest.approx(0.25, abs=0.05)
    assert np.array_equal(got[~missed], truth[~missed])


def test_noise_never_lowers_a_cell_unless_its_sign_says_so() -> None:
    truth = heights(answered())
    seen = truth != UNSEEN_M
    assert seen.sum() > 500
    up = heights(answered(RadarConditions(noise_m=5.0)))
    error = (up - truth)[seen]
    assert np.array_equal(up == UNSEEN_M, ~seen)
    assert error.min() >= 0
    assert error.mean() == pytest.approx(5.0 * np.sqrt(2.0 / np.pi) + 0.5, abs=0.5)
    either = heights(answered(RadarConditions(noise_m=-5.0)))
    error = (either - truth)[seen]
    assert error.std() == pytest.approx(5.0, rel=0.1)
    assert error.mean() == pytest.approx(0.0, abs=0.6)
    assert np.array_equal(either == UNSEEN_M, ~seen)


def test_noise_as_high_as_the_sky_stays_a_height() -> None:
    for noise_m in (10_000.0, -10_000.0):
        got = heights(answered(RadarConditions(noise_m=noise_m)))
        assert np.all((got >= -32768) & (got <= 32767))
        assert np.array_equal(got == UNSEEN_M, heights(answered()) == UNSEEN_M)


def test_the_same_seed_spoils_the_same() -> None:
    bad = RadarConditions(noise_m=4.0, cells_missed=0.1, frames_lost=0.1)
    assert answered(bad) == answered(bad)
    assert answered(bad) != answered(bad, seed=2)


@pytest.mark.parametrize(
    ("north_m", "seen"), [(1000.0, True), (3500.0, False), (5000.0, False), (0.0, True)]
)
def test_a_check_tells_the_height_of_a_place_in_sight(north_m: float, *, seen: bool) -> None:
    """Before the wall, behind it, beyond the range, below the vehicle."""
    run = Run()
    latitude_deg, longitude_deg = FRAME.to_geographic(north_m, 0.0)
    run.component.ask(TerrainCheck(latitude_deg=latitude_deg, longitude_deg=longitude_deg), 2)
    said = run.until(100_000)
    assert len(said) == 1
    report = said[0][1]
    assert isinstance(report, RadarReport)
    assert (report.spacing_m, report.link, report.blocks) == (int(seen), 2, 0)
    if seen:
        assert report.ground_amsl_m == np.ceil(TERRAIN.height_at_amsl_m(north_m, 0.0))
        assert report.above_ground_m == 500.0 - report.ground_amsl_m


def test_a_blind_radar_knows_no_place_and_the_pole_is_no_place() -> None:
    run = Run(RadarConditions(blind=True))
    run.component.ask(TerrainCheck(latitude_deg=47.0, longitude_deg=8.0), 0)
    run.until(50_000)
    run.conditions = FINE
    run.component.ask(TerrainCheck(latitude_deg=90.0, longitude_deg=8.0), 0)
    run.until(100_000)
    run.component.ask(TerrainCheck(latitude_deg=-214.7, longitude_deg=-214.7), 0)
    run.until(150_000)
    reports = [reply for _, reply in run.said if isinstance(reply, RadarReport)]
    assert [report.spacing_m for report in reports] == [0, 0, 0]


def test_an_idle_step_says_nothing_and_makes_no_list() -> None:
    radar, copter = component(), vehicle()
    first = radar.step(10_000, ends_tick=True, vehicle=copter, conditions=FINE)
    assert first == ()
    assert radar.step(20_000, ends_tick=True, vehicle=copter, conditions=FINE) is first
