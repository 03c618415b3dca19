"""Nothing begins unasked, nothing is waited for for ever; whoever goes leaves the vehicle safe."""

from collections.abc import Callable

import pytest
from made_up import (
    EACH,
    HOME_AMSL_M,
    NEAR,
    OVER,
    SITUATIONS,
    TICK_S,
    Craft,
    calm,
    hears,
    led,
    moving,
    now,
    order_of,
    tell,
    texts,
    told,
)
from renewed import replace

from companion.mission import changes, events
from companion.mission.changes import OrderResult
from companion.mission.decisions import Context
from companion.mission.events import Item, Landed, Mode, OrderKind, Outcome, SetMode, Setpoint
from companion.mission.mission import EndAction
from companion.mission.phases import GOING_UP, Phase, Reason
from companion.mission.tables import is_under_control, parting
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

# --- go is said to what is ready


def drains(craft: Craft) -> None:
    craft.context = Context(mission=replace(NEAR, endurance_s=600.0), seed=1)
    craft.battery = 0.1


AROUND = CircleZone(name="z", north_m=0.0, east_m=0.0, radius_m=100.0)
CHECK = {"item": Item.CHECKS, "refusal": "signing: none", "remedy": "x"}
PARAMETER = {"item": Item.PARAMETERS, "refusal": "GUID_OPTIONS = 16"}
LOSSES: dict[str, Callable[[Craft], object]] = {
    Reason.NO_FIX.text: now(fix=False),
    Reason.LINK_LOST.text: hears(events.LinkLost, silent_s=3.0),
    Reason.BATTERY_SHORT.text: drains,
    Reason.POSITION_JUMPED.text: now(here=(1e6, 0.0, HOME_AMSL_M)),
    Reason.OUTSIDE.text: hears(events.FenceChanged, zones=(AROUND,)),
    "signing: none": hears(events.Prepared, **CHECK),
    "GUID_OPTIONS = 16": hears(events.Prepared, **PARAMETER),
    Reason.NO_TARGETS.text: hears(events.TargetsChanged, targets_ne_m=()),
}


@pytest.mark.parametrize("why", LOSSES)
def test_a_check_that_fails_while_it_waits_is_told_and_a_go_refused_with_it(why: str) -> None:
    """It does not end: somebody can mend it."""
    craft = SITUATIONS["ready"]()
    LOSSES[why](craft)
    craft.run_until(lambda craft: craft.phase is Phase.PREPARING, 5.0)
    assert f"not ready any more: {why}" in texts(craft.commands)
    assert tell(craft, OrderKind.START) is OrderResult.NOT_NOW
    assert why in changes.why_not(craft.state, order_of(craft, OrderKind.START))
    assert craft.run_for(200.0).phase is Phase.PREPARING
    assert not moving(craft.commands)
    assert len(craft.sent(events.RequestStreams)) == 1


# --- two companions of one vehicle: the second yields to the first


def beat(craft: Craft, number: int) -> None:
    """Another companion is heard, as from the wire: the third time is certain."""
    said = {"certain": number >= 2, "news": number == 2}
    craft.hear(events.DuplicateId(time_s=craft.now_s, **said))


def after_a_restart(traits: VehicleTraits) -> Craft:
    """With the path of the companion before it, it takes over at once: that may be too soon."""
    return told(led(traits), 5.0, Craft.restart, 2.5)


JOINS: dict[str, Callable[[VehicleTraits], Craft]] = {
    **{mode.value: lambda traits, mode=mode: calm(traits).aloft(mode) for mode in Mode},
    "after a restart": after_a_restart,
}


@EACH
@pytest.mark.parametrize("how", JOINS)
def test_the_one_that_comes_second_ends_without_a_command_once_it_is_certain(
    traits: VehicleTraits, how: str
) -> None:
    """The first streams, so in guided mode there is no second in which it is not heard."""
    craft = JOINS[how](traits)
    if not (had := moving(craft.commands)):
        beat(craft, 0)
        craft.run_for(1.0)
    beat(craft, 1)
    craft.run_for(0.7)
    count = len(moving(craft.commands))
    beat(craft, 2)
    assert len(moving(craft.run_for(2.0).commands)) == count
    assert had or not count
    assert craft.end().reason == Reason.NOT_ALONE.text
    assert not is_under_control(craft.state)


# --- whoever goes leaves the vehicle safe


def by_hand(craft: Craft) -> list[events.Command]:
    """Ctrl-C."""
    return craft.take(events.StopAsked(time_s=craft.now_s))


def by_a_death(craft: Craft) -> list[events.Command]:
    """A part of the companion dies."""
    return craft.take(events.PlannerDied(time_s=craft.now_s, error="ValueError"))


def by_the_watchdog(craft: Craft) -> list[events.Command]:
    """The decider itself has died: nothing else is decided any more."""
    return parting(craft.state)


def is_safe_alone(craft: Craft, told: list[events.Command]) -> bool:
    """Without its companion for five seconds: held in the air, or disarmed on the ground.

    There it is not about to take off when somebody arms it, either.
    """
    for command in told:
        craft.obey(command)
    for _ in range(50):
        craft.move()
    if craft.here[2] > HOME_AMSL_M:
        return craft.mode is Mode.HOLD
    return not craft.armed and craft.mode not in (Mode.TAKE_OFF, Mode.GUIDED)


@pytest.mark.parametrize("goes", [by_hand, by_a_death, by_the_watchdog])
@EACH
def test_whenever_it_goes_the_vehicle_is_left_holding_or_disarmed_on_the_ground(
    traits: VehicleTraits, goes: Callable[[Craft], list[events.Command]]
) -> None:
    """All half second, going up at each tick; a landing goes on by itself."""
    craft = calm(traits, end_action=EndAction.LAND).fly_to(Phase.ARMING)
    while craft.phase not in OVER:
        craft.tick()
        if craft.phase in OVER or (craft.state.flight.plan_id and craft.now_s % 0.5 > TICK_S):
            continue
        at, left = f"{craft.phase} at {craft.now_s}", craft.copy()
        height_m, mode, path = left.here[2], left.mode, left.state.path
        commands = goes(left)
        if path is not None and not path.circling:
            places = [command.at_nea_m for command in commands if isinstance(command, SetMode)]
            assert places == [None], f"{at}: it is sent back to where it hovered"
        safe = is_safe_alone(left, commands)
        assert left.here[2] <= height_m, f"{at}: it climbs on"
        landed = mode is Mode.LAND and (goes is not by_hand or left.landed is Landed.ON_GROUND)
        assert safe or landed, f"{at}: {left.mode}, armed {left.armed}"
    assert craft.phases >= {Phase.ARMING, Phase.TAKING_OFF, Phase.FLYING}


@pytest.mark.parametrize("kind", [OrderKind.PAUSE, OrderKind.RETURN, OrderKind.LAND])
@EACH
def test_an_order_in_the_take_off_is_obeyed_at_once(traits: VehicleTraits, kind: OrderKind) -> None:
    """Each second until it flies: it holds before anything else; on the ground it stays there."""
    started = calm(traits).fly_to(Phase.ARMING)
    while started.phase in GOING_UP:
        craft, height_m = started.copy(), started.here[2]
        on_ground, at = height_m <= HOME_AMSL_M, f"{started.phase}, {started.now_s}"
        started.run_for(1.0 if height_m > HOME_AMSL_M + 3.0 else 2 * TICK_S)
        if kind is OrderKind.LAND and not traits.lands and not on_ground:
            continue
        assert tell(craft, kind) is OrderResult.ACCEPTED
        deadline_s = craft.now_s + 60.0
        while not craft.over and craft.now_s < deadline_s:
            craft.tick()
            assert craft.here[2] <= height_m + 1.0, f"{at}: it climbs on"
        assert not [c for c in craft.sent(Setpoint) if not c.stay], at
        if kind is OrderKind.PAUSE and not on_ground:
            assert craft.state.reason is Reason.PAUSED, at
            continue
        assert craft.end().outcome is Outcome.STOPPED, at
        hands_over = kind is OrderKind.RETURN and not (traits.hovers or on_ground)
        assert not craft.armed or (hands_over and craft.mode is Mode.RETURN), at


# --- nothing waits for ever

ENDLESS = ("waiting", "ready", "taken")
"""As long as the link is there: they wait for somebody."""


@pytest.mark.parametrize("link", [True, False], ids=["only the clock", "link lost"])
@pytest.mark.parametrize("wait", SITUATIONS)
def test_every_wait_ends_with_a_reason_when_only_the_clock_goes_on_or_the_link_is_lost(
    wait: str, link: bool
) -> None:
    craft = SITUATIONS[wait]()
    if link:
        craft.take(*(events.Tick(time_s=craft.state.now_s + tick) for tick in range(1, 701)))
    else:
        lost = (3.0, 30.0, 600.0)
        craft.take(*(events.LinkLost(time_s=craft.now_s, silent_s=silent_s) for silent_s in lost))
    if wait not in ENDLESS or not link:
        assert craft.over, f"still {craft.phase.value} after twelve minutes"
        assert craft.end().outcome is Outcome.FAILED
