"""Other people's programs and the simulator on real sockets, and where its vehicle truly is."""

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from programs import ROOT, Program

CLIENTS = Path(__file__).parent / "clients"
_TAIL_BYTES = 4096
HOME = (47.397742, 8.545594, 488.0)
METRES_PER_DEG = (111_200.0, 75_390.0)  # north and east, at HOME; good to 1 in 1000


def environments() -> Path:
    """Where scripts/setup-interop.sh has installed the programs."""
    folder = ROOT / os.environ.get("INTEROP_VENVS", ".venv-interop")
    if not folder.is_dir():
        pytest.fail(f"{folder} is missing: run scripts/test, or source scripts/setup-interop.sh")
    return folder


def plain(home: Path) -> dict[str, str]:
    """An environment in which nothing is set up, with a home of its own."""
    return {"PATH": os.defpath, "HOME": str(home), "TERM": "dumb", "PYTHONUNBUFFERED": "1"}


class Vehicle:
    """A running vehicle-sim, and where its vehicle really is."""

    def __init__(self, program: Program, truth: Path) -> None:
        self.program = program
        self._truth = truth

    def now(self) -> dict[str, Any]:
        """The newest line of truth."""
        return self.track()[-1]

    def track(self) -> list[dict[str, Any]]:
        """All that has been written of the truth so far."""
        return self._rows(0)

    def wait_until(
        self, reached: Callable[[dict[str, Any]], bool], within_s: float = 60.0
    ) -> dict[str, Any]:
        """Wait until the truth is so."""

        def newest() -> dict[str, Any] | None:
            rows = self._rows(-_TAIL_BYTES)
            return rows[-1] if rows and reached(rows[-1]) else None

        return self.program.until(newest, within_s)

    def _rows(self, begin: int) -> list[dict[str, Any]]:
        """Of the whole lines behind the first from there on; negative: from the file's end."""
        data = self._truth.read_bytes() if self._truth.exists() else b""
        lines = data[begin:].splitlines(keepends=True)[1:]  # a header, or a piece of a line
        return [json.loads(line) for line in lines if line.endswith(b"}\n")]


def height_m(row: dict[str, Any]) -> float:
    return float(row["altitude_amsl_m"]) - HOME[2]


def away_m(row: dict[str, Any], latitude_deg: float, longitude_deg: float) -> float:
    return math.hypot(
        (row["lat_deg"] - latitude_deg) * METRES_PER_DEG[0],
        (row["lon_deg"] - longitude_deg) * METRES_PER_DEG[1],
    )


def place(north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude and longitude so far from home, in degrees."""
    return HOME[0] + north_m / METRES_PER_DEG[0], HOME[1] + east_m / METRES_PER_DEG[1]
