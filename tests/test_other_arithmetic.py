"""Golden flights once more, in a process that computes otherwise: another processor's digits.

numba compiles for the plainest processor, OpenBLAS and numpy take the kernels of an old one and
glibc its functions without fused multiplication.  The other deciding tests, and what numba compiles
so, are run with `--all` alone: to compile it takes longer than all the rest.  The positions are
nudged too (tests/nudge.py).
"""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from numpy._core import _multiarray_umath as numpy_core
from programs import ROOT

from companion.planner import kernels

DECIDING = ("tests/replay/test_golden.py", "-k", "aside")
ALL_DECIDING = ("-n", "auto", "tests/replay", "tests/mission", "tests/planner")
LONGEST_S = 3_600.0


@pytest.fixture
def otherwise(tmp_path: Path) -> dict[str, str]:
    """The environment in which numba, numpy, OpenBLAS and glibc compute otherwise than here."""
    features = numpy_core.__cpu_features__
    optional = [name for name in numpy_core.__cpu_dispatch__ if features[name]]
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("PYTEST")},
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(tmp_path / "numba"),
        "NPY_DISABLE_CPU_FEATURES": " ".join(optional),
    }
    if platform.machine() == "x86_64":
        environment["OPENBLAS_CORETYPE"] = "Prescott"
        environment["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"
    return environment


@pytest.mark.skipif(platform.machine() != "x86_64", reason="of others only numba is told to")
def test_it_is_other_arithmetic_and_plans_of_the_two_are_told_apart(
    otherwise: dict[str, str],
) -> None:
    program = "from companion.planner import kernels; print(kernels.signature())"
    told = subprocess.check_output([sys.executable, "-c", program], env=otherwise, text=True)
    assert told.strip() not in ("", kernels.signature())


def test_decisions_are_the_same_in_other_arithmetic(
    otherwise: dict[str, str], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    deciding = ALL_DECIDING if request.config.getoption("--all") else DECIDING
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *deciding]
    done = subprocess.run(
        [*command, "--basetemp", str(tmp_path / "tests")],
        cwd=ROOT, env=otherwise, capture_output=True, text=True, timeout=LONGEST_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-8_000:]
