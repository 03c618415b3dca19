"""A small world for the planner: hills of 300 to 900 m on 8 km x 8 km, a vehicle of 15 m/s.

Every plan is asked for a micrometre aside.
"""

from collections.abc import Iterator

import planning
import pytest
from nudge import nudged_questions
from planning import hills, limits

from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import KnownMap, empty_map
from companion.world.radars import Radar
from companion.world.simulated_scan import true_map
from companion.world.terrain import PeakTerrain
from companion.world.zones import CircleZone, PolygonZone


@pytest.fixture(autouse=True)
def _aside(request: pytest.FixtureRequest, nudge: int) -> Iterator[None]:
    """What is planned, and whether anything is, hangs on no last digit."""
    with nudged_questions(request.module, nudge), nudged_questions(planning, nudge):
        yield


@pytest.fixture(scope="session")
def task() -> Task:
    return Task(
        limits=limits(),
        settings=PlannerSettings(
            scan_range_m=2_000.0,
            safety_distance_m=60.0,
            planning_time_s=2.0,
            scan_time_s=1.0,
            overlap_m=200.0,
            evaluations=600,
        ),
        radars=(Radar(name="r", centre_nea_m=(6_500.0, 3_300.0, 0.0), range_m=900.0),),
        zones=(
            CircleZone(name="c", north_m=2_300.0, east_m=4_300.0, radius_m=350.0),
            PolygonZone(
                name="s", vertices_ne_m=((5e3, 5e3), (5e3, 5.4e3), (5.4e3, 5.4e3), (5.4e3, 5e3))
            ),
        ),
    )


@pytest.fixture(scope="session")
def terrain() -> PeakTerrain:
    return hills(
        (3_000.0, 2_600.0, 900.0, 500.0, 400.0),
        (4_300.0, 3_900.0, 650.0, 400.0, 700.0),
        (2_000.0, 6_000.0, 800.0, 500.0, 500.0),
        (6_000.0, 6_200.0, 500.0, 600.0, 300.0),
        ground_m=100.0,
    )


@pytest.fixture(scope="session")
def blank(task: Task) -> KnownMap:
    return empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)


@pytest.fixture(scope="session")
def truth(terrain: PeakTerrain, blank: KnownMap) -> KnownMap:
    return true_map(terrain, blank)
