from dataclasses import FrozenInstanceError

import pytest

from companion.path.limits import Limits


def test_limits_cannot_change_in_flight() -> None:
    limits = Limits(
        speed_m_s=15.0,
        acceleration_m_s2=3.0,
        climb_rate_m_s=4.0,
        turn_radius_m=100.0,
        climb_angle_rad=0.2,
        dive_angle_rad=0.2,
        floor_amsl_m=300.0,
        ceiling_amsl_m=800.0,
        north_m=(0.0, 1.0),
        east_m=(0.0, 1.0),
    )
    with pytest.raises(FrozenInstanceError):
        limits.speed_m_s = 30.0  # type: ignore[misc]
