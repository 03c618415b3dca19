"""Coverage-guided fuzzing of a program's receive path: scripts/fuzz simulator|companion [SECONDS].

The first argument is the program; what follows is the fuzzer's own.
"""

import importlib
import sys
import time
from pathlib import Path

import atheris

_TARGETS = {
    "simulator": ("vehicle_sim", "receive"),
    "companion": ("companion", "companion_receive"),
}
_SAY_EVERY = 10_000


def main() -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "runtime"))
    package, module = _TARGETS[sys.argv.pop(1)]
    with atheris.instrument_imports(include=[package]):
        target = importlib.import_module(module).Target()
    for which in range(5):  # each personality is made before the first input is timed
        target.play(bytes([which]))
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
