"""A start among posts, seen in eight sectors: a leg exists, and few searches find it."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import count, product

import numpy as np
import pytest
from planning import ask
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mavlink.near_scanner import NearScanner
from companion.mission.state import State
from companion.planner.plan import plan
from companion.planner.request import Planned, PlanRequest
from companion.world.near_map import NearSensor

HERE_NEA_M = (-2.0, -3.0, 106.6)
"""Where two lanes cross: the nearest post is 6.1 m away (flight ds-1 of docs/sensors.md)."""
EVALUATIONS = 180
AUTOPILOT = wire.MAVLink(None, srcSystem=1, srcComponent=1)


def nearest_m(sector: int) -> float:
    """The nearest echo of beams half a degree apart, nose north, up to 16 m."""
    least_m = math.inf
    bearings = np.radians(45.0 * sector - 22.25 + 0.5 * np.arange(90))
    for i, j in product(range(-10, 10), repeat=2):
        north, east = 3.0 + 10.0 * i - HERE_NEA_M[0], 2.0 + 10.0 * j - HERE_NEA_M[1]
        ahead = north * np.cos(bearings) + east * np.sin(bearings)
        aside = east * np.cos(bearings) - north * np.sin(bearings)
        meets = (ahead > 0.0) & (np.abs(aside) < 1.0)
        away_m = ahead[meets] - np.sqrt(1.0 - aside[meets] ** 2)
        least_m = min(least_m, float(away_m.min(initial=math.inf)))
    return least_m if least_m <= 16.0 else math.inf


@pytest.fixture(scope="module")
def request_at_rest() -> PlanRequest:
    mission = load_mission("posts")
    near = NearSensor(
        kind="distance_sensor",
        component_id=1,
        range_m=16.0,
        latency_s=0.06,
        latency_error_s=0.03,
        range_error_m=0.25,
        position_error_m=0.1,
        speaks_for_m=6.0,
    )
    assert mission.known is not None
    scanner, known = NearScanner(replace(mission, near=near)), mission.known
    state, told_m = State.of(mission, known), [nearest_m(sector) for sector in range(8)]
    for k in range(100):
        now_s, stamp_ms = 10.0 + 0.05 * k, 10_000 + 50 * k
        scanner.on_position(now_s, HERE_NEA_M)
        said = [wire.MAVLink_attitude_message(stamp_ms, *[0.0] * 6)]
        said += [
            wire.MAVLink_distance_sensor_message(
                stamp_ms, 20, 1600, int(100.0 * told_m[sector]), 0, 10 + sector, sector, 0
            )
            for sector in range(8)
            if told_m[sector] < math.inf
        ]
        for message in said:
            message.pack(AUTOPILOT)
            scanner.on_message(message, now_s)
        if k == 50:
            scanner.begin(HERE_NEA_M, state, now_s)
        scanner.seen(now_s)
        if (done := scanner.done(now_s)) is not None:
            known = known.with_scan(done.scan)
    settings = replace(mission.task.settings, evaluations=EVALUATIONS)
    task, target = replace(mission.task, settings=settings), mission.targets_ne_m[0]
    return ask(task, known, HERE_NEA_M, seed=1, target_ne_m=target)


def up_after(questions: int) -> Callable[[], bool]:
    asked = count(1)
    return lambda: next(asked) > questions


def test_a_slow_computer_finds_a_leg_too(request_at_rest: PlanRequest) -> None:
    """Time for one search or none; four real flights gave up so."""
    for questions in (1, 2, 3, 100):
        outcome = plan(request_at_rest, up_after(questions))
        assert isinstance(outcome, Planned)
        assert outcome.certificate.proven
