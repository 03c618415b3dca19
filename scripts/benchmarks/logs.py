"""How fast logs are read, and in how much memory, beside pymavlink on a part of the same log.

    scripts/bench logs [--megabytes 250] [--only tlog|bin|ulg|rivals] [--json FILE]

The log is a recorded one over and over, with time going on; each reader runs in its own process.
"""

import multiprocessing
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from running import Found, OneOf, least, main, most

from companion.mavlink.frames import Receiver
from companion.telemetry.logs import open_log

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "fuzz"), str(ROOT / "tests" / "recordings")]
from recordings import recording  # noqa: E402

PARTS = {
    "tlog": "px4-offboard-8mps.tlog",
    "bin": "arducopter-gps-loss.tlog",
    "ulg": "px4-offboard-short.ulg",
}


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


def read(path: Path, how: str, told: Connection) -> None:
    """Read a log in this process: messages, seconds until it was open and in all, of the
    processor, and the most memory, MB."""
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    if how == "pymavlink":
        from pymavlink import mavutil  # noqa: TID251  # the rival

        mavutil.set_dialect("all")
        rival, count = mavutil.mavlink_connection(str(path)), 0
        opened_s = time.perf_counter()
        while rival.recv_msg() is not None:
            count += 1
    else:
        log, receiver = open_log(path), Receiver()
        opened_s = time.perf_counter()
        records = log.records()
        count = sum(1 if how == "read" else len(receiver.feed(each.frame)) for each in records)
    ended_s, cpu_s = time.perf_counter(), time.process_time() - began_cpu_s
    status = Path("/proc/self/status").read_text()  # ru_maxrss would begin with the parent's
    peak_mb = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    told.send((count, opened_s - began_s, ended_s - began_s, cpu_s, peak_mb))


def row_of(what: str, path: Path, how: str) -> dict[str, Any]:
    """One reader in a process of its own."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    reader = multiprocessing.get_context("spawn").Process(target=read, args=(path, how, theirs))
    reader.start()
    count, opened_s, whole_s, cpu_s, peak_mb = ours.recv()
    reader.join()
    return {
        "log": what,
        "MB|.0f": path.stat().st_size / 1e6,
        "messages|,": count,
        "a second|,.0f": count / whole_s,
        "by CPU time|,.0f": count / cpu_s,
        "opened in, s|.2f": opened_s,
        "peak, MB|.0f": peak_mb,
    }


def logs(megabytes: float = 250.0, only: str = OneOf("all", *WRITERS, "rivals")) -> Found:
    """The readers, and on a part of the .tlog pymavlink."""
    size, tlog = round(megabytes * 1e6), dict[str, Any]()
    with tempfile.TemporaryDirectory() as folder:
        for kind, write in WRITERS.items():
            if only in ("all", kind):
                path = Path(folder) / f"log.{kind}"
                write(path, size if kind == "tlog" else size // 5)
                row = row_of(f".{kind}, opened and read", path, "read")
                tlog = row if kind == "tlog" else tlog
                yield row
                path.unlink()
        part = Path(folder) / "part.tlog"
        tlog_of(part, size // 25)
        for how in ("decoded", "pymavlink") if only in ("all", "rivals") else ():
            yield row_of(f".tlog, {how}", part, how)
    if tlog:
        yield least("messages of a .tlog a second", tlog["a second|,.0f"], 30_000.0)
        yield most("memory for a .tlog, MB", tlog["peak, MB|.0f"], 300.0)


if __name__ == "__main__":
    main(logs)
