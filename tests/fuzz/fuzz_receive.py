"""Coverage-guided fuzzing of the simulator's receive path: scripts/fuzz [SECONDS]."""

import sys
import time

import atheris

with atheris.instrument_imports(include=["vehicle_sim"]):
    from receive import Target

_SAY_EVERY = 10_000


def main() -> None:
    target, start_s = Target(), time.monotonic()
    count = 0

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
