"""How the four simulated autopilots follow setpoints, beside what was measured on the real ones.

python scripts/benchmarks/tracking.py        the tables of docs/results/tracking.md
"""

import math
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "vehicle_sim"))
import tracking_copter as tracking
import tracking_plane
import tracking_px4
import tracking_px4_fixed_wing


def table(text: str, head: str, rows: Iterable[Iterable[str]]) -> None:
    """Print a table of Markdown; the columns of its head are parted by |."""
    print(f"{text}\n\n| {head} |\n" + "|---" * (head.count("|") + 1) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()


def both(row: Any, flown: Any, *names: str) -> Iterator[str]:
    """The measured and the simulated value of each field: format after a colon, two by a slash."""
    for name in names:
        fields, _, form = name.partition(":")
        form, _, unit = form.partition(" ")
        for one in (row, flown):
            values = (format(getattr(one, field), form) for field in fields.split("/"))
            yield " / ".join(values).replace("nan", "-") + (f" {unit}" if unit else "")


def copter() -> None:
    table(
        "## ArduCopter (ardupilot.md 3)\n\n"
        "Along: vehicle minus reference. Off path: rms / max. Metres.",
        "m/s, lateral m/s2, lean deg | setpoints | Hz | along | sim | off path | sim",
        (
            (
                f"{row.speed_m_s:g}, {row.lateral_m_s2:g}, {row.lean_deg:g}",
                row.kind,
                f"{row.rate_hz:g}",
                *both(row, tracking.fly(row), "along_m:.1f", "off_rms_m/off_max_m:.2f"),
            )
            for row in tracking.ROWS
        ),
    )
    table(
        "A stream at 10 m/s that ends: seconds to a standstill, metres beyond its last setpoint.",
        "setpoints | GUID_TIMEOUT | still | sim | furthest | sim | ends at | sim",
        (
            (
                row.kind,
                f"{row.timeout_s:g} s",
                *both(row, tracking.end_stream(row), "still_s:.1f s", "furthest_m:.1f",
                      "ends_m:.1f"),
            )
            for row in tracking.STOPS
        ),
    )  # fmt: skip
    table(
        "Jumps of the target: peak speed, and seconds until within 1 m for good.",
        "jump | peak m/s | sim | within | sim",
        (
            (row.what, *both(row, tracking.jump(row), "peak_m_s:.1f", "within_s:.1f s"))
            for row in tracking.JUMPS
        ),
    )


def _setpoint(row: tracking_px4.Row) -> str:
    what = row.kind + (f", {row.lead_s} s ahead" if row.lead_s else "")
    return what + (f", carrot {row.carrot_m:.0f} m" if row.carrot_m else "")


def _flown(row: tracking_px4.Row) -> tracking_px4.Tracking:
    """With a carrot the target has no time: it is not told how far along it is."""
    flown = row.fly()
    return flown._replace(along_mean_m=math.nan, along_max_m=math.nan) if row.carrot_m else flown


def main() -> None:
    copter()
    table(
        "## ArduPlane (ardupilot.md 7)\n\nA weaving route at 21 m/s; off path, rms / max, metres.",
        "law | lateral m/s2 | Hz | real | sim",
        (
            (name, f"{lateral:g}", f"{hz:g}", "{:.1f} / {:.1f}".format(*real),
             "{:.1f} / {:.1f}".format(*tracking_plane.off_path_m(law, lateral, hz=hz)))
            for name, law, lateral, hz, real in tracking_plane.TABLE
        ),
    )  # fmt: skip
    table(
        "## PX4 multicopter (px4.md 5)\n\n"
        "A figure eight of least radius 50 m; along and across: mean or rms / max, metres.",
        "v | setpoint | Hz | along, real | sim | across, real | sim | height | sim | v | sim",
        (
            (f"{row.speed_m_s:.0f}", _setpoint(row), f"{row.rate_hz:.0f}",
             *both(row.real, _flown(row), "along_mean_m/along_max_m:.1f",
                   "cross_rms_m/cross_max_m:.2f", "altitude_rms_m:.2f", "speed_m_s:.1f"))
            for row in tracking_px4.TABLE
        ),
    )  # fmt: skip
    table(
        "## PX4 fixed wing (px4.md 10)\n\n"
        "A curve of least radius 100 m; off path, rms / max, metres.",
        "setpoints | real | sim",
        (
            (row.name, *both(row, tracking_px4_fixed_wing.fly(row), "rms_m/most_m:.1f"))
            for row in tracking_px4_fixed_wing.ROWS
        ),
    )


if __name__ == "__main__":
    main()
