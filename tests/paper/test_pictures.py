import numpy as np
import pytest

from companion.paper.compare import figures, table_1
from companion.paper.compare.missions import Run
from companion.paper.compare.pictures import compose_effect, compose_table
from companion.paper.compare.violations import Violations

CLEAN = Violations(
    clearance_m=0.0,
    radar_m=0.0,
    turn_m=0.0,
    climb_m=0.0,
    band_m=0.0,
)


def run(cost: float, aside_m: float = 0.0) -> Run:
    """A run along the diagonal, bent aside in the middle."""
    at = np.linspace(0.0, 1.0, 101)
    bend = aside_m * np.sin(np.pi * at)
    route = np.stack([1e5 * at + bend, 1e5 * at - bend, 3_500.0 + 0.0 * at], axis=-1)
    return Run(
        arrived=True,
        cost=cost,
        legs=8,
        length_m=150_000.0,
        route_nea_m=route,
        scans_nea_m=((0.0, 0.0, 3_500.0),),
        violations=CLEAN,
    )


@pytest.mark.parametrize("effect", [figures.figure_3(), figures.figure_4()], ids=lambda e: e.name)
def test_each_panel_shows_the_route_of_median_cost_and_says_where_most_runs_go(
    effect: figures.Effect,
) -> None:
    flown = [run(30.0), run(20.0), run(40.0, 4e4), run(1.0, 4e4), run(9.0, 4e4), run(5.0, 4e4)]
    found = figures.outcomes(effect, flown)
    figure = compose_effect(effect, found, "a remark")
    words = [text.get_text() for text in figure.texts]
    assert any(
        word.startswith(f"(a) {effect.settings[0].words}: {effect.across} (2 of 3")
        for word in words
    )
    assert any(
        word.startswith(f"(b) {effect.settings[1].words}: {effect.round} (3 of 3") for word in words
    )
    assert effect.paper.replace(" ", "") in "".join(words).replace(" ", "").replace("\n", "")
    assert "a remark" in "".join(words)
    for outcome, expected in zip(found, (30.0, 5.0), strict=True):
        assert outcome.shown.cost == expected
    below = [axes for axes in figure.axes if axes.get_label() == "below"]
    for axes, outcome in zip(below, found, strict=True):
        route_km = outcome.shown.route_nea_m / 1e3
        lines = [np.asarray(line.get_xydata()) for line in axes.lines]
        if effect.name == "figure-3":  # vertical profile
            along = np.hypot(*np.diff(route_km[:, :2], axis=0).T).cumsum()
            shown = np.stack([np.insert(along, 0, 0.0), route_km[:, 2]], axis=-1)
        else:  # from above
            shown = route_km[:, [1, 0]]
        assert any(line.shape == shown.shape and np.allclose(line, shown) for line in lines)


def test_the_picture_of_the_table_shows_every_run_and_every_mean() -> None:
    rng = np.random.default_rng(1)
    rows = table_1.rows([run(float(cost)) for cost in rng.uniform(30.0, 500.0, 16 * 5)])
    figure = compose_table(rows, ["a remark"])
    panels = [axes for axes in figure.axes if axes.get_label() == "row"]
    assert len(panels) == 4
    for axes, row in zip(panels, rows, strict=True):
        assert axes.get_yscale() == "log"
        lines = [np.asarray(line.get_ydata()).tolist() for line in axes.lines]
        for outcome in row.outcomes:
            assert outcome.costs in lines
            assert any(line == pytest.approx([outcome.mean()]) for line in lines if line)


def test_a_table_without_arrivals_can_be_drawn() -> None:
    lost = Run(
        arrived=False,
        cost=1.0,
        legs=60,
        length_m=0.0,
        route_nea_m=np.zeros((1, 3)),
        scans_nea_m=(),
        violations=CLEAN,
    )
    compose_table(table_1.rows([lost] * 16), [])
