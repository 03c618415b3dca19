"""Damaged logs: any exception but a one-line InputError, time that falls, and hangs are findings.

python tests/fuzz/fuzz_logs.py [COUNT [SEED]]    (10,000, 0)

Without coverage guidance: every case is a recorded log with one to six kinds of damage, drawn from
the seed, so a finding can be repeated by its number.
"""

import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))
from log_files import bin_of, damaged, ulg_of
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.mavlink.frames import intact_end, number_of
from companion.telemetry.logs import open_log
from companion.telemetry.logs.ulog import TOPICS

_SAY_EVERY = 1000
SLOWEST_S = 2.0
"""A log that takes longer, by the time of this process alone, and a millisecond for each ten of its
bytes, is called a hang: honest ones take 3 microseconds a byte at most."""
_S_PER_BYTE = 1e-4


class Finding(AssertionError):
    """What a log did that none may do."""


def bases() -> dict[str, bytes]:
    """Whole logs of each kind, small, by suffix."""
    copter = recording("arducopter-gps-loss.tlog")
    px4 = recording("px4-offboard-short.tlog")
    return {
        ".tlog": copter.read_bytes()[:20_000],
        "-px4.tlog": px4.read_bytes()[:20_000],
        ".bin": bin_of(copter, most=900),
        ".ulg": ulg_of(recording("px4-offboard-short.ulg"), TOPICS, 20_000),
    }


def read(path: Path) -> str:
    """Read a log to its end; what became of it.  Finding if anything is as it must not be."""
    size, began_s = path.stat().st_size, time.process_time()
    try:
        log = open_log(path)
        before_us, count = 0, 0
        for record in log.records():
            if record.time_us < before_us:
                raise Finding(f"time falls from {before_us} to {record.time_us}")
            known = number_of(record.frame) in wire.mavlink_map
            if known and intact_end(record.frame, 0) != len(record.frame):
                raise Finding(f"a frame that is not intact: {record.frame.hex()}")
            before_us, count = record.time_us, count + 1
        if min(log.odd.values(), default=0) < 0 or "\n" in "".join(log.findings):
            raise Finding(f"findings that say nothing: {log.odd}")
        log.missing()
        outcome = f"{log.kind}, " + ("with findings" if log.findings else "without findings")
    except InputError as error:
        if "\n" in str(error):
            raise Finding(f"more than a line: {error}") from error
        outcome = "refused"
    took_s = time.process_time() - began_s
    if took_s > SLOWEST_S + size * _S_PER_BYTE:
        raise Finding(f"{took_s:.1f} s for {size} bytes")
    return outcome


def case(number: int, seed: int, logs: dict[str, bytes], folder: Path) -> tuple[Path, str]:
    """One damaged log: its path, and what became of it."""
    chance = random.Random(f"{seed} {number}")
    suffix = list(logs)[number % len(logs)]
    path = folder / f"case{suffix}"
    path.write_bytes(damaged(logs[suffix], chance))
    return path, read(path)


def main() -> None:
    """Any that is as none may be ends it, and says which it was."""
    count, seed = (*map(int, sys.argv[1:]), *(10_000, 0)[len(sys.argv) - 1 :])
    logs, outcomes = bases(), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        for number in range(count):
            try:
                outcomes[case(number, seed, logs, Path(name))[1]] += 1
            except Exception as error:
                error.add_note(f"case {number} of seed {seed}")
                raise
            if (number + 1) % _SAY_EVERY == 0:
                print(f"{number + 1} logs: {dict(outcomes)}, no finding", flush=True)


if __name__ == "__main__":
    main()
