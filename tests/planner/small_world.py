"""A small world for the planner: hills of 300 to 900 m on 8 km x 8 km, a vehicle of 15 m/s."""

from planning import hills, limits

from companion.planner.settings import PlannerSettings, Task
from companion.world.known_map import empty_map
from companion.world.radars import Radar
from companion.world.simulated import true_map
from companion.world.zones import CircleZone, PolygonZone

SQUARE = ((5e3, 5e3), (5e3, 5.4e3), (5.4e3, 5.4e3), (5.4e3, 5e3))
TASK = Task(
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
        PolygonZone(name="s", vertices_ne_m=SQUARE),
    ),
)
TERRAIN = hills(
    (3_000.0, 2_600.0, 900.0, 500.0, 400.0),
    (4_300.0, 3_900.0, 650.0, 400.0, 700.0),
    (2_000.0, 6_000.0, 800.0, 500.0, 500.0),
    (6_000.0, 6_200.0, 500.0, 600.0, 300.0),
    ground_m=100.0,
)
BLANK = empty_map(TASK.cell_m, TASK.limits.north_m, TASK.limits.east_m)
"""Nothing is known."""
TRUTH = true_map(TERRAIN, BLANK)
"""Everything is."""
