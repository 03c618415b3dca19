import numpy as np
import pytest
from runs import run, table

from companion.paper.compare import figures, table_1
from companion.paper.compare.missions import Outcome
from companion.paper.compare.pictures import compose_effect, compose_table


@pytest.mark.parametrize("effect", [figures.figure_3(), figures.figure_4()], ids=lambda e: e.name)
def test_each_panel_shows_the_route_of_median_cost_and_says_where_most_runs_go(
    effect: figures.Effect,
) -> None:
    runs = [(run(30.0), run(20.0), run(40.0, 4e4)), (run(1.0, 4e4), run(9.0, 4e4), run(5.0, 4e4))]
    found = [Outcome(case=c, runs=each) for c, each in zip(effect.cases, runs, strict=True)]
    figure = compose_effect(effect, found, "a remark")
    words = [text.get_text() for text in figure.texts]
    assert any(
        word.startswith(f"(a) {effect.cases[0].label}: {effect.across} (2 of 3") for word in words
    )
    assert any(
        word.startswith(f"(b) {effect.cases[1].label}: {effect.round} (3 of 3") for word in words
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
    found = table(*(tuple(map(run, rng.uniform(30.0, 500.0, 5).tolist())) for _ in range(16)))
    figure = compose_table(found, ["a remark"])
    panels = [axes for axes in figure.axes if axes.get_label() == "row"]
    assert len(panels) == 4
    for axes, row in zip(panels, table_1.rows(found), strict=True):
        assert axes.get_yscale() == "log"
        lines = [np.asarray(line.get_ydata()).tolist() for line in axes.lines]
        for outcome in row:
            assert outcome.costs in lines
            assert any(line == pytest.approx([outcome.mean()]) for line in lines if line)


def test_a_table_without_arrivals_can_be_drawn() -> None:
    compose_table(table((run(1.0, arrived=False),)), [])
