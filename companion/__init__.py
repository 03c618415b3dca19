"""Online path planner for a drone's companion computer."""

import os
import sys

# Before numpy is loaded: on a busy computer threads of OpenBLAS wait for each other, and a plan
# that takes 0.1 s takes 1 s.  Matrices are small here: on an idle one they gain nothing.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    """The command: Ctrl-C ends it without a traceback even while it is still being loaded."""
    try:
        from companion.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)
