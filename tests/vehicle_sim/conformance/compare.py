"""All rows of a flight."""

import dataclasses
import itertools

from conformance import answers, lidar, states, streams, track
from conformance.flights import Flight
from conformance.log import Recording, Side
from conformance.rows import Comparison, Row

_ALL = (
    answers.ack_rows,
    answers.exchange_rows,
    answers.once_rows,
    states.state_rows,
    streams.stream_rows,
    track.track_rows,
    track.battery_rows,
    lidar.lidar_rows,
)


def compare(recording: Recording, flight: Flight, simulated: Side) -> list[Row]:
    """Every row that is compared, each disagreement with its reason if that is known."""
    comparison = Comparison.of(recording, flight, simulated)
    rows = itertools.chain.from_iterable(make(comparison) for make in _ALL)
    return [
        row if row.agrees else dataclasses.replace(row, reason=_reason(row, flight))
        for row in rows
        if not comparison.is_left_out(row.at_s)
    ]


def _reason(row: Row, flight: Flight) -> str | None:
    """Why this row does not agree; None if unexplained."""
    found = (reason.why for reason in flight.reasons if row.is_explained_by(reason))
    return next(found, None)
