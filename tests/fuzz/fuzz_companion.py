"""Coverage-guided fuzzing of the companion's receive path: scripts/fuzz companion [SECONDS]."""

import sys
import time

import atheris

with atheris.instrument_imports(include=["companion"]):
    from companion_receive import PERSONALITIES, Target

_SAY_EVERY = 10_000


def main() -> None:
    target = Target()
    for which in range(len(PERSONALITIES)):
        target.recording(which)
    start_s, count = time.monotonic(), 0

    def one(data: bytes) -> None:
        nonlocal count
        target.play(data)
        count += 1
        if count % _SAY_EVERY == 0:
            print(f"{count} inputs in {time.monotonic() - start_s:.0f} s: no finding", flush=True)

    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
