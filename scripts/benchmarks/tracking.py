"""How the four simulated autopilots follow setpoints, beside what was measured on the real ones.

python scripts/benchmarks/tracking.py        the tables of docs/tracking.md
"""

import sys
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "vehicle_sim"))
import tracking_copter as tracking
import tracking_plane
import tracking_px4
import tracking_px4_fixed_wing


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    head = list(head)
    print("| " + " | ".join(head) + " |")
    print("|---" * len(head) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()


def copter() -> None:
    print("## ArduCopter (ardupilot.md 3)\n")
    print("Along: vehicle minus reference. Off path: rms / max. Metres.\n")
    head = ("m/s, lateral m/s2, lean deg", "setpoints", "Hz", "along", "sim", "off path", "sim")
    table(
        head,
        (
            (
                f"{row.speed_m_s:g}, {row.lateral_m_s2:g}, {row.lean_deg:g}",
                row.kind,
                f"{row.rate_hz:g}",
                f"{row.along_m:.1f}",
                f"{flown.along_m:.1f}",
                f"{row.off_rms_m:.2f} / {row.off_max_m:.2f}",
                f"{flown.off_rms_m:.2f} / {flown.off_max_m:.2f}",
            )
            for row, flown in ((row, tracking.fly(row)) for row in tracking.ROWS)
        ),
    )
    print(
        "A stream at 10 m/s that ends: seconds to a standstill, metres beyond its last setpoint.\n"
    )
    table(
        ("setpoints", "GUID_TIMEOUT", "still", "sim", "furthest", "sim", "ends at", "sim"),
        (
            (
                row.kind,
                f"{row.timeout_s:g} s",
                f"{row.still_s:.1f} s",
                f"{flown.still_s:.1f} s",
                f"{row.furthest_m:.1f}",
                f"{flown.furthest_m:.1f}",
                f"{row.ends_m:.1f}",
                f"{flown.ends_m:.1f}",
            )
            for row, flown in ((row, tracking.end_stream(row)) for row in tracking.STOPS)
        ),
    )
    print("Jumps of the target: peak speed, and seconds until within 1 m for good.\n")
    table(
        ("jump", "peak m/s", "sim", "within", "sim"),
        (
            (
                row.what,
                f"{row.peak_m_s:.1f}",
                f"{flown.peak_m_s:.1f}",
                f"{row.within_s:.1f} s",
                f"{flown.within_s:.1f} s",
            )
            for row, flown in ((row, tracking.jump(row)) for row in tracking.JUMPS)
        ),
    )


def plane() -> None:
    print("## ArduPlane (ardupilot.md 7)\n")
    print("A weaving route at 21 m/s; off path, rms / max, metres.\n")
    table(
        ("law", "lateral m/s2", "Hz", "real", "sim"),
        (
            (name, f"{lateral:g}", f"{hz:g}", f"{real[0]:.1f} / {real[1]:.1f}", _pair(flown))
            for name, law, lateral, hz, real in tracking_plane.TABLE
            for flown in (tracking_plane.off_path_m(law, lateral, hz=hz),)
        ),
    )


def _pair(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.1f} / {pair[1]:.1f}"


def fixed_wing() -> None:
    print("## PX4 fixed wing (px4.md 10)\n")
    print("A curve of least radius 100 m; off path, rms / max, metres.\n")
    table(
        ("setpoints", "real", "sim"),
        (
            (row.name, _pair((row.rms_m, row.most_m)), _pair((flown.rms_m, flown.most_m)))
            for row in tracking_px4_fixed_wing.ROWS
            for flown in (tracking_px4_fixed_wing.fly(row),)
        ),
    )


def main() -> None:
    copter()
    plane()
    print("## PX4 multicopter (px4.md 5)\n")
    print("A figure eight of least radius 50 m; along and across: mean or rms / max, metres.\n")
    print(tracking_px4.table() + "\n")
    fixed_wing()


if __name__ == "__main__":
    main()
