"""A MAVLink vehicle to test against: point-mass copter, autopilot, GPS and terrain radar."""

import sys


def main() -> None:
    """The command: Ctrl-C ends it without a traceback even while it is still being loaded."""
    try:
        from vehicle_sim.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(0)
