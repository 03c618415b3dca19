"""Fly missions with faults drawn at random, and replay each: does it decide the same once more?

    scripts/bench replay [--flights 20] [--seed 1] [--json FILE]

A campaign by each autopilot and kind of vehicle, with two or three faults in each flight, a
companion that is killed and started again among them.  Each run folder is then replayed by
`companion replay`; bar: all identical.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import running
from tapped import BIN, ENVIRONMENT, fly_campaign

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


def replayed(run: Path) -> dict[str, Any]:
    """What `companion replay` says of a run folder."""
    report = run / "replay.json"
    command = [BIN / "companion", "replay", run, "--json", report]
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        check=False,
    )
    if not report.exists():
        return {"identical": False, "difference": done.stderr.strip() or done.stdout.strip()}
    found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    report.unlink()
    return {**found, "code": done.returncode}


def main() -> int:
    """Fly, replay, and say how many were identical."""
    options, console = running.begin(__doc__, flights=20, seed=1)
    headings = "ended", "identical", "times real time"
    table, found = running.figures("Once more", "flight", *headings), list[dict[str, Any]]()
    with tempfile.TemporaryDirectory() as folder:
        text = campaign_text(options.flights, options.seed)
        flown = fly_campaign(Path(folder), text, "--keep", "all")
        for row in read_campaign(flown).rows:
            run = flown / str(row.folder)
            same = replayed(run)
            found.append({"key": row.key, "replay": same})
            table.add_row(
                row.key,
                row.ending or row.outcome,
                "yes" if same["identical"] else str(same["difference"])[:300],
                f"{same.get('flown_s', 0.0) / (same.get('took_s') or 1.0):.0f}",
            )
    console.print(table)
    bars = (
        running.least("identical", sum(each["replay"]["identical"] for each in found), len(found)),
    )
    return running.ended(console, options.json, found, bars)


if __name__ == "__main__":
    sys.exit(main())
