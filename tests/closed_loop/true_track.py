"""What a vehicle truly did, beside what the judge of campaigns finds: its turns, slopes and band.

Neither shares code with the planner.  A track is what the simulator's truth tells, ten places a
second: north, east, altitude AMSL in metres (`_nea_m`).  Each rule has a margin: by how much it
was kept, with a tolerance of 5 % of the bound (for altitudes, of the safety distance); negative:
broken.
"""

import math

import numpy as np

from companion.geodesy import FloatArray
from companion.planner.settings import Task

TOLERANCE = 0.05
SECOND = 10  # places: turns and slopes are those of chords of so long
SLOWEST_M_S = 20.0
"""They are judged above this ground speed only, or half of V if that is less."""


def turns_and_slopes(track_nea_m: FloatArray, slowest_m_s: float) -> tuple[FloatArray, FloatArray]:
    """Turn radius and slope about each place.  (N, 3) -> radii_m (M,), slopes_rad (2, M).

    The radius of the circle through two consecutive chords of 1 s whose headings differ by D is
    their mean length / (2 sin(D / 2)).  Places with a chord no faster than that are left out.
    """
    chords = track_nea_m[SECOND:] - track_nea_m[:-SECOND]
    chords = np.stack([chords[:-SECOND], chords[SECOND:]])  # to each place, and from it
    flat = chords[..., 0] + 1j * chords[..., 1]
    fast = np.abs(flat).min(axis=0) > slowest_m_s
    flat = flat[:, fast]
    half_turn = 0.5 * np.abs(np.angle(flat[1] * flat[0].conj()))
    with np.errstate(divide="ignore"):  # straight on: endless
        radii_m = np.abs(flat).mean(axis=0) / (2.0 * np.sin(half_turn))
    return radii_m, np.arctan2(chords[:, fast, 2], np.abs(flat))


def margins(task: Task, track_nea_m: FloatArray) -> dict[str, float]:
    """By how much a track has kept each of these bounds of a task.  (N, 3)."""
    limits, up_m = task.limits, track_nea_m[:, 2]
    slack_m, high = TOLERANCE * task.settings.safety_distance_m, 1.0 + TOLERANCE
    radii_m, slopes = turns_and_slopes(track_nea_m, min(SLOWEST_M_S, 0.5 * limits.speed_m_s))
    least_m = (1.0 - TOLERANCE) * limits.turn_radius_m
    found = {
        "turn radius, m": np.min(radii_m, initial=math.inf) - least_m,
        "climb, deg": np.degrees(high * limits.climb_angle_rad - slopes.max(initial=0.0)),
        "dive, deg": np.degrees(high * limits.dive_angle_rad + slopes.min(initial=0.0)),
        "floor, m": up_m.min() - limits.floor_amsl_m + slack_m,
        "ceiling, m": limits.ceiling_amsl_m + slack_m - up_m.max(),
    }
    for radar in task.radars:
        away_m = np.linalg.norm(track_nea_m - radar.centre_nea_m, axis=-1)
        found[f"{radar.name}, m"] = away_m.min() - radar.range_m
    return {name: float(margin) for name, margin in found.items()}
