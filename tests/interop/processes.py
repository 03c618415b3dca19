"""Other people's programs and the simulator on real sockets, and where its vehicle truly is."""

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from programs import ROOT, Program

_TAIL_BYTES = 4096
HOME = (47.397742, 8.545594, 488.0)
METRES_PER_DEG = (111_200.0, 75_390.0)  # north and east, at HOME; good to 1 in 1000
Row = dict[str, Any]


def python_of(environment: str) -> Path:
    """The interpreter of a program that scripts/setup-interop.sh has installed."""
    folder = ROOT / os.environ.get("INTEROP_VENVS", ".venv-interop") / environment
    if not folder.is_dir():
        pytest.fail(f"{folder} is missing: . scripts/setup-interop.sh --all, or run scripts/test")
    return folder / "bin" / "python"


class Vehicle:
    """A running vehicle-sim, and where its vehicle really is."""

    def __init__(self, program: Program, truth: Path) -> None:
        self._program, self._truth = program, truth

    def track(self, begin: int = 0) -> list[Row]:
        """The truth so far, from a byte on; negative: from the file's end."""
        data = self._truth.read_bytes() if self._truth.exists() else b""
        lines = data[begin:].splitlines(keepends=True)[1:]  # a header, or a piece of a line
        return [json.loads(line) for line in lines if line.endswith(b"}\n")]

    def wait_until(self, reached: Callable[[Row], bool], within_s: float = 60.0) -> Row:
        """Wait until the truth is so."""

        def newest() -> Row | None:
            rows = self.track(-_TAIL_BYTES)
            return rows[-1] if rows and reached(rows[-1]) else None

        return self._program.until(newest, within_s)


def height_m(row: Row) -> float:
    return float(row["altitude_amsl_m"]) - HOME[2]


def away_m(row: Row, latitude_deg: float, longitude_deg: float) -> float:
    return math.hypot(
        (row["lat_deg"] - latitude_deg) * METRES_PER_DEG[0],
        (row["lon_deg"] - longitude_deg) * METRES_PER_DEG[1],
    )


def place(north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude and longitude so far from home, in degrees."""
    return HOME[0] + north_m / METRES_PER_DEG[0], HOME[1] + east_m / METRES_PER_DEG[1]
