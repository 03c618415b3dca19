"""A vehicle that can only go on at a great price stops, and leaves in another direction."""

from dataclasses import replace

from planning import fly, hills

from companion.config import load_mission
from companion.world.known_map import empty_map
from companion.world.radars import Radar
from companion.world.simulated_scan import true_map

# a saddle that nobody sees into before the vehicle is below it; behind it three radars
PEAKS = (
    (57_494, 111_871, 3401, 5629, 6480), (17_986, 33_469, 4055, 7787, 5282),
    (46_366, 34_200, 4834, 6915, 5162), (74_519, 76_139, 5243, 7448, 6585),
    (37_731, 43_310, 4308, 7562, 7481), (44_022, 57_375, 4157, 7879, 7769),
    (50_562, 27_615, 4120, 5017, 6985), (49_106, 50_650, 4188, 6043, 7778),
    (67_758, 17_475, 4847, 4041, 6988), (54_067, 35_179, 3833, 5113, 7740),
    (57_179, 48_237, 5780, 7608, 4905), (12_699, 29_850, 4341, 7784, 5396),
)  # fmt: skip
RADARS = (
    (59_621, 19_551, 10_342), (11_323, 43_169, 8147), (52_299, 41_155, 7968),
    (72_823, 57_966, 10_870), (54_595, 40_097, 9740), (59_105, 49_420, 6299),
    (68_201, 64_165, 9228), (44_838, 27_950, 7664), (46_054, 97_052, 9293),
    (70_727, 62_729, 8079),
)  # fmt: skip


def test_it_turns_round_rather_than_cross_a_radar() -> None:
    base = load_mission("environment-2").task
    radars = tuple(
        Radar(name=f"radar {north}", centre_nea_m=(north, east, 0.0), range_m=range_m)
        for north, east, range_m in RADARS
    )
    task = replace(base, radars=radars, zones=())
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    flight = fly(task, true_map(hills(*PEAKS), blank), (0.0, 0.0, 3030.0), (100e3, 100e3))
    assert flight.failure is None
    assert max(each.certificate.radar_m for each in flight.plans) < 1_000.0
    assert sum(flight.flown_m) < 1.4 * 145.2e3  # of the way when all is known
