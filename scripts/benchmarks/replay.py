"""Fly random missions with faults, and replay each: does it decide the same once more?

    scripts/bench replay [--flights 20] [--seed 1] [--json FILE]

Real processes over UDP: both environments, both autopilots, up to three faults at random times.
Three in four are flown in lockstep, the others in real time, sped up, and ended by Ctrl-C; in half
of those the companion is killed once and started again.  Each run folder is then replayed by
`companion replay` with the compiled kernel (bar: all identical), and with numpy's, where plans may
differ in their last bits and decisions may not.
"""

import contextlib
import json
import re
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
import running
from rich.table import Table
from tapped import BIN, ENVIRONMENT, ROOT, end, free_port, start_companion, start_vehicle

_WORLDS = ("environment-1", "environment-2")
_AUTOPILOTS = ("ardupilot", "px4")
_ARDUPILOTS = re.compile(r"^(BATT_CAPACITY|GUID_TIMEOUT|WPNAV_ACCEL|PSC_JERK_XY) .*$", re.MULTILINE)
"""Parameters that PX4 does not have."""
_PX4S = """
MPC_XY_VEL_MAX = 200.0
MPC_XY_CRUISE = 160.0
MPC_TKO_SPEED = 25.0
MPC_ACC_HOR = 6.0
MPC_ACC_HOR_MAX = 10.0
MPC_Z_VEL_MAX_UP = 30.0
MPC_Z_VEL_MAX_DN = 30.0"""
"""So that it can fly these missions."""
_LOCKSTEP = ["--lockstep", "--duration", "1600"]  # some wait for a person who never comes
_SPEEDUP = 8.0
_REAL_TIME_S = 75.0
_PATIENCE_S = 300.0
_FAULTS = (
    "for {lasts} s: gps_off",
    "for {lasts} s: gps_noise 3 m",
    "for {lasts} s: gps_glitch 60 m north",
    "for {lasts} s: wind 12 m/s from 200 deg turbulence 2 m/s",
    "for {lasts} s: link_loss 20 %",
    "for {lasts} s: link_duplication 30 %",
    "for {lasts} s: link_corruption 10 %",
    "for {lasts} s: radar_off",
    "for {lasts} s: radar_drop 30 %",
    "for {lasts} s: setpoints_ignored",
    ": pilot",
    ": estimator_reset 8 m east",
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A flight to fly."""

    number: int
    world: str
    autopilot: str
    lockstep: bool
    killed: bool
    faults: tuple[str, ...]
    seed: int


def case_of(number: int, seed: int) -> Case:
    """One of the flights of a seed."""
    rng = np.random.default_rng([seed, number])
    faults = []
    for _ in range(int(rng.integers(1, 4))):
        form = str(rng.choice(_FAULTS)).format(lasts=int(rng.integers(3, 40)))
        gap = "" if form.startswith(":") else " "
        faults.append(f"at {int(rng.integers(20, 500))} s{gap}{form}")
    lockstep = number % 4 != 3
    return Case(
        number=number,
        world=_WORLDS[number // 2 % 2],
        autopilot=_AUTOPILOTS[number % 2] if lockstep else _AUTOPILOTS[number // 4 % 2],
        lockstep=lockstep,
        killed=not lockstep and number // 4 % 2 == 0,
        faults=tuple(faults),
        seed=int(rng.integers(1, 10_000)),
    )


def fly(case: Case, folder: Path) -> None:
    """Fly it to its end, or for a while in real time."""
    folder.mkdir(parents=True)
    shipped = ROOT / "companion" / "environments" / case.world
    for kind in ("world", "mission"):
        text = (shipped / f"{kind}.toml").read_text(encoding="utf-8")
        if case.autopilot == "px4":
            text = _ARDUPILOTS.sub("", text).replace('autopilot = "ardupilot"', 'autopilot = "px4"')
            text = text.replace("[vehicle.parameters]", f"[vehicle.parameters]\n{_PX4S}\n#")
        (folder / f"{kind}.toml").write_text(text, encoding="utf-8")
    (folder / "faults.txt").write_text("\n".join(case.faults) + "\n", encoding="utf-8")
    port, clock = free_port(), _LOCKSTEP if case.lockstep else ["--speedup", str(_SPEEDUP)]
    options = ["--faults", folder / "faults.txt", "--seed", case.seed, *clock]
    vehicle = start_vehicle(folder / "world.toml", port, *map(str, options))
    companion = _companion(case, folder, port)
    try:
        if case.lockstep:
            companion.wait(timeout=_PATIENCE_S)
            return
        if case.killed:
            _until_ended(companion, _REAL_TIME_S / 2.0)
            end(companion)
            companion = _companion(case, folder, port, "--resume")
        _until_ended(companion, _REAL_TIME_S / (2.0 if case.killed else 1.0))
        companion.send_signal(signal.SIGINT)
        companion.wait(timeout=_PATIENCE_S)
    finally:
        end(companion)
        end(vehicle)


def _until_ended(process: subprocess.Popen[bytes], patience_s: float) -> None:
    """Until it has ended, at most so long."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(patience_s)


def _companion(case: Case, folder: Path, port: int, *options: str) -> subprocess.Popen[bytes]:
    clock = ["--lockstep"] if case.lockstep else []
    seed, log = ["--seed", str(case.seed)], folder / "companion.log"
    return start_companion(
        folder / "mission.toml", port, folder / "run", *clock, *seed, *options, log=log
    )


def replayed(run: Path, *options: str) -> dict[str, Any]:
    """What `companion replay` says of a run folder."""
    report = run / "replay.json"
    command = [BIN / "companion", "replay", run, "--json", report, *options]
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
    options, console = running.begin(
        __doc__,
        flights=20,
        seed=1,
        only={"type": int, "nargs": "*"},
        keep=(Path, "where run folders stay"),
    )
    rows = []
    table = Table("flight", "world", "autopilot", "clock", "faults", "ended", "identical", "speed")
    table.add_column("numpy: decisions, plans that differ")
    with tempfile.TemporaryDirectory() as scratch:
        for number in options.only or range(options.flights):
            case = case_of(number, options.seed)
            folder = (options.keep or Path(scratch)) / f"{number}"
            fly(case, folder)
            found = replayed(folder / "run")
            numpy = replayed(folder / "run", "--no-numba")
            rows.append({"case": asdict(case), "replay": found, "numpy": numpy})
            console.print(*_cells(case, folder / "run", found, numpy), sep=" | ", highlight=False)
            table.add_row(*_cells(case, folder / "run", found, numpy))
    console.print(table)
    same = sum(row["replay"]["identical"] for row in rows)
    decisions = sum(row["numpy"]["difference"] is None for row in rows)
    console.print(f"{same} of {len(rows)} identical; with numpy {decisions} decide the same")
    running.store(options.json, rows)
    return 0 if same == decisions == len(rows) else 1


def _cells(case: Case, run: Path, found: dict[str, Any], numpy: dict[str, Any]) -> list[str]:
    journal = (run / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    ends = [entry for line in journal if (entry := json.loads(line)).get("kind") == "end"]
    clock = "lockstep" if case.lockstep else f"{_SPEEDUP:g}x" + (", killed" if case.killed else "")
    took_s = found.get("took_s") or 1.0
    return [
        str(case.number),
        case.world,
        case.autopilot,
        clock,
        "; ".join(case.faults),
        ends[-1]["outcome"] if ends else "-",
        "yes" if found["identical"] else str(found["difference"])[:300],
        f"{found.get('flown_s', 0.0):.0f} s, {found.get('flown_s', 0.0) / took_s:.0f}x",
        f"{'same' if numpy['difference'] is None else 'NOT'}, {len(numpy.get('plans_differ', ()))}",
    ]


if __name__ == "__main__":
    sys.exit(main())
