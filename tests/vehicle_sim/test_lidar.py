"""The lidar, its driver, ArduPilot's proximity sectors and rangefinder, and who touches a tree."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from harness import Flown, Link
from pymavlink.dialects.v20 import all as mavlink
from test_near_scene import GROUND_M, world

from vehicle_sim.errors import InputError
from vehicle_sim.simulation import Simulation
from vehicle_sim.wire.frames import Packer
from vehicle_sim.wire.proximity import BY_MAVLINK, RPLIDAR, Proximity

NOT_THERE, NOT_KNOWN = 1601, 65535
POST = {"north_m": 10.0, "east_m": 0.0, "radius_m": 1.0, "height_m": 50.0}
WALL = {"points_ne_m": [[-60.0, 8.0], [60.0, 8.0]], "thickness_m": 1.0, "height_m": 50.0}


class Bench(Link):
    """A vehicle that is held where the test wants it, and what it says on each link."""

    def __init__(
        self,
        *,
        lidar: dict[str, Any] | None = None,
        autopilot: str = "ardupilot",
        **fields: Any,
    ) -> None:
        table = {"range_m": 16.0} | (lidar or {})
        super().__init__("copter", autopilot, (47.0, 8.0, GROUND_M), lidar=table, **fields)
        self.source = (1, 195)
        self.hold_m = 5.0
        self.turn_rad = (0.0, 0.0, 0.0)
        pilot = self.simulation._controller.autopilot
        flies = pilot.step

        def held(*arguments: Any) -> Any:
            replies, vehicle = flies(*arguments), self.simulation.vehicle
            vehicle.altitude_amsl_m = GROUND_M + self.hold_m
            vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad = self.turn_rad
            return replies

        pilot.step = held  # type: ignore[method-assign]

    @property
    def said(self) -> list[tuple[float, int, Any]]:
        """Time in seconds, link, message."""
        return [(each.at_s, each.link, each.message) for each in self.heard]

    def ask(self, number: int, rate_hz: float) -> None:
        self.send(
            mavlink.MAVLink_command_long_message(1, 1, 511, 0, number, 1e6 / rate_hz, *[0] * 5)
        )

    def fly(self, seconds: float) -> "Bench":
        self.run(seconds)
        return self

    def of(self, kind: str, component: int | None = None, link: int = 0) -> list[Any]:
        return [
            each.message
            for each in self.all(kind, link=link)
            if component in (None, each.source[1])
        ]

    def maps(self) -> list[Any]:
        return self.of("OBSTACLE_DISTANCE", 196)

    def frames(self) -> bytes:
        return b"".join(each.frame for each in self.heard)


# --- the driver -----------------------------------------------------------------------------------


def test_a_post_is_in_the_sector_where_mavlink_puts_it() -> None:
    for bearing_deg in (0.0, 30.0, 90.0, 200.0, 357.0):
        bearing = math.radians(bearing_deg)
        place = {"north_m": 10 * math.cos(bearing), "east_m": 10 * math.sin(bearing)}
        near = {"trees": [POST | place | {"radius_m": 0.2}]}
        bench = Bench(lidar={"step_deg": 0.5}, **near).fly(1.0)
        told = bench.maps()[-1]
        met = [k for k, cm in enumerate(told.distances) if cm < NOT_THERE]
        middles = [told.angle_offset + k * told.increment_f for k in met]
        assert min(abs(math.remainder(m - bearing_deg, 360.0)) for m in middles) <= 2.5
        assert all(abs(math.remainder(m - bearing_deg, 360.0)) <= 5.0 for m in middles)
        assert min(told.distances) == pytest.approx(980, abs=1)


def test_what_the_driver_says() -> None:
    bench = Bench(trees=[POST], lidar={"latency_s": 0.06}).fly(5.0)
    maps = bench.maps()
    assert len(maps) == pytest.approx(50, abs=2)
    for each in maps[5:]:
        assert (each.frame, each.increment, each.increment_f, each.angle_offset) == (12, 5, 5, 0)
        assert (each.min_distance, each.max_distance) == (20, 1600)
        assert {k for k, cm in enumerate(each.distances) if cm != NOT_THERE} == {0, 1, 71}
    beats = bench.of("HEARTBEAT", 196)
    assert len(beats) == pytest.approx(5, abs=1)
    assert {(m.type, m.autopilot) for m in beats} == {(18, 8)}
    ages = [t - m.time_usec * 1e-6 for t, _, m in bench.said if m.get_type() == maps[0].get_type()]
    assert min(ages[5:]) >= 0.059
    assert max(ages) <= 0.08


def test_outside_the_field_of_view_nothing_is_known_and_nearer_than_the_least_either() -> None:
    near = POST | {"north_m": 1.3}
    told = Bench(trees=[near], lidar={"width_deg": 90.0, "min_m": 0.5}).fly(1.0).maps()[-1]
    assert told.angle_offset == -42.5
    assert told.distances[18:] == [NOT_KNOWN] * 54
    assert NOT_KNOWN in told.distances[:18]  # the post, too near
    told = Bench(trees=[near], lidar={"min_m": 0.1}).fly(1.0).maps()[-1]
    assert min(told.distances) == 30


def test_a_leaning_vehicle_sees_the_ground() -> None:
    bench = Bench()
    bench.turn_rad = (0.0, math.radians(-30.0), math.radians(90.0))
    told = bench.fly(1.0).maps()[-1]
    assert told.distances[0] == pytest.approx((5.15 / math.sin(math.radians(30))) * 100, abs=3)
    assert told.distances[36] == NOT_THERE


def test_noise_and_lost_echoes_have_the_size_that_the_world_says() -> None:
    lidar = {"noise_m": 0.1, "lost_share": 0.2, "kind": "sectors", "step_deg": 5.0}
    maps = Bench(trees=[POST | {"radius_m": 3.0}], lidar=lidar).fly(60.0).maps()[5:]
    ahead = np.array([m.distances[0] for m in maps])
    assert np.mean(ahead == NOT_THERE) == pytest.approx(0.2, abs=0.06)
    met = ahead[ahead != NOT_THERE] * 0.01
    assert met.mean() == pytest.approx(7.0, abs=0.02)
    assert met.std() == pytest.approx(0.1, abs=0.02)


def test_a_mounting_that_is_known_changes_nothing() -> None:
    turned = Bench(trees=[POST], lidar={"yaw_deg": 90.0, "step_deg": 5.0}).fly(1.0).maps()[-1]
    straight = Bench(trees=[POST], lidar={"step_deg": 5.0}).fly(1.0).maps()[-1]
    assert turned.distances == straight.distances


def test_the_same_seed_says_the_same_and_another_does_not() -> None:
    lidar = {"noise_m": 0.1, "lost_share": 0.05}

    def said(seed: int) -> bytes:
        faults = "at 1 s: lidar_dust 5 %\nat 1 s: lidar_clock 0 ms jumping 20 ms"
        return Bench(trees=[POST], lidar=lidar, seed=seed, faults=faults).fly(4.0).frames()

    assert said(3) == said(3) != said(4)


def test_every_link_hears_the_driver_and_what_a_client_says_goes_to_the_others() -> None:
    bench = Bench(trees=[POST], links=2)
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), link=1)
    mine = mavlink.MAVLink_obstacle_distance_message(1, 0, [500] * 72, 5, 30, 1000, 5.0, 0.0, 12)
    bench.send(mine)
    bench.fly(1.0)
    assert len(bench.of("OBSTACLE_DISTANCE", 196, 0)) == len(bench.of("OBSTACLE_DISTANCE", 196, 1))
    (forwarded,) = bench.of("OBSTACLE_DISTANCE", 195, 1)
    assert forwarded.distances == [500] * 72
    assert bench.of("OBSTACLE_DISTANCE", 195, 0) == []


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_driver_does_not_mind_the_autopilot(autopilot: str) -> None:
    assert min(Bench(trees=[POST], autopilot=autopilot).fly(1.0).maps()[-1].distances) == 900


# --- faults ---------------------------------------------------------------------------------------


def faulty(line: str, seconds: float = 3.0, **fields: Any) -> Bench:
    at_once = {"kind": "sectors"}  # which takes a tenth of the time of beam after beam
    faults = f"at 1 s: {line}"
    return Bench(trees=[POST], lidar=at_once, faults=faults, **fields).fly(1.0 + seconds)


def after(bench: Bench, kind: str, from_s: float = 1.15) -> list[Any]:
    return [
        m
        for t, _, m in bench.said
        if t > from_s and m.get_type() == kind and m.get_header().srcComponent == 196
    ]


def test_a_dead_sensor_leaves_its_driver_alive_and_a_silent_driver_says_nothing() -> None:
    dead = faulty("lidar_dead")
    assert after(dead, "OBSTACLE_DISTANCE") == []
    assert len(after(dead, "HEARTBEAT")) == 3
    silent = faulty("lidar_off")
    assert after(silent, "OBSTACLE_DISTANCE") == after(silent, "HEARTBEAT") == []
    lost = faulty("lidar_loss 100 %")
    assert after(lost, "OBSTACLE_DISTANCE") == []


def test_a_blind_lidar_says_that_nothing_is_there() -> None:
    assert set(after(faulty("lidar_blind"), "OBSTACLE_DISTANCE")[-1].distances) == {NOT_THERE}


def test_dust_returns_near_and_never_behind_what_is_there() -> None:
    maps = after(faulty("lidar_dust 10 %", 10.0), "OBSTACLE_DISTANCE")
    told = np.array([m.distances for m in maps])
    assert 0.05 < np.mean(told < 320) < 0.25
    assert told[:, 36].min() < 320  # behind: nothing is there


def test_a_stuck_lidar_repeats_itself_with_new_stamps() -> None:
    bench = Bench(trees=[POST], faults="at 1 s: lidar_stuck").fly(1.2)
    bench.turn_rad = (0.0, 0.0, 2.0)
    bench.fly(2.0)
    maps = after(bench, "OBSTACLE_DISTANCE")
    assert len({tuple(m.distances) for m in maps}) == 1
    assert len({m.time_usec for m in maps}) == len(maps)


def test_a_lidar_mounted_backwards_sees_behind_what_is_ahead() -> None:
    told = after(faulty("lidar_turned 180 deg"), "OBSTACLE_DISTANCE")[-1].distances
    assert told.index(min(told)) in range(34, 39)


def test_stamps_of_another_clock_and_stamps_that_jump() -> None:
    usual = [m.time_usec for m in after(faulty("lidar_frame 12"), "OBSTACLE_DISTANCE")]
    ahead = [m.time_usec for m in after(faulty("lidar_clock 5000 ms"), "OBSTACLE_DISTANCE")]
    assert [b - a for a, b in zip(usual, ahead, strict=True)] == [5_000_000] * len(usual)
    jumps = faulty("lidar_clock 0 ms jumping 300 ms")
    steps = np.diff([m.time_usec for m in after(jumps, "OBSTACLE_DISTANCE")])
    assert steps.min() < 0 < steps.max()


def test_a_flood_a_wrong_frame_and_junk() -> None:
    assert len(after(faulty("lidar_rate 200 Hz", 2.0), "OBSTACLE_DISTANCE", 2.0)) == pytest.approx(
        200, abs=4
    )
    frames = {m.frame for m in after(faulty("lidar_frame 8"), "OBSTACLE_DISTANCE")}
    assert frames == {8}
    maps = after(faulty("lidar_junk 30 %", 5.0), "OBSTACLE_DISTANCE")
    assert {0, NOT_KNOWN, NOT_KNOWN - 1, 1602} <= {cm for m in maps for cm in m.distances}
    assert any(math.isnan(m.increment_f) for m in maps)
    assert any(math.isnan(m.angle_offset) for m in maps)


def test_a_mirror_sends_a_companion_its_own_messages() -> None:
    bench = Bench(trees=[POST], faults="at 1 s: lidar_mirror")
    bench.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    bench.fly(1.5)
    bench.heard.clear()
    mine = mavlink.MAVLink_obstacle_distance_message(1, 0, [777] * 72, 5, 30, 1000, 5.0, 0.0, 12)
    bench.send(mine)
    bench.fly(1.0)
    said = bench.of("OBSTACLE_DISTANCE", 195)
    assert said[0].distances == [777] * 72
    assert [m.distances for m in said[1:]] == [m.distances for m in bench.maps()]


# --- ArduPilot's eight sectors --------------------------------------------------------------------

ON_AUTOPILOT = {"output": "autopilot"}


def sectors(bench: Bench) -> list[tuple[float, Any]]:
    return [
        (t, m)
        for t, _, m in bench.said
        if m.get_type() == "DISTANCE_SENSOR" and m.id in range(10, 18)
    ]


def healthy(bench: Bench) -> list[bool]:
    return [bool(m.onboard_control_sensors_health & 0x4000000) for m in bench.of("SYS_STATUS")]


def autopilot_bench(**fields: Any) -> Bench:
    bench = Bench(lidar=ON_AUTOPILOT, **fields).fly(0.2)
    bench.ask(132, 10)
    bench.ask(1, 2)
    return bench


def test_each_sector_says_the_nearest_echo_of_its_45_degrees_and_the_time_of_sending() -> None:
    bench = autopilot_bench(trees=[POST], walls=[WALL]).fly(5.0)
    assert bench.of("OBSTACLE_DISTANCE") == []
    now = {m.orientation: m for _, m in sectors(bench)[-8:]}
    assert now[0].current_distance == pytest.approx(900, abs=5)
    assert now[2].current_distance == pytest.approx(750, abs=2)
    assert now[1].current_distance == pytest.approx(750 / math.sin(math.radians(67.5)), abs=25)
    for t, m in sectors(bench):
        assert (m.id, m.type, m.min_distance, m.max_distance) == (10 + m.orientation, 0, 20, 1600)
        assert m.time_boot_ms == pytest.approx(t * 1e3, abs=1)
    assert set(now) <= {0, 1, 2, 3, 7}  # the others have never had an echo on this link


def test_nothing_in_reach_and_a_dead_lidar_are_both_silent_and_only_the_health_bit_differs() -> (
    None
):
    empty = autopilot_bench().fly(3.0)
    assert sectors(empty) == []
    assert healthy(empty)[-1]
    dead = autopilot_bench(walls=[WALL], faults="at 3 s: lidar_dead").fly(5.0)
    assert sectors(dead)[-1][0] == pytest.approx(3.2, abs=0.15)
    assert healthy(dead)[1]
    assert not healthy(dead)[-1]


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", range(4))
def test_an_echo_is_repeated_for_1_to_1_75_s_after_the_last_with_new_stamps(seed: int) -> None:
    # a high post in the sector before it: behind an empty one it would be wiped at once
    high = {"north_m": 6.0, "east_m": -6.0, "radius_m": 1.0, "height_m": 500.0}
    bench = autopilot_bench(trees=[POST, high], seed=seed).fly(4.0)
    start_s = bench.simulation.now_us * 1e-6
    bench.hold_m = 60.0  # above the post
    bench.fly(3.0)
    ahead = [(t, m) for t, m in sectors(bench) if m.orientation == 0]
    last_s = max(t for t, m in ahead if m.current_distance < 1600)
    assert {m.current_distance for t, m in ahead if t > last_s} == {1600}
    assert 0.9 <= last_s - start_s <= 1.9


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", range(4))
def test_a_sector_with_a_post_is_called_empty_for_up_to_0_9_s_in_a_row(seed: int) -> None:
    bench = autopilot_bench(trees=[POST, POST | {"north_m": -10.0}], seed=seed).fly(10.0)
    ahead = [m.current_distance for _, m in sectors(bench) if m.orientation == 0][5:]
    full = "".join("x" if cm == 1600 else "." for cm in ahead)
    rows = [len(row) for row in full.split(".") if row]
    assert rows
    assert 3 <= max(rows) <= 9
    assert 0.03 < full.count("x") / len(full) < 0.3  # about an eighth of each turn


def test_330_is_denied() -> None:
    bench = autopilot_bench()
    bench.ask(330, 5)
    bench.fly(0.1)
    assert [m.result for m in bench.of("COMMAND_ACK") if m.command == 511][-1] == 2


def told(distances: dict[int, int], **fields: Any) -> Any:
    values = {"time_usec": 1, "sensor_type": 0, "increment": 5, "min_distance": 30}
    values |= {"max_distance": 2000, "increment_f": 5.0, "angle_offset": 0.0, "frame": 12}
    cm = [distances.get(k, NOT_KNOWN) for k in range(72)]
    return mavlink.MAVLink_obstacle_distance_message(**(values | {"distances": cm} | fields))


def read(said: Any) -> Any:
    """As pymavlink reads it out of its frame."""
    return mavlink.MAVLink(None).decode(bytearray(Packer(1, 1).frame(said)))


def heard(message: Any) -> dict[int, int]:
    proximity = Proximity(BY_MAVLINK)
    proximity.on_obstacle_distance(message, 1_000_000)
    said = map(read, proximity.messages(1_100_000))
    return {m.orientation: m.current_distance for m in said}


def test_with_angle_offset_0_the_wall_straight_ahead_is_lost() -> None:
    assert heard(told({0: 500, 18: 1000, 68: 1633}))[0] in (1632, 1633)
    assert heard(told({0: 500}, angle_offset=22.5)) == {1: 500}
    assert heard(told({67: 500, 63: 1633}, angle_offset=22.5))[0] == 500


def test_what_says_nothing_is_not_read_and_precision_is_a_centimetre_cut_off() -> None:
    assert heard(told({9: 0, 18: NOT_KNOWN, 27: 20, 36: 2001})) == {}
    proximity = Proximity(BY_MAVLINK)
    proximity.on_obstacle_distance(told({18: 583}), 0)
    (message,) = map(read, proximity.messages(100_000))
    assert message.min_distance == 29
    assert message.current_distance in (582, 583)
    assert not proximity.messages(600_000)  # lost after half a second
    assert not Proximity(RPLIDAR).messages(0)
    assert heard(told({18: 583}, increment_f=math.nan)) == {}


def test_with_prx1_type_2_the_driver_comes_back_as_eight_sectors_of_component_1() -> None:
    bench = Bench(walls=[WALL], parameters={"PRX1_TYPE": 2.0}).fly(0.5)
    bench.ask(132, 10)
    bench.fly(2.0)
    last = {m.orientation: m.current_distance for _, m in sectors(bench)[-8:]}
    assert last[2] == pytest.approx(750, abs=3)
    assert {m.get_header().srcComponent for _, m in sectors(bench)} == {1}
    assert bench.maps()


# --- the downward rangefinder ---------------------------------------------------------------------


def test_a_rangefinder_measures_slant_range_and_goes_on_beyond_its_maximum() -> None:
    parameters = {"RNGFND1_TYPE": 100.0, "RNGFND1_MAX": 12.0}
    bench = Bench(parameters=parameters, faults="at 3 s: rangefinder_off").fly(0.2)
    bench.ask(132, 10)
    bench.ask(173, 10)
    bench.hold_m, bench.turn_rad = 16.0, (math.radians(20.0), math.radians(-10.0), 1.0)
    bench.fly(2.0)
    slant_m = 16.0 / (math.cos(math.radians(20.0)) * math.cos(math.radians(10.0)))
    message = bench.of("DISTANCE_SENSOR")[-1]
    assert message.current_distance == pytest.approx(slant_m * 100, abs=1)
    assert (message.id, message.orientation, message.type) == (0, 25, 4)
    assert (message.min_distance, message.max_distance) == (20, 1200)
    assert bench.of("RANGEFINDER")[-1].distance == pytest.approx(slant_m, abs=0.01)
    bench.fly(1.0)
    bench.heard.clear()
    bench.fly(1.0)
    assert bench.of("DISTANCE_SENSOR") == []
    assert {m.distance for m in bench.of("RANGEFINDER")} == {0.0}


def test_without_one_nothing_is_said() -> None:
    bench = Bench().fly(0.2)
    bench.ask(132, 10)
    bench.ask(173, 10)
    bench.fly(1.0)
    assert bench.of("DISTANCE_SENSOR") == bench.of("RANGEFINDER") == []


# --- touching -------------------------------------------------------------------------------------


def flown_into(near: dict[str, Any], autopilot: str) -> tuple[Simulation, Sequence[dict[str, Any]]]:
    """Armed in the air at 4 m/s to the north, 5 m above the ground."""
    flown = Flown("copter", autopilot, **near)
    flown.into_the_air(5.0)
    for _ in range(40):
        flown.go(4.0, 0.0)
        for _ in range(20):
            flown.simulation.step()
    return flown.simulation, flown.truth()


@pytest.mark.sample(5)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize(
    "near",
    [
        {"trees": [POST | {"north_m": 12.0, "radius_m": 0.05}]},
        {
            "walls": [
                {"points_ne_m": [[12.0, -9.0], [12.0, 9.0]], "thickness_m": 0.1, "height_m": 9}
            ]
        },
        {"buildings": [{"corners_ne_m": [[12, -9], [12, 9], [20, 9], [20, -9]], "height_m": 9.0}]},
    ],
    ids=["tree", "wall", "building"],
)
def test_who_touches_something_crashes(near: dict[str, Any], autopilot: str) -> None:
    simulation, truth = flown_into(near, autopilot)
    assert simulation.nearest_m == 0.0
    assert min(row["near_m"] for row in truth) == 0.0
    assert not simulation.armed
    assert simulation.vehicle.altitude_amsl_m == pytest.approx(400.0, abs=0.1)
    assert truth[-1]["north_m"] < 12.3
    assert any("hits" in notice for notice in simulation.take_notices())


def test_who_passes_has_the_least_distance_in_the_truth() -> None:
    tree = POST | {"north_m": 12.0, "east_m": 3.0, "radius_m": 0.5}
    simulation, truth = flown_into({"trees": [tree]}, "ardupilot")
    assert simulation.armed
    east_m = [row["east_m"] for row in truth if abs(row["north_m"] - 12.0) < 0.5]
    least_m = min(row["near_m"] for row in truth)
    assert least_m == pytest.approx(3.0 - 0.5 - float(np.mean(east_m)), abs=0.02)
    assert least_m == pytest.approx(simulation.nearest_m, abs=1e-3)


def test_worlds_without_things_have_no_such_key() -> None:
    simulation = Simulation(world())
    for _ in range(30):
        simulation.step()
    assert not any("near_m" in line for line in simulation.take_truth())


# --- two lidars


def test_a_driver_and_the_autopilots_own_lidar_say_the_same_of_a_post() -> None:
    near = {"second_lidar": {"range_m": 12.0, "output": "autopilot"}}
    bench = Bench(trees=[POST], lidar={"range_m": 40.0}, **near).fly(0.2)
    bench.ask(132, 10.0)
    bench.fly(2.0)
    by_driver, sectors = bench.maps()[-1], bench.of("DISTANCE_SENSOR", 1)
    assert by_driver.max_distance == 4000
    assert {(m.orientation, m.max_distance) for m in sectors} == {(0, 1200)}
    assert min(by_driver.distances) == pytest.approx(900, abs=2)
    assert min(m.current_distance for m in sectors) == pytest.approx(900, abs=2)


def test_a_second_lidar_is_an_autopilots() -> None:
    with pytest.raises(InputError, match=r"second_lidar\.output.*Write"):
        world(lidar={"range_m": 16.0}, second_lidar={"range_m": 16.0, "output": "driver"})
    with pytest.raises(InputError, match=r"second_lidar\.output.*beside"):
        world(second_lidar={"range_m": 16.0, "output": "autopilot"})
