"""Compiled or not, an inner loop says the same; and it needs no place for a cache on disk."""

import numba
import numpy as np
import pytest
from test_near_scene import drawn

from vehicle_sim import scene
from vehicle_sim.compiled import compiled


def test_plain_python_says_the_same_of_beams_and_distances() -> None:
    made = drawn(3)[0].scene()
    rng = np.random.default_rng(1)
    points = rng.uniform([-40.0, -40.0, 95.0], [40.0, 40.0, 125.0], (20, 3))
    ways = rng.normal(size=(15, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for kernel, values in (
        (scene._distances_m, (points, made._pieces)),
        (scene._shortened_m, (points[0], ways, np.full(15, np.inf), made._pieces, 40.0)),
    ):
        plain = kernel.__wrapped__  # type: ignore[attr-defined]
        assert kernel(*values) == pytest.approx(plain(*values), abs=1e-9)


def test_where_nothing_can_be_written_it_is_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    njit = numba.njit

    def without_disk(*functions: object, cache: bool = False) -> object:
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(*functions)

    monkeypatch.setattr(numba, "njit", without_disk)

    @compiled()
    def twice(x: float) -> float:
        return 2.0 * x

    assert twice(3.0) == 6.0
