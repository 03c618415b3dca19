"""All rows of a flight: what a client can tell of two, each with its tolerance."""

import dataclasses

from conformance import lidar, rows, track
from conformance.flights import Flight, Recording, Side
from conformance.rows import Comparison, Row

_ALL = (
    rows.ack_rows,
    rows.exchange_rows,
    rows.once_rows,
    rows.state_rows,
    rows.stream_rows,
    track.track_rows,
    track.battery_rows,
    lidar.lidar_rows,
)


def compare(recording: Recording, flight: Flight, simulated: Side) -> list[Row]:
    """Every row that is compared, each disagreement with its reason if that is known."""
    comparison = Comparison(recording, flight, simulated)

    def explained(row: Row) -> Row:
        reasons = (each for each in flight.reasons if each.explains(row))
        return row if row.agrees else dataclasses.replace(row, reason=next(reasons, None))

    made = (row for make in _ALL for row in make(comparison))
    return [explained(row) for row in made if not comparison.is_left_out(row.at_s)]
