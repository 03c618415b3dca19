"""Who has the say: a person's orders, whoever takes the vehicle, its autopilot's own fence.

What was ordered, and told is done, no older plan or order undoes.  What is taken is not fought for,
and not taken back unasked; and a fence that changes is kept to from then on.  `watch` has the laws
of pauses, returns, landings and batteries at each step of any program.
"""

import json
import math
from collections.abc import Callable

import pytest
from made_up import (
    AWAY,
    EACH,
    HOME_AMSL_M,
    MISSION,
    SITUATIONS,
    Craft,
    Step,
    calm,
    flying,
    hears,
    home_or_on,
    moving,
    now,
    of_each,
    tell,
    texts,
    told,
)
from renewed import deep, replace

from companion.mavlink.autopilots import ARDUPLANE
from companion.mission import changes, checkpoint, events
from companion.mission.changes import OrderResult
from companion.mission.events import Mode, Order, OrderKind, Plan
from companion.mission.phases import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

OTHER_NE_M = (6_000.0, 2_000.0)
"""Where a reposition leads (`order_of`)."""
PAUSE, CONTINUE, RETURN = OrderKind.PAUSE, OrderKind.CONTINUE, OrderKind.RETURN
LAND, REPOSITION, START = OrderKind.LAND, OrderKind.REPOSITION, OrderKind.START
HOLDING, RETURNING, LANDING = Phase.HOLDING, Phase.RETURNING, Phase.LANDING
GOING_UP = {"arming", "taking off"}
TAKEN = {
    PAUSE: {"flying", "no plan", "no fix", *GOING_UP},
    RETURN: {"flying", "no plan", "no fix", "arrived", *GOING_UP},
    REPOSITION: {"flying", "no plan", "taken", "no fix", "arrived"},
    LAND: {"flying", "no plan", "no fix", "arrived", "landing", *GOING_UP},
    START: set(SITUATIONS) - {"waiting", "landing", "preparing"},
    CONTINUE: set(SITUATIONS) - {"waiting", "landing", "preparing", "ready"},
}
"""The states in which an order is carried out, written down a second time."""
CARRIED_OUT: dict[OrderKind, tuple[Step, ...]] = {
    PAUSE: (60.0, lambda it: (it.phase, it.state.reason) == (HOLDING, Reason.PAUSED)),
    RETURN: (60.0, lambda it: any(plan.request.flown is not None for plan in it.sent(Plan))),
    REPOSITION: (lambda it: it.state.targets_ne_m == (OTHER_NE_M,),),
    LAND: (60.0, lambda it: events.SetMode(mode=Mode.LAND) in it.commands),
    START: (lambda it: not it.over,),
    CONTINUE: (lambda it: not it.over,),
}
"""What is so of a vehicle that does what was ordered, within a minute."""


@pytest.mark.parametrize("state", [*SITUATIONS][1:])
@pytest.mark.parametrize("kind", OrderKind, ids=lambda kind: kind.name)
def test_an_order_is_accepted_where_it_is_carried_out_and_what_is_accepted_is_done(
    kind: OrderKind, state: str
) -> None:
    """In a take-off: `test_coming_and_going`."""
    craft = SITUATIONS[state]()
    verdict = tell(craft, kind)
    assert (verdict is OrderResult.ACCEPTED) == (state in TAKEN[kind])
    nothing_flown = (kind, state) == (RETURN, "no plan")
    if verdict is OrderResult.ACCEPTED and not (state in GOING_UP or nothing_flown):
        craft.fix = craft.fix or kind is not LAND  # which waits for none
        told(craft, *CARRIED_OUT[kind])


def test_what_can_never_be_carried_out_is_invalid_and_who_only_watches_obeys_nobody() -> None:
    craft, shadow = flown_by(ARDUPLANE.traits), Craft(shadow=True).fly_to(Phase.SHADOW)
    for kind, target_ne_m, why in (
        (REPOSITION, (1e6, 0.0), "reposition refused: the target: it lies outside the map"),
        (REPOSITION, (math.nan, 0.0), "reposition refused: the target: it lies outside the map"),
        (REPOSITION, None, "reposition refused: it has no target"),
        (LAND, None, "send it back"),  # who cannot land is not told to
    ):
        asked = Order(time_s=craft.now_s, kind=kind, target_ne_m=target_ne_m)
        assert changes.order_result(craft.state, asked) is OrderResult.INVALID
        assert why in changes.why_not(craft.state, asked)
    assert {tell(shadow, kind) for kind in OrderKind} == {OrderResult.NOT_NOW}


# --- one order after another


@pytest.mark.parametrize(
    ("script", "ends", "never"),
    [
        ((RETURN, RETURNING, 10.0, PAUSE, HOLDING, 10.0, RETURN, 1.0), RETURNING, Phase.FLYING),
        ((5.0, RETURN, RETURNING, 3.0, LAND, 1.0, RETURN, 1.0), RETURNING, LANDING),
        ((5.0, LAND, 1.0, RETURN), RETURNING, LANDING),
        ((5.0, RETURN, RETURN), RETURNING, LANDING),
        ((5.0, LAND, 1.0, REPOSITION), Phase.ARRIVED, LANDING),
        ((5.0, RETURN, RETURNING, REPOSITION), Phase.ARRIVED, LANDING),
        ((5.0, LAND, 0.5, PAUSE, 0.5, CONTINUE), LANDING, RETURNING),
        ((5.0, LAND, 0.5, PAUSE, 60.0, CONTINUE), LANDING, RETURNING),
        ((5.0, LAND, 0.5, PAUSE, 60.0, Craft.restart, 30.0, CONTINUE), LANDING, RETURNING),
        ((5.0, RETURN, RETURNING, 3.0, LAND, 0.5, Craft.reboot), LANDING, RETURNING),
    ],
    ids=lambda value: value.value if isinstance(value, Phase) else None,
)
def test_the_last_order_counts_and_a_pause_gives_back_what_it_broke_off(
    script: tuple[Step, ...], ends: Phase, never: Phase
) -> None:
    """Also the very target that it came from, and another order after a landing."""
    craft = told(flying(replace(AWAY, targets_ne_m=(OTHER_NE_M,)), plan=home_or_on), *script)
    count = len(craft.steps)
    craft.run_until(lambda craft: craft.phase is ends, 120.0)
    assert never not in {after.phase for *_, after, _ in craft.steps[count:]}
    assert craft.state.flight.returning is (ends is RETURNING)


def ways_left(craft: Craft) -> list[bytes]:
    """The stretches that are still to be flown."""
    path, back = craft.state.path, craft.state.flight.back
    legs = back if path is None else (path.leg, path.next_leg, *back)
    return [leg.subpath.control_nea_m.tobytes() for leg in legs if leg is not None]


@pytest.mark.sample(2)
@EACH
@pytest.mark.parametrize("restarts", [False, True])
def test_no_part_of_the_way_back_is_lost_in_a_pause(traits: VehicleTraits, restarts: bool) -> None:
    """A plane circles at once; a copter brakes first, and flies it to its end, never on."""
    craft = calm(traits, targets_ne_m=((400.0, 300.0), (-500.0, 200.0)))
    craft.run_until(lambda it: it.state.flight.target == 1)
    left = ways_left(told(craft, 12.0, RETURN, RETURNING, 3.0))
    plans = len(craft.sent(Plan))
    assert len(left) > 1
    told(craft, PAUSE, *[Craft.restart] * restarts, HOLDING)
    assert ways_left(craft) == left
    told(craft, Reason.PAUSED, 40.0, CONTINUE)
    craft.run_until(lambda it: it.phase not in (HOLDING, Phase.PREPARING))
    assert craft.phase is RETURNING or craft.state.flight.homeward
    if traits.hovers:
        craft.run_until(lambda it: it.over)
        assert len(craft.sent(Plan)) == plans
        assert craft.here == pytest.approx((0.0, 0.0, HOME_AMSL_M), abs=1.0)
        assert f"hold: {Reason.OFF_PATH.text}" not in texts(craft.commands)


# --- who takes it: a person, the autopilot's failsafe, or its own fence, by name

BY_ITSELF = (Mode.HOLD, Mode.RETURN, Mode.LAND)
"""Modes that a failsafe selects, and a person may."""


def drawn(craft: Craft, place_ne_m: tuple[float, ...], radius_m: float) -> events.FenceChanged:
    north, east = place_ne_m
    zone = CircleZone(name="drawn", north_m=north, east_m=east, radius_m=radius_m)
    return events.FenceChanged(time_s=craft.now_s, zones=(zone,))


def knows(
    place_ne_m: tuple[float, ...] | None = None, *, misread: bool = False
) -> Callable[[Craft], None]:
    """It has read a fence there, or around it."""

    def take(craft: Craft) -> None:
        fence = replace(drawn(craft, place_ne_m or craft.here[:2], 200.0), misread=misread)
        craft.state = deep(craft.state)
        craft.state.take_fence(craft.context.mission.task, fence)

    return take


def flown_by(traits: VehicleTraits) -> Craft:
    """On its path; the driving of another autopilot is put under it in flight."""
    craft = flying()
    craft.state = replace(craft.state, vehicle=replace(craft.state.vehicle, traits=traits))
    return craft


def is_in(mode: Mode, *, failsafe: bool = False) -> Callable[[Craft], object]:
    """A heartbeat says so."""
    return hears(events.VehicleStatus, mode=mode, armed=True, failsafe=failsafe)


BREACH = hears(events.FenceBreach)
TAKES = {
    **{f"a person, by {mode.value}": ((is_in(mode),), Reason.MODE_TAKEN) for mode in BY_ITSELF},
    "a person, in a failsafe": ((is_in(Mode.OTHER, failsafe=True),), Reason.MODE_TAKEN),
    "a person, inside a fence": ((knows(), is_in(Mode.HOLD)), Reason.MODE_TAKEN),
    "a person, by stick after a breach": ((BREACH, is_in(Mode.OTHER)), Reason.MODE_TAKEN),
    "a person, long after a breach": ((BREACH, 6.0, is_in(Mode.HOLD)), Reason.MODE_TAKEN),
    "its failsafe": ((is_in(Mode.RETURN, failsafe=True),), Reason.FAILSAFE),
    **{f"its fence, by {m.value}": ((BREACH, is_in(m)), Reason.FENCE_BREACHED) for m in BY_ITSELF},
    "its fence, some seconds after": ((BREACH, 3.0, is_in(Mode.HOLD)), Reason.FENCE_BREACHED),
    "its fence, which says so later": ((is_in(Mode.RETURN), BREACH), Reason.FENCE_BREACHED),
}


@EACH
@pytest.mark.parametrize("who", TAKES)
def test_who_takes_it_has_it_by_name_until_told_to_go_on(traits: VehicleTraits, who: str) -> None:
    """A breach alone is nothing: GF_ACTION may be a warning only."""
    script, why = TAKES[who]
    craft = told(flown_by(traits), *script)
    assert (craft.state.taken, craft.state.reason) == (True, why)
    assert f"hold: {why.text}" in texts(craft.commands)
    assert not moving(craft.steps[-1][3])
    told(craft, START)
    assert craft.state.stage.released_at_s == craft.now_s


@of_each(lambda traits: traits.needs_setpoints_before_offboard)
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("around", "misread", "why"),
    [
        (True, False, Reason.FENCE_BREACHED),
        (False, False, Reason.STREAM_LOST),
        (False, True, Reason.FENCE_BREACHED),
    ],
)
def test_px4_tells_a_companion_of_no_fence_but_is_in_it_or_misreads_it_and_in_a_failsafe(
    traits: VehicleTraits, known: bool, around: bool, misread: bool, why: Reason
) -> None:
    """The fence may be read only after the autopilot holds for it; elsewhere it lost the stream.

    Nobody knows where PX4 keeps out what it misreads.
    """
    craft = flown_by(traits)
    reads = knows(None if around else (5_000.0, -5_000.0), misread=misread)
    told(craft, *[reads] * known, now(mode=Mode.HOLD, failsafe=True), HOLDING)
    assert craft.state.reason is (why if known and around else Reason.STREAM_LOST)
    assert told(craft, reads, 10.0).state.reason is why
    assert craft.state.taken is (why is Reason.FENCE_BREACHED)
    later = Reason.FAILSAFE if why is Reason.STREAM_LOST else why
    assert told(craft, 30.0).state.reason is later


# --- a fence that is changed in flight; while it is read, or in a pause: `test_stories`

AHEAD_NE_M = (10_000.0 * math.sqrt(0.5), 10_000.0 * math.sqrt(0.5))
"""On the first leg."""


@pytest.mark.parametrize("is_ahead", [True, False])
def test_a_fence_across_the_path_or_around_it_stops_it_and_plans_anew(is_ahead: bool) -> None:
    """Clear of the one ahead, and out of the one around it."""
    craft = flying()
    place, radius_m = (AHEAD_NE_M, 500.0) if is_ahead else (craft.here[:2], 200.0)
    craft.hear(drawn(craft, place, radius_m))
    assert craft.fly_to(HOLDING).state.reason is Reason.NEW_THREAT
    clear_m = radius_m + MISSION.task.zone_clearance_m
    assert not is_ahead or math.dist(craft.here[:2], place) > clear_m
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert craft.sent(Plan)[-1].request.from_rest


def test_a_fence_that_does_not_touch_the_path_changes_the_next_plan_and_the_band_only() -> None:
    craft = flying()
    before = craft.state.flight
    low = replace(drawn(craft, (4_000.0, -4_000.0), 500.0), ceiling_amsl_m=4_000.0)
    assert [type(command) for command in craft.take(low)] == [events.StatusText]
    assert craft.state.flight == before
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    task = craft.sent(Plan)[-1].request.task
    assert "drawn" in {zone.name for zone in task.zones}
    assert task.limits.ceiling_amsl_m == 4_000.0
    craft.take(events.FenceChanged(time_s=craft.now_s, zones=()))
    assert craft.state.task.limits == MISSION.task.limits


def test_a_fence_that_a_path_leads_out_of_stops_nobody_told_again_or_after_a_restart() -> None:
    """But what was proven for another mission is proven for none."""
    craft = told(flying(), knows())
    around, leg = craft.state.fence, replace(craft.state.leg, rules=craft.state.task)
    craft.state = before = replace(craft.state, path=replace(craft.state.path, leg=leg))
    craft.take(replace(around, time_s=craft.now_s + 1.0))
    assert (craft.state.stage, craft.state.flight) == (before.stage, before.flight)
    craft.take(events.FenceChanged(time_s=craft.now_s, zones=(*around.zones, *around.zones)))
    assert craft.state.path.stop is None
    values = json.loads(json.dumps(checkpoint.values_of(before)))
    stricter = replace(MISSION.task, limits=replace(MISSION.task.limits, dead_man_s=9.0))
    for task, rules in ((MISSION.task, before.task), (stricter, stricter.unruled())):
        again = checkpoint.restored(replace(MISSION, task=task), before.flight.known, values)
        assert again.leg.rules == rules
