"""CSV: one row for each position that the vehicle has reported, for spreadsheets and the like."""

import csv
import math
from pathlib import Path

from companion.telemetry.export import shapes
from companion.telemetry.flight import Flight

COLUMNS = {
    "utc": "time of the log, ISO 8601",
    "t_s": "vehicle time: seconds since its boot",
    "boot": "how often the autopilot had rebooted",
    "latitude_deg": "WGS84",
    "longitude_deg": "WGS84",
    "altitude_amsl_m": "above mean sea level, as the autopilot has it",
    "above_home_m": "above home, as the autopilot has it",
    "north_m": "of the mission's origin, in its local frame",
    "east_m": "of the mission's origin, in its local frame",
    "north_m_s": "velocity towards true north",
    "east_m_s": "velocity towards true east",
    "up_m_s": "velocity upwards",
    "heading_deg": "where the nose points, clockwise from true north; empty: not known",
    "phase": "of the mission (docs/reference/mission-states.md)",
    "leg": "the subpath that was flown, counted from 1; 0: none yet",
}
"""The columns and what they mean (docs/export.md)."""


def write_csv(flight: Flight, file: Path) -> None:
    """Write the track.  Raises OSError if that cannot be done."""
    track, places, known = flight.track, flight.places_nea_m, flight.decided_at_positions()
    with file.open("w", encoding="utf-8", newline="") as out:
        rows = csv.writer(out)
        rows.writerow(COLUMNS)
        for k in range(len(track)):
            heading = float(track.heading_deg[k])
            rows.writerow(
                (
                    shapes.utc_text(track.time_us[k]),
                    f"{track.t_s[k]:.3f}",
                    track.boot[k],
                    f"{track.latitude_deg[k]:.7f}",
                    f"{track.longitude_deg[k]:.7f}",
                    f"{track.altitude_amsl_m[k]:.3f}",
                    f"{track.above_home_m[k]:.3f}",
                    f"{places[k, 0]:.2f}",
                    f"{places[k, 1]:.2f}",
                    f"{track.north_m_s[k]:.2f}",
                    f"{track.east_m_s[k]:.2f}",
                    f"{track.up_m_s[k]:.2f}",
                    "" if math.isnan(heading) else f"{heading:.2f}",
                    known[k].phase,
                    known[k].leg_number,
                )
            )
