"""Benchmarks count fairly: bars are held, a rival is what it is called, the best route is one."""

import io
import json
import math
import subprocess
import sys
from contextlib import redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import optimum
import pytest
import running
from campaign_rows import row
from certificate import certificate
from running import Bar, Found, least, main, most
from scipy.sparse.csgraph import dijkstra
from woods import a_star

from companion.campaign import drawn_world, truth
from companion.library import route_terms
from companion.world.radars import Radar
from companion.world.terrain import PeakTerrain

# --- the frame: parameters are options, rows are Markdown, bars are held


def measured(
    flights: int = 2,
    world: Literal["forest", "street"] = "forest",
    rates: tuple[float, ...] = (20.0, 200.0),
    only: tuple[Literal["a", "b"], ...] = ("a", "b"),
    idle: bool = False,
) -> Found:
    """A benchmark."""
    yield "a title"
    for number in range(flights):
        yield {"flight": f"{world}-{number}", "m|.1f": 0.25 * number, "why": None}
    yield [rates, only, idle]
    yield most("metres", 0.25 * (flights - 1), 0.5)
    yield least("flights", flights, 1)


def run(words: str) -> tuple[object, str, str]:
    """Its exit code, what it prints, and what it says of errors."""
    shown, said = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stderr(said):
        patch.setattr(running, "CONSOLE", running.Console(file=shown, width=100))
        patch.setattr(sys, "argv", ["bench", *words.split()])
        with pytest.raises(SystemExit) as ended:
            main(measured)
    return ended.value.code, shown.getvalue(), said.getvalue()


def test_parameters_are_options_and_what_is_yielded_is_printed_and_written(tmp_path: Path) -> None:
    path = tmp_path / "found.json"
    options = "--world street --rates 5 --only b --idle --flights 3"
    code, shown, _ = run(f"{options} --json {path}")
    assert not code
    assert json.loads(path.read_text(encoding="utf-8")) == {
        "rows": [{"flight": f"street-{k}", "m": 0.25 * k, "why": None} for k in range(3)],
        "found": [[[5.0], ["b"], True]],
        "bars": [["metres", "0.5", "0.5", True], ["flights", "1 or more", "3", True]],
    }
    lines = {line.replace(" ", "") for line in shown.splitlines()}
    assert {"atitle", "|flight|m|why|", "|street-2|0.5||", "|metres|0.5|0.5|met|"} <= lines


def test_a_missed_bar_and_a_word_that_is_none_of_the_choices_end_it_with_a_code() -> None:
    assert run("--flights 9")[0] == 1
    code, _, said = run("--only c")
    assert code == 2
    assert "invalid choice: 'c'" in said


def test_certificates_are_held_to_brute_force() -> None:
    bars = [line for line in certificate(cases=3, seed=5) if isinstance(line, Bar)]
    assert [bar.kept for bar in bars] == [True, True]


IMPORT = """
import runpy, sys
from pathlib import Path
sys.path[0] = "scripts/benchmarks"
for file in sorted(Path(sys.path[0]).glob("*.py")):
    runpy.run_path(str(file), run_name="imported")
"""


def test_every_benchmark_finds_what_it_imports_where_the_paths_of_pytest_are_not_set() -> None:
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", IMPORT], cwd=root, check=True, timeout=300)


# --- rivals and the best route, against brute force and closed forms


def test_the_rival_among_near_things_flies_the_cheapest_way_of_all() -> None:
    rng = np.random.default_rng(2)
    for shape in rng.integers(3, 15, size=(30, 2)).tolist():
        rate = rng.choice([1.0, 1.0, 20.0, np.inf], size=shape)
        ends = [tuple(rng.integers(0, shape).tolist()) for _ in range(2)]
        rate[ends[0]] = 1.0
        places = np.argwhere(np.ones(shape, dtype=bool))
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        mean = 0.5 * (rate.ravel()[:, None] + rate.ravel())
        joined = (apart < 1.5) & (apart > 0.0) & np.isfinite(mean)
        steps = np.where(joined, apart * np.where(joined, mean, 0.0), 0.0)
        start, end = (np.ravel_multi_index(place, shape) for place in ends)
        cheapest = dijkstra(steps, indices=start)[end]
        way = a_star(rate, *ends)
        index = np.ravel_multi_index(tuple(way.T), shape)
        assert len(way) if np.isfinite(cheapest) else not len(way)
        assert steps[index[:-1], index[1:]].sum() == pytest.approx(cheapest if len(way) else 0.0)
        assert not len(way) or (index[0], index[-1]) == (start, end)


def test_the_way_round_one_radar_in_a_level_world_is_tangent_arc_tangent() -> None:
    base = drawn_world.bundled("environment-2")
    floor_m, _ = base.task.band_amsl_m
    limits = replace(base.task.limits, north_m=(-5e3, 45e3), east_m=(-20e3, 20e3))
    radar = Radar(name="r", centre_nea_m=(20e3, 2_000.0, 0.0), range_m=8_000.0)
    world = replace(
        base,
        terrain=PeakTerrain(peaks=(), ground_amsl_m=0.0),
        task=replace(base.task, limits=limits, radars=(radar,)),
        start_nea_m=(0.0, 0.0, floor_m),
        targets_ne_m=((40e3, 0.0),),
    )
    round_m, far_m = math.sqrt(8_000.0**2 - floor_m**2), math.hypot(20e3, 2_000.0)
    angle = 2.0 * (math.acos(2_000.0 / far_m) - math.acos(round_m / far_m))
    wanted_m = 2.0 * math.sqrt(far_m**2 - round_m**2) + round_m * angle
    solver = optimum.Solver(world)
    routes = solver.candidates()
    assert len(routes) >= 2  # to the left and to the right
    cost, _ = solver.mended(solver.improved(solver.curve(routes[0][1], 20), (), 60), ())
    assert wanted_m <= cost / solver.grid.unit <= 1.001 * wanted_m


def test_an_optimum_is_feasible_costs_what_is_said_and_what_a_flight_cannot_beat() -> None:
    world = drawn_world.bundled("environment-1")
    cost, control_nea_m = optimum.optimum(world)
    curve = truth.sampled(control_nea_m, 10.0)
    assert truth.measure(curve, world.terrain, world.task).violations(world.task) == ()
    terms = route_terms(curve.points_nea_m, world.task)
    assert sum(terms.values()) == pytest.approx(cost, rel=1e-4)
    assert cost == pytest.approx(29.73376, rel=1e-4)  # by gradients that were written by hand
    np.testing.assert_allclose(control_nea_m[0], world.start_nea_m)
    np.testing.assert_allclose(control_nea_m[-1][:2], world.targets_ne_m[0])
    dear, cheap, lost = row(0, cost=33.0), row(1, cost=60.0, world="b"), row(2, arrived=False)
    known = {optimum.place_of(dear): 30.0, optimum.place_of(cheap): 60.0}
    assert optimum.ratios([dear, cheap, lost], known) == pytest.approx([1.1, 1.0])
    assert len(optimum.ratios([dear], {optimum.place_of(dear): None})) == 0
