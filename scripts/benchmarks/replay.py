"""Fly missions with faults drawn at random, and replay each: does it decide the same once more?

    scripts/bench replay [--flights 20] [--seed 1] [--json FILE]

A campaign by each autopilot and kind of vehicle, with two or three faults in each flight, a
companion that is killed and started again among them.  Each run folder is then replayed by
`companion replay`; bar: all identical.
"""

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from running import Found, least, main
from tapped import BIN, fly_campaign

from companion.campaign.report import read_campaign

_VEHICLES = ("ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane")


def campaign_text(flights: int, seed: int) -> str:
    """As many flights of each vehicle, in a short drawn world of its own."""
    each = max(round(flights / len(_VEHICLES)), 1)
    places = "".join(
        f'[[places]]\nfamily = "short-{vehicle.partition("-")[2]}"\nvehicle = "{vehicle}"\n'
        f"seed = {seed}\nfirst = {number}\n"
        for number, vehicle in enumerate(_VEHICLES)
    )
    faults = f'[[faults]]\nfamily = "combined"\nseed = {seed}\ncount = {each}\n'
    return f"limit_s = 900.0\n{places}{faults}"


def replayed(run: Path, *options: str) -> dict[str, Any]:
    """What `companion replay` says of a run folder."""
    report = run / "replay.json"
    command = [str(BIN / "companion"), "replay", str(run), "--json", str(report), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not report.exists():
        return {"identical": False, "difference": done.stderr.strip() or done.stdout.strip()}
    found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    report.unlink()
    return found


def once_more(flights: int = 20, seed: int = 1) -> Found:
    """Fly, replay, and say how many were identical."""
    identical = list[bool]()
    with tempfile.TemporaryDirectory() as folder:
        flown = fly_campaign(Path(folder), campaign_text(flights, seed), "--keep", "all")
        for row in read_campaign(flown).rows:
            same = replayed(flown / str(row.folder))
            identical.append(same["identical"])
            yield {
                "flight": row.key,
                "ended": row.ending or row.outcome,
                "identical": "yes" if same["identical"] else str(same["difference"])[:300],
                "times real time|.0f": same.get("flown_s", 0.0) / (same.get("took_s") or 1.0),
            }
    yield least("identical", sum(identical), len(identical))


if __name__ == "__main__":
    main(once_more)
