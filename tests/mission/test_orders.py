"""What a person has ordered, and was told is done, is done: no older plan or order undoes it.

`watch` has the laws of pauses, returns, landings and batteries at each step of any program.
"""

import math

import pytest
from made_up import (
    AWAY,
    EACH,
    HOME_AMSL_M,
    SITUATIONS,
    Craft,
    Step,
    calm,
    flying,
    home_or_on,
    tell,
    texts,
    told,
)
from renewed import replace

from companion.mavlink.autopilots import ARDUPLANE
from companion.mission import changes
from companion.mission.changes import OrderResult
from companion.mission.events import Mode, Order, OrderKind, Plan, SetMode
from companion.mission.phases import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits

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


def carried_out(kind: OrderKind, craft: Craft) -> bool:
    """Whether the vehicle does what was ordered, within a minute or so."""
    asked = len(craft.sent(Plan))
    if kind in (PAUSE, RETURN, LAND):
        craft.run_for(60.0)
    match kind:
        case OrderKind.PAUSE:
            return (craft.phase, craft.state.reason) == (HOLDING, Reason.PAUSED)
        case OrderKind.RETURN:
            return any(plan.request.flown is not None for plan in craft.sent(Plan)[asked:])
        case OrderKind.REPOSITION:
            return craft.state.targets_ne_m == (OTHER_NE_M,)
        case OrderKind.LAND:
            return SetMode(mode=Mode.LAND) in craft.sent(SetMode)
        case OrderKind.START | OrderKind.CONTINUE:
            return not craft.over


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
        assert carried_out(kind, craft)


def test_an_order_that_can_never_be_carried_out_is_invalid_and_who_only_watches_obeys_nobody() -> (
    None
):
    craft, shadow = flying(AWAY), Craft(shadow=True).fly_to(Phase.SHADOW)
    vehicle = replace(craft.state.vehicle, traits=ARDUPLANE.traits)
    craft.state = replace(craft.state, vehicle=vehicle)
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
def test_no_stretch_of_the_way_back_is_lost_in_a_pause_or_a_restart_in_it(
    traits: VehicleTraits, restarts: bool
) -> None:
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
