"""The guess of unseen terrain: what it agrees with, what bounds it, and that no proof reads it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from companion.config import load_mission
from companion.geodesy import BoolArray, FloatArray
from companion.world import guess
from companion.world.columns import safe_surface
from companion.world.guess import guessed_m
from companion.world.known_map import KnownMap, empty_map

R = 20_000.0
CELL = 250.0
HERE = (15e3, 15e3)
BLANK = empty_map(CELL, (0.0, 40e3), (0.0, 40e3))
NORTH, EAST = BLANK.middles_m()


def peak(north: float, east: float, height: float, spread: float) -> FloatArray:
    """Eq. 1."""
    square = ((NORTH - north) ** 2 + (EAST - east) ** 2) / spread**2
    return np.asarray(height * np.exp(-square), dtype=np.float64)


def seen_where(terrain: FloatArray, where: BoolArray) -> KnownMap:
    return replace(BLANK, upper_m=np.where(where, terrain, np.inf), seen=where)


def disc(radius: float) -> BoolArray:
    return np.asarray(np.hypot(NORTH - HERE[0], EAST - HERE[1]) < radius)


def test_what_was_seen_is_believed_as_it_was_seen_and_a_sight_line_bounds_the_guess() -> None:
    """Of nothing nothing is guessed; a file for guidance is believed until a scan knows better."""
    terrain = peak(22e3, 22e3, 4e3, 5e3)
    known = seen_where(terrain, disc(9e3))
    believed = guessed_m(known, HERE, R)
    np.testing.assert_array_equal(believed[known.seen], terrain[known.seen])
    below = replace(known, upper_m=np.where(known.seen, known.upper_m, 900.0))
    assert believed[~known.seen].max() > 900.0
    assert guessed_m(below, HERE, R)[~known.seen].max() <= 900.0
    assert np.isneginf(guessed_m(BLANK, HERE, R)).all()
    told = replace(known, guess_m=np.where(NORTH + 0.0 * EAST < 20e3, 77.0, np.nan))
    expected = np.where(known.seen | np.isnan(told.guess_m), believed, 77.0)
    np.testing.assert_array_equal(guessed_m(told, HERE, R), expected)


def test_a_wall_goes_on_beyond_what_was_seen_of_it_from_wherever_it_is_looked_at() -> None:
    """One that is open from far away draws the vehicle from one end to the other for ever."""
    ridge = 5e3 * np.exp(-(((NORTH - 30e3) / 2e3) ** 2)) * np.ones_like(EAST)
    known = seen_where(ridge, np.asarray(np.hypot(NORTH - 30e3, EAST - 28e3) < 10e3))
    beyond = ~known.seen & (np.abs(NORTH - 30e3) < 300.0) & (np.abs(EAST - 38.5e3) < 300.0)
    for here in ((30e3, 30e3), (1e3, 1e3)):
        believed = guessed_m(known, here, R)[beyond]
        assert len(believed)
        assert believed.min() > 4e3


def test_it_is_the_kriging_of_another_implementation(monkeypatch: pytest.MonkeyPatch) -> None:
    """scipy's radial basis functions of a Gaussian, with the noise as smoothing."""
    monkeypatch.setattr(guess, "_SCALES", (4.0,))
    terrain = peak(20e3, 24e3, 4e3, 5e3) + peak(12e3, 20e3, 2e3, 4e3)
    known = seen_where(terrain, disc(8e3))
    size = 4  # cells, a twentieth of R
    seen = known.seen.reshape(40, size, 40, size).sum(axis=(1, 3))
    total = (terrain * known.seen).reshape(40, size, 40, size).sum(axis=(1, 3))
    height = total / np.maximum(seen, 1)
    chosen = np.argwhere(seen >= 0.5 * size * size)
    rise = height[tuple(chosen.T)]
    plain = np.quantile(rise, 0.02)
    monkeypatch.setattr(guess, "_rim", lambda seen, *_: np.argwhere(seen))  # not thinned
    ours = guessed_m(known, HERE, R)
    theirs = RBFInterpolator(
        (chosen + 0.5) * size * CELL,
        rise - plain,
        kernel="gaussian",
        epsilon=1.0 / (math.sqrt(2.0) * 0.2 * R),
        smoothing=0.02**2,
        degree=-1,
    )
    points = np.stack([np.broadcast_to(NORTH, (160, 160)), np.broadcast_to(EAST, (160, 160))], -1)
    unseen = ~known.seen & disc(14e3)
    expected = plain + theirs(points[unseen])
    np.testing.assert_allclose(ours[unseen], expected, atol=1e-6 * rise.max())


def test_no_proof_reads_a_guess() -> None:
    known = seen_where(peak(20e3, 20e3, 3e3, 4e3), disc(9e3))
    guessed = replace(known, guess_m=np.full((160, 160), -500.0))
    task, read = load_mission("environment-1").task, list[list[FloatArray]]()
    for each in (known, guessed):
        safe = safe_surface(each, centre_ne_m=HERE, reach_m=R, clearance_m=500.0, unknown_m=5e3)
        columns = task.surroundings(each, HERE, R).columns
        read.append([safe.vertex_m, columns.heights_m, columns.blocks_m, each.surveyed])
    for one, other in zip(*read, strict=True):
        np.testing.assert_array_equal(one, other)
    assert not guessed.is_known(39e3, 39e3)
