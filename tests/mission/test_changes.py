"""What comes from outside in a flight: orders, fences, settings, targets, restarts, a shadow."""

import json
import math
from collections.abc import Callable

import pytest
from made_up import (
    EACH,
    MISSION,
    Craft,
    arrived,
    flying,
    holding_mode_taken,
    holding_without_fix,
    holding_without_plan,
    landing,
    moving,
    near_target,
    order_of,
    preparing,
    scan_done,
    two_legs_away,
)
from renewed import deep, replace
from wild import Wild

from companion.mavlink.autopilots import ALL, PX4_MULTICOPTER
from companion.mission import changes, checkpoint, events
from companion.mission.changes import OrderResult
from companion.mission.decisions import Turn
from companion.mission.events import FenceChanged, Mode, Order, OrderKind, Plan, SetMode, Setpoint
from companion.mission.flying import on_answer
from companion.mission.mission import Fallback
from companion.mission.phases import Phase, Reason, Scanning
from companion.mission.state import Way
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

AT_ONCE = {
    "preparing": preparing,
    "ready": lambda: Craft(go=False).fly_to(Phase.READY),
    "arming": lambda: Craft().fly_to(Phase.ARMING),
    "taking off": lambda: Craft().fly_to(Phase.TAKING_OFF),
    "flying": lambda: flying(two_legs_away()),
    "no plan": holding_without_plan,
    "taken": holding_mode_taken,
    "no fix": holding_without_fix,
    "arrived": arrived,
    "landing": landing,
}
GOING_UP = {"arming", "taking off"}
TAKEN = {
    OrderKind.PAUSE: {"flying", "no plan", "no fix", *GOING_UP},
    OrderKind.RETURN: {"flying", "no plan", "no fix", "arrived", *GOING_UP},
    OrderKind.REPOSITION: {"flying", "no plan", "taken", "no fix", "arrived"},
    OrderKind.LAND: {"flying", "no plan", "no fix", "arrived", "landing", *GOING_UP},
    OrderKind.START: set(AT_ONCE) - {"landing", "preparing"},
    OrderKind.CONTINUE: set(AT_ONCE) - {"landing", "preparing", "ready"},
}
"""The states in which an order is carried out, written down a second time."""
ON_THE_WAY_UP = (OrderKind.PAUSE, OrderKind.RETURN, OrderKind.LAND)
"""`test_machine` has what these do to a take-off."""


@pytest.mark.parametrize("state", AT_ONCE)
@pytest.mark.parametrize("kind", OrderKind, ids=lambda kind: kind.name)
def test_an_order_is_accepted_where_it_is_carried_out(kind: OrderKind, state: str) -> None:
    craft = AT_ONCE[state]()
    assert (changes.order_result(craft.state, order_of(craft, kind)) is OrderResult.ACCEPTED) == (
        state in TAKEN[kind]
    )


def carried_out(kind: OrderKind, craft: Craft) -> bool:
    """Whether the vehicle does what was ordered, within a minute or so."""
    match kind:
        case OrderKind.PAUSE:
            craft.run_for(60.0)
            return craft.state.phase is Phase.HOLDING and craft.state.reason is Reason.PAUSED
        case OrderKind.RETURN:
            asked = len(craft.sent(Plan))
            craft.run_for(60.0)
            return any(plan.request.flown is not None for plan in craft.sent(Plan)[asked:])
        case OrderKind.REPOSITION:
            return craft.state.targets_ne_m == ((6_000.0, 2_000.0),)
        case OrderKind.LAND:
            craft.run_for(60.0)
            return SetMode(mode=Mode.LAND) in craft.sent(SetMode)
        case OrderKind.START | OrderKind.CONTINUE:
            return craft.phase not in (Phase.DONE, Phase.FAULTED)


@pytest.mark.parametrize(
    ("kind", "state"),
    [
        (kind, state)
        for kind, states in TAKEN.items()
        for state in sorted(states)
        if (kind, state) != (OrderKind.RETURN, "no plan")  # nothing was flown: no way back
        and (state not in GOING_UP or kind not in ON_THE_WAY_UP)
    ],
    ids=lambda value: value if isinstance(value, str) else value.name,
)
def test_what_is_accepted_is_done(kind: OrderKind, state: str) -> None:
    craft = AT_ONCE[state]()
    craft.order(kind)
    craft.fix = craft.fix or kind is not OrderKind.LAND  # which waits for none
    assert carried_out(kind, craft)


def test_a_pause_stops_on_the_path_and_a_word_goes_on_from_there() -> None:
    craft = flying(two_legs_away())
    craft.order(OrderKind.PAUSE)
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.PAUSED
    stopped_m = math.hypot(*craft.here[:2])
    assert craft.here[0] == pytest.approx(craft.here[1], abs=1e-5)  # on the straight path
    craft.run_for(400.0)  # as long as it takes
    assert craft.state.reason is Reason.PAUSED
    assert math.hypot(*craft.here[:2]) == pytest.approx(stopped_m, abs=1.0)
    craft.order(OrderKind.CONTINUE)
    assert craft.fly_to(Phase.DONE).end().outcome is events.Outcome.ARRIVED


def test_a_start_asks_for_guided_mode_of_a_vehicle_that_somebody_had_taken() -> None:
    craft = holding_mode_taken().run_for(5.0)
    craft.obeys_modes = True
    craft.order(OrderKind.START)
    assert SetMode(mode=Mode.GUIDED) in craft.during(3.0)
    assert craft.fly_to(Phase.DONE).end().outcome is events.Outcome.ARRIVED


@pytest.mark.parametrize("target_ne_m", [(1e6, 0.0), (math.nan, 0.0), None], ids=str)
def test_a_target_that_cannot_be_one_is_invalid(target_ne_m: tuple[float, float] | None) -> None:
    craft = flying(two_legs_away())
    asked = Order(time_s=craft.now_s, kind=OrderKind.REPOSITION, target_ne_m=target_ne_m)
    assert changes.order_result(craft.state, asked) is OrderResult.INVALID
    why = "it has no target" if target_ne_m is None else "the target: it lies outside the map"
    assert changes.why_not(craft.state, asked).startswith(f"reposition refused: {why}")


def test_other_targets_are_flown_to_from_where_the_vehicle_stops() -> None:
    craft = flying(two_legs_away())
    targets = ((8_000.0, 2_000.0), (2_000.0, 8_000.0))
    craft.obey(craft.take(events.TargetsChanged(time_s=craft.now_s, targets_ne_m=targets)))
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.NEW_TARGET
    craft.fly_to(Phase.DONE)
    assert craft.here[:2] == pytest.approx(targets[-1], abs=1.0)


@pytest.mark.parametrize(
    "state", [state for state in AT_ONCE if state not in ("preparing", "ready")]
)
def test_a_mission_that_is_cleared_in_flight_changes_nothing(state: str) -> None:
    craft = AT_ONCE[state]()
    targets = craft.state.targets_ne_m
    craft.obey(craft.take(events.TargetsChanged(time_s=craft.now_s, targets_ne_m=())))
    craft.run_for(3.0)
    assert craft.state.targets_ne_m == targets


# --- fences


def fence(craft: Craft, north_m: float, east_m: float, radius_m: float) -> FenceChanged:
    zone = CircleZone(name="drawn", north_m=north_m, east_m=east_m, radius_m=radius_m)
    return FenceChanged(time_s=craft.now_s, zones=(zone,))


def test_a_fence_that_does_not_touch_the_path_changes_the_next_plan_only() -> None:
    craft = flying()
    before = craft.state.flight
    commands = craft.take(fence(craft, 4_000.0, -4_000.0, 500.0))
    assert craft.state.flight == before
    assert [type(command) for command in commands] == [events.StatusText]
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert "drawn" in {zone.name for zone in craft.sent(Plan)[-1].request.task.zones}


@pytest.mark.parametrize(("ahead_m", "radius_m"), [(10_000.0, 500.0), (0.0, 200.0)])
def test_a_fence_across_the_path_or_around_it_stops_the_vehicle_and_plans_anew(
    ahead_m: float, radius_m: float
) -> None:
    craft = flying()
    north = ahead_m * math.sqrt(0.5) if ahead_m else craft.here[0]
    craft.obey(craft.take(fence(craft, north, north, radius_m)))
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.NEW_THREAT
    away_m = math.dist(craft.here[:2], (north, north))
    assert ahead_m == 0.0 or away_m > radius_m + MISSION.task.zone_clearance_m
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)  # out of it, too
    assert craft.sent(Plan)[-1].request.from_rest


def test_a_fence_on_the_way_back_of_a_vehicle_that_is_paused_leaves_it_led() -> None:
    """In guided mode silence is a lost stream, whatever has become of the way back."""
    craft = flying()
    leg = craft.state.leg
    assert leg is not None
    craft.take(Order(time_s=craft.now_s, kind=OrderKind.PAUSE))
    craft.fly_to(Phase.HOLDING)
    flight = craft.state.flight
    assert flight.hover_nea_m is not None
    craft.state = replace(craft.state, flight=replace(flight, way=Way.BACK, back=(leg,)))
    ahead_m = 10_000.0 * math.sqrt(0.5)
    craft.take(fence(craft, ahead_m, ahead_m, 500.0))
    assert craft.state.flight.hover_nea_m == flight.hover_nea_m
    sent = len(craft.sent(Setpoint))
    craft.run_for(2.0)
    assert craft.state.reason is Reason.PAUSED
    assert len(craft.sent(Setpoint)) > sent


def on_its_way_out() -> tuple[Craft, FenceChanged]:
    """On a leg that was proven with a zone around its start, and leads out of that."""
    craft = flying()
    around = fence(craft, *craft.here[:2], 200.0)
    state = deep(craft.state)
    state.take_fence(craft.context.mission.task, around)
    leg = replace(state.leg, rules=state.task)
    craft.state = replace(state, path=replace(state.path, leg=leg))
    return craft, around


def test_the_same_fence_told_again_is_no_other_and_stops_nobody() -> None:
    craft, around = on_its_way_out()
    before = craft.state
    craft.take(replace(around, time_s=craft.now_s + 1.0))
    assert craft.state.task is before.task
    assert (craft.state.stage, craft.state.flight) == (before.stage, before.flight)
    craft.take(FenceChanged(time_s=craft.now_s, zones=(*around.zones, *around.zones)))
    assert craft.state.path.stop is None


def test_what_a_path_was_proven_under_outlives_the_companion_and_no_other_mission() -> None:
    craft, _ = on_its_way_out()
    values = json.loads(json.dumps(checkpoint.values_of(craft.state)))
    known, stricter = craft.state.flight.known, replace(MISSION.task.limits, dead_man_s=9.0)
    again = checkpoint.restored(MISSION, known, values)
    assert again.leg.rules == again.task == craft.state.task
    other = replace(MISSION, task=replace(MISSION.task, limits=stricter))
    leg = checkpoint.restored(other, known, values).leg
    assert leg.rules is None


def test_the_ceiling_of_the_fence_lowers_the_band() -> None:
    craft = flying()
    craft.take(FenceChanged(time_s=craft.now_s, zones=(), ceiling_amsl_m=4_000.0))
    assert craft.state.task.limits.ceiling_amsl_m == 4_000.0
    craft.take(FenceChanged(time_s=craft.now_s, zones=()))
    assert craft.state.task.limits == MISSION.task.limits


# --- the vehicle itself


@pytest.mark.parametrize("state", AT_ONCE)
def test_a_reboot_prepares_again_and_keeps_what_is_known(state: str) -> None:
    craft = AT_ONCE[state]()
    known = craft.state.flight.known
    craft.reboot()
    assert craft.phase is Phase.PREPARING
    assert craft.state.flight.known is known
    assert craft.state.vehicle.position_nea_m is None
    assert craft.state.leg is None


@pytest.mark.parametrize("made", [lambda: flying(two_legs_away()), holding_mode_taken])
@pytest.mark.parametrize(
    "again", [Craft.reboot, Craft.restart, lambda craft: craft.reboot().restart()]
)
def test_what_falls_in_a_reboot_or_a_restart_is_never_armed_again(
    made: Callable[[], Craft], again: Callable[[Craft], Craft]
) -> None:
    craft = again(made())
    craft.mode, craft.armed, craft.landed = Mode.OTHER, False, events.Landed.ON_GROUND
    assert not moving(craft.during(150.0))
    assert craft.phase is Phase.DONE


def test_a_vehicle_that_reboots_in_flight_and_flies_on_is_taken_over() -> None:
    craft = flying(near_target())
    craft.reboot()
    count = len(craft.commands)
    assert craft.fly_to(Phase.DONE).end().outcome is events.Outcome.ARRIVED
    assert not [c for c in craft.commands[count:] if isinstance(c, events.Arm | events.TakeOff)]


@pytest.mark.parametrize("echoes", [True, False])
def test_setpoints_that_the_autopilot_does_not_take_are_a_reasoned_hold(echoes: bool) -> None:
    """One without an echo is not suspected."""
    craft = flying()
    while craft.phase is Phase.FLYING and craft.now_s < 100.0:
        far = (craft.here[0] - 5_000.0, craft.here[1], craft.here[2])
        if echoes:
            craft.take(events.Echo(time_s=craft.now_s, position_nea_m=far))
        craft.tick()
    reason = Reason.NOT_TAKEN if echoes else None
    assert (craft.phase is Phase.HOLDING, craft.state.reason) == (echoes, reason)
    assert (craft.sent(SetMode)[-1].mode is Mode.HOLD) is echoes


def test_a_battery_that_does_not_reach_the_target_is_not_taken_off_with() -> None:
    craft = Craft(replace(MISSION, endurance_s=600.0))  # 141 km at 150 m/s take 950 s
    craft.fly_to(Phase.PREPARING)
    craft.take(events.Battery(time_s=craft.now_s, remaining=1.0))
    assert craft.fly_to(Phase.DONE).end().reason.startswith(Reason.BATTERY_SHORT.text)
    assert not craft.sent(events.Arm)


# --- restarts


@pytest.mark.sample(5)
@EACH
@pytest.mark.parametrize("after_s", [0.3, 3.1, 8.7, 14.9, 21.3, 27.7])
def test_a_restart_at_any_moment_of_a_flight_goes_on_without_a_jump(
    traits: VehicleTraits, after_s: float
) -> None:
    """Where the vehicle is led: 1 m and 1 m/s from where it was led, or from where it is."""
    wild = Wild.calmly(traits).run_until(lambda wild: wild.state.leg is not None)
    wild.run_for(after_s)
    last = wild.sent(Setpoint)[-1]
    wild._restart()
    count = len(wild.said_to)
    wild.run_until(lambda wild: any(isinstance(c, Setpoint) for c in wild.said_to[count:]))
    first = next(c for c in wild.said_to[count:] if isinstance(c, Setpoint))
    passed_s = first.time_s - last.time_s
    assert passed_s < 6.0
    if traits.hovers:
        moved_m = math.dist(first.position_nea_m, last.position_nea_m)
        assert moved_m <= 1.0 + passed_s * math.hypot(*last.velocity_nea_m_s)
        was = (wild.velocity, last.velocity_nea_m_s)  # it has stopped at the last setpoint, or not
        apart = min(math.dist(first.velocity_nea_m_s, velocity) for velocity in was)
        assert first.stay or apart <= 1.0 + 2.5 * wild.tick_s
    assert wild.fly_to(Phase.DONE).said_to[-1].outcome is events.Outcome.ARRIVED


def test_what_is_restored_is_what_was_kept() -> None:
    craft = flying(two_legs_away())
    craft.take(fence(craft, 4_000.0, -4_000.0, 500.0))
    craft.run_until(lambda craft: craft.state.flight.legs_flown == 2)  # under that fence
    values = json.loads(json.dumps(checkpoint.values_of(craft.state)))
    state = checkpoint.restored(craft.context.mission, craft.state.flight.known, values)
    assert checkpoint.values_of(state) == {
        **checkpoint.values_of(craft.state),
        "phase": Phase.WAITING.name,
    }
    assert state.task == craft.state.task
    assert state.airborne


# --- shadow


def test_a_mission_that_is_stopped_while_it_takes_over_a_climb_ends_in_a_hold() -> None:
    wild = Wild.calmly(PX4_MULTICOPTER.traits).aloft(Mode.TAKE_OFF).fly_to(Phase.HOLDING)
    assert (wild.state.reason, wild.mode) == (Reason.TAKING_OVER, Mode.TAKE_OFF)
    wild.take(events.StopAsked(time_s=wild.now_s))
    assert [each.mode for each in wild.sent(SetMode)] == [Mode.HOLD]


@pytest.mark.parametrize("is_shadow", [True, False])
def test_only_what_stands_looks_again_where_the_radar_left_something_out(is_shadow: bool) -> None:
    """A shadow's vehicle flies on meanwhile, wherever somebody else takes it."""
    wild = Wild.calmly(ALL[0].traits, shadow=is_shadow).aloft(Mode.OTHER)
    state = replace(wild.state, phase=Phase.SHADOW if is_shadow else Phase.FLYING)
    scanned = replace(scan_done(wild.state.now_s), asked=9, answered=4)
    turn = Turn(replace(state, search=Scanning((0, 0, 3000))), wild.context)
    on_answer(turn.state, turn.state.stage, scanned, turn)
    does = [
        type(command) for command in turn.commands if not isinstance(command, events.StatusText)
    ]
    assert does == [Plan if is_shadow else events.StartScan]


def test_a_battery_that_runs_low_while_it_is_held_does_not_leave_it_in_guided_mode_in_silence() -> (
    None
):
    craft = holding_without_fix(replace(two_legs_away(), fallback=Fallback.HOLD)).run_for(3.0)
    craft.battery = 0.1
    craft.run_for(4.0)
    craft.fix = True
    craft.run_until(lambda craft: craft.mode is Mode.GUIDED)
    assert craft.phase is Phase.DONE or moving(craft.run_for(1.5).during(0.5))
