"""How fast logs are read, and in how much memory, beside pymavlink on a part of the same log.

python scripts/benchmarks/logs.py [--megabytes 250] [--only tlog|bin|ulg|rivals] [--json FILE]

The log is a recorded one over and over, with time going on; each reader runs in its own process.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import running

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "fuzz"), str(ROOT / "tests" / "recordings")]
from recordings import recording  # noqa: E402

PARTS = {
    "tlog": "px4-offboard-8mps.tlog",
    "bin": "arducopter-gps-loss.tlog",
    "ulg": "px4-offboard-short.ulg",
}
_READER = """
import json, sys, time
from pathlib import Path
began_s, began_cpu_s, opened_s, findings = time.perf_counter(), time.process_time(), None, []
{}
done_s = time.perf_counter()
status = Path("/proc/self/status").read_text()  # ru_maxrss would begin with the parent's
print(json.dumps({{
    "records": count, "open_s": (opened_s or began_s) - began_s,
    "read_s": done_s - (opened_s or began_s), "cpu_s": time.process_time() - began_cpu_s,
    "peak_mb": int(status.partition("VmHWM:")[2].split()[0]) / 1024, "findings": findings,
}}))
"""
_OPENS = """from companion.telemetry.logs import open_log
from companion.mavlink.frames import Receiver
receiver, log = Receiver(), open_log(Path(sys.argv[1]))
opened_s = time.perf_counter()
count = {}
findings = [str(each) for each in log.findings]"""
READS = _READER.format(_OPENS.format("sum(1 for _ in log.records())"))
DECODES = _READER.format(
    _OPENS.format("sum(len(receiver.feed(each.frame)) for each in log.records())")
)
PYMAVLINK = _READER.format("""from pymavlink import mavutil
mavutil.set_dialect("all")
log, count = mavutil.mavlink_connection(sys.argv[1]), 0
while log.recv_msg() is not None:
    count += 1""")


def tlog_of(path: Path, size: int) -> None:
    """The recorded .tlog again and again, each time a minute after the last."""
    content = recording(PARTS["tlog"]).read_bytes()
    stamps, at = [], 0
    while at < len(content):
        stamps.append(at)
        at += 8 + 12 + content[at + 9] + (13 if content[at + 10] & 1 else 0)
    first, last = (int.from_bytes(content[k : k + 8], "big") for k in (0, stamps[-1]))
    with path.open("wb") as file:
        turn = 0
        while file.tell() < size:
            part = bytearray(content)
            for k in stamps:
                time_us = int.from_bytes(part[k : k + 8], "big") + turn * (
                    last - first + 60_000_000
                )
                part[k : k + 8] = time_us.to_bytes(8, "big")
            file.write(part)
            turn += 1


def bin_of_size(path: Path, size: int) -> None:
    """The entries of a flight again and again; half of them are of kinds that nobody reads."""
    from log_files import bin_of, fill, fmt_entries

    flight = bin_of(recording(PARTS["bin"]))
    entries = flight[len(fmt_entries()) :]
    with path.open("wb") as file:
        file.write(flight)
        while file.tell() < size:
            file.write(fill(328_000_000) * (len(entries) // 200) + entries)


def ulg_of_size(path: Path, size: int) -> None:
    """The data of a flight again and again, after all that describes it."""
    content, at = recording(PARTS["ulg"]).read_bytes(), 16
    head, data = bytearray(content[:at]), bytearray()
    while at < len(content):
        end = at + 3 + int.from_bytes(content[at : at + 2], "little")
        kept = data if content[at + 2] == ord("D") else head
        kept += content[at:end]
        at = end
    with path.open("wb") as file:
        file.write(head)
        while file.tell() < size:
            file.write(data)


WRITERS = {"tlog": tlog_of, "bin": bin_of_size, "ulg": ulg_of_size}


def measured(program: str, path: Path) -> dict[str, Any]:
    """One reader in a process of its own."""
    environment = {**os.environ, "MAVLINK20": "1"}
    command = [sys.executable, "-c", program, str(path)]
    said = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    figures: dict[str, Any] = json.loads(said.stdout)
    size_mb = path.stat().st_size / 1e6
    total_s = figures["open_s"] + figures["read_s"]
    return figures | {
        "megabytes": size_mb,
        "per_s": figures["records"] / total_s,
        "per_cpu_s": figures["records"] / figures["cpu_s"],
        "mb_per_s": size_mb / total_s,
    }


def line(name: str, figures: dict[str, Any]) -> str:
    return (
        f"{name:34}{figures['megabytes']:6.0f} MB  {figures['records']:9,} messages  "
        f"{figures['per_s']:9,.0f} /s ({figures['per_cpu_s']:9,.0f} by CPU time)  "
        f"opened in {figures['open_s']:5.2f} s  peak {figures['peak_mb']:4.0f} MB"
    )


def main() -> int:
    only = {"choices": [*WRITERS, "rivals"]}
    wanted, console = running.begin(__doc__, megabytes=250.0, only=only)
    size, results = round(wanted.megabytes * 1e6), dict[str, Any]()
    with tempfile.TemporaryDirectory() as folder:
        for kind, write in WRITERS.items():
            if wanted.only not in (None, kind):
                continue
            path = Path(folder) / f"log.{kind}"
            write(path, size if kind == "tlog" else size // 5)
            results[kind] = measured(READS, path)
            print(line(f".{kind}, opened and read", results[kind]), flush=True)
            path.unlink()
        programs = {"and decoded (Receiver)": DECODES, "pymavlink": PYMAVLINK}
        if wanted.only not in (None, "rivals"):
            programs.clear()
        part = Path(folder) / "part.tlog"
        tlog_of(part, size // 25)
        for name, program in programs.items():
            results[name] = measured(program, part)
            print(line(f".tlog, {name}", results[name]), flush=True)
    bars = []
    if (tlog := results.get("tlog")) is not None:
        bars.append(running.least("messages of a .tlog a second", tlog["per_s"], 30_000.0))
        bars.append(running.most("memory for a .tlog, MB", tlog["peak_mb"], 300.0))
    return running.ended(console, wanted.json, results, bars)


if __name__ == "__main__":
    sys.exit(main())
