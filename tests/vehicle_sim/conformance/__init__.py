"""How like the real autopilots the simulated ones are: recorded flights played again, compared.

A recorded flight (.tlog) holds both directions.  The client's half is played into a simulation in
vehicle time, and what comes back is compared with the autopilot's half, row by row, each with a
tolerance that is stated.

flights.py   the recording, what it does not say of itself, and its client flown again
rows.py      the rows; track.py and lidar.py those of the flight and of a lidar
"""

from conformance import lidar, rows, track
from conformance.flights import Flight, Recording, Side
from conformance.rows import Comparison, Row

_OF_MESSAGES = (rows.ack_rows, rows.once_rows, rows.state_rows, rows.stream_rows)
_OF_FLIGHT = (track.track_rows, track.battery_rows, lidar.lidar_rows)
AGREED = {
    "arducopter-guided-global-stream-faults.tlog": (233, 235),
    "arducopter-guided-10mps.tlog": (223, 224),
    "arducopter-lidar.tlog": (214, 223),
    "arduplane-guided-reposition.tlog": (255, 256),
    "arducopter-gps-loss.tlog": (242, 245),
    "px4-fixedwing-offboard.tlog": (257, 268),
    "px4-offboard-short.tlog": (167, 173),
    "px4-offboard-8mps.tlog": (256, 261),
    "px4-gps-loss.tlog": (249, 258),
}
"""By recording: how many rows agreed when they were chosen, and how many there were.  Every third
one is of another autopilot."""


def compare(recording: Recording, flight: Flight, simulated: Side) -> list[Row]:
    """Every row that is compared, each disagreement with its reason if that is known."""
    comparison = Comparison(recording, flight, simulated)

    def explained(row: Row) -> Row:
        reasons = (each for each in flight.reasons if each.explains(row))
        return row if row.agrees else row._replace(reason=next(reasons, None))

    made = (row for make in (*_OF_MESSAGES, *_OF_FLIGHT) for row in make(comparison))
    return [explained(row) for row in made if not comparison.is_left_out(row.at_s)]
