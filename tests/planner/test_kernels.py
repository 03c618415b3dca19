"""Compiled and plain code are one."""

import ast
from pathlib import Path

import numpy as np
import pytest
from planning import TASK, TRUTH, ask
from scenes import cube, random_scene

from companion import jit
from companion.planner import kernels
from companion.planner.plan import plan
from companion.planner.request import Planned


def test_compiled_costs_and_terms_are_those_of_plain_python() -> None:
    compiled = jit.compiled(kernels.costs)
    for seed in range(50):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        x = cube(rng, scene, 10)
        np.testing.assert_allclose(compiled(x, scene), kernels.costs(x, scene), rtol=1e-9)
        terms = scene.at.terms.copy()  # of the last one
        compiled(x, scene)
        np.testing.assert_allclose(scene.at.terms, terms, rtol=1e-9)


@pytest.mark.parametrize(
    ("start", "from_rest"), [((1e3, 1e3, 450.0), True), ((3_500.0, 3_100.0, 500.0), False)]
)
def test_plain_python_makes_the_same_plan(
    start: tuple[float, float, float], from_rest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = ask(TASK, TRUTH, start, from_rest=from_rest)
    fast = plan(request)
    monkeypatch.setattr(jit, "compiled", lambda function: function)
    slow = plan(request)
    assert isinstance(slow, Planned)
    assert isinstance(fast, Planned)
    assert fast.kernel == kernels.signature()
    np.testing.assert_allclose(
        fast.subpath.control_nea_m, slow.subpath.control_nea_m, rtol=1e-6, atol=1e-6
    )
    assert fast.cost == pytest.approx(slow.cost, rel=1e-9)
    assert (fast.rank, fast.tries, fast.evaluations) == (slow.rank, slow.tries, slow.evaluations)
    assert fast.certificate.proven
    for name in ("clearance_m", "keep_out_m", "dead_man_m", "turn_radius_m", "climb_angle_rad"):
        one, other = getattr(fast.certificate, name), getattr(slow.certificate, name)
        assert one == pytest.approx(other, rel=1e-6), name


# --- what the cache on disk depends on


@pytest.mark.parametrize("source", jit.SOURCES)
def test_a_constant_that_compiled_code_imports_comes_from_such_a_source_too(source: str) -> None:
    """numba freezes constants into the machine code."""
    known = {"companion." + each.replace("/", ".") for each in jit.SOURCES}
    file = Path(jit.__file__).parent / f"{source}.py"
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("companion"):
            constants = [each.name for each in node.names if each.name.lstrip("_").isupper()]
            assert not constants or node.module in known, constants
