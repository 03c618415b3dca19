"""How the four simulated autopilots follow setpoints, beside what was measured on the real ones.

scripts/bench tracking       the tables of docs/lab/tracking.md
"""

import sys
from pathlib import Path
from typing import Any

from running import Found, main

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "vehicle_sim"))
import tracked


def both(real: Any, sim: Any, **columns: str) -> dict[str, str]:
    """The measured and the simulated value of each field: format after a colon, two by a slash."""
    cells = {}
    for heading, spec in columns.items():
        fields, _, form = spec.partition(":")
        form, _, unit = form.partition(" ")
        for whose, one in (("", real), (", sim", sim)):
            values = " / ".join(format(getattr(one, name), form) for name in fields.split("/"))
            cells[heading.replace("_", " ") + whose] = f"{values} {unit}".strip()
    return cells


def tracking() -> Found:
    """Every row of the documents, flown again."""
    yield "## ArduCopter (ardupilot.md 3)\n"
    yield "Along: vehicle minus reference. Off path: rms / max. Metres.\n"
    for row in tracked.WEAVES:
        settings = f"{row.speed_m_s:g}, {row.lateral_m_s2:g}, {row.lean_deg:g}"
        head = {"m/s, lateral m/s2, lean deg": settings, "setpoints": row.kind, "Hz|g": row.rate_hz}
        off = "off_rms_m/off_max_m:.2f"
        yield head | both(row, tracked.fly_weave(row), along="along_m:.1f", off_path=off)
    yield "\nA stream at 10 m/s that ends: time to a standstill, metres beyond its last setpoint.\n"
    for stop in tracked.STOPS:
        yield {"setpoints": stop.kind, "GUID_TIMEOUT": f"{stop.timeout_s:g} s"} | both(
            stop,
            tracked.end_stream(stop),
            still="still_s:.1f s",
            furthest="furthest_m:.1f",
            ends_at="ends_m:.1f",
        )
    yield "\n## ArduPlane (ardupilot.md 7)\n"
    yield "A weaving route at 21 m/s; off path, rms / max, metres.\n"
    for ahead in tracked.LOOK_AHEADS:
        head = {"ahead|g": ahead.ahead_m, "radius|g": ahead.radius_m}
        yield (
            head
            | {"lateral m/s2|g": ahead.lateral_m_s2}
            | both(ahead, tracked.fly_look_ahead(ahead), off_path="rms_m/most_m:.1f")
        )
    yield "\n## PX4 multicopter (px4.md 5)\n"
    yield "A figure eight of least radius 50 m; along and across: mean or rms / max, metres.\n"
    for row in tracked.EIGHTS:
        yield {"v|.0f": row.speed_m_s, "setpoint": row.kind, "Hz|.0f": row.rate_hz} | both(
            row.real,
            tracked.fly_eight(row),
            along="along_mean_m/along_max_m:.1f",
            across="cross_rms_m/cross_max_m:.2f",
            height="altitude_rms_m:.2f",
            speed="speed_m_s:.1f",
        )
    yield "\n## PX4 fixed wing (px4.md 10)\n"
    yield "A curve of least radius 100 m; off path, rms / max, metres.\n"
    for row in tracked.FIXED_WING:
        yield {"setpoints": row.name} | both(
            row, tracked.fly_fixed(row), off_path="rms_m/most_m:.1f"
        )


if __name__ == "__main__":
    main(tracking)
