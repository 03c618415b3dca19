"""Nothing is waited for for ever; whoever goes, or comes second, leaves the vehicle safe."""

from collections.abc import Callable

import pytest
from made_up import (
    EACH,
    HOME_AMSL_M,
    SITUATIONS,
    TICK_S,
    Craft,
    calm,
    hears,
    led,
    moving,
    tell,
    told,
)

from companion.mission import events
from companion.mission.changes import OrderResult
from companion.mission.events import Landed, Mode, OrderKind, Outcome, SetMode, Setpoint
from companion.mission.mission import EndAction
from companion.mission.phases import GOING_UP, Phase, Reason
from companion.mission.tables import is_under_control, parting
from companion.mission.vehicle_traits import VehicleTraits


@EACH
@pytest.mark.parametrize("mode", [*Mode, None])
def test_the_companion_that_comes_second_ends_without_a_command_once_it_is_certain(
    traits: VehicleTraits, mode: Mode | None
) -> None:
    """As from the wire: the third time that the first is heard.

    mode: None: it was started again on the path of the first, which it hears only once it leads.
    """
    craft = calm(traits).aloft(mode) if mode else told(led(traits), 5.0, Craft.restart, 2.5)
    for certain in (False, False, True):
        count = len(craft.commands) if mode is None else 0
        told(craft, hears(events.DuplicateId, certain=certain, news=certain), 0.8)
    assert not moving(craft.commands[count:])
    assert craft.end().reason == Reason.NOT_ALONE.text
    assert not is_under_control(craft.state)


# --- whoever goes leaves the vehicle safe

GOES: dict[str, Callable[[Craft], list[events.Command]]] = {
    "Ctrl-C": lambda craft: craft.take(events.StopAsked(time_s=craft.now_s)),
    "a part dies": lambda craft: craft.take(events.PlannerDied(time_s=craft.now_s, error="x")),
    # nothing else is decided any more
    "the decider itself dies": lambda craft: parting(craft.state),
}


def is_safe_alone(craft: Craft, told: list[events.Command]) -> bool:
    """Without its companion for five seconds: held in the air, or disarmed on the ground.

    In the air by its own mode, or on the circle that it was told.  On the ground it is not about to
    take off when somebody arms it, either.
    """
    for command in told:
        craft.obey(command)
    places = [command.at_nea_m for command in told if isinstance(command, SetMode)]
    for _ in range(50):
        craft.move()
    if craft.here[2] > HOME_AMSL_M:
        circles = craft.traits.holds_in_guided and craft.goal is not None and craft.goal in places
        return craft.mode is Mode.HOLD or circles
    return not craft.armed and craft.mode not in (Mode.TAKE_OFF, Mode.GUIDED)


@pytest.mark.parametrize("goes", GOES)
@EACH
def test_whenever_it_goes_the_vehicle_is_left_safe(traits: VehicleTraits, goes: str) -> None:
    """Each half second, and going up at each tick; a landing goes on by itself."""
    craft = calm(traits, end_action=EndAction.LAND).fly_to(Phase.ARMING)
    while not craft.over:
        craft.tick()
        if craft.over or (craft.state.flight.plan_id and craft.now_s % 0.5 > TICK_S):
            continue
        at, left = f"{craft.phase} at {craft.now_s}", craft.copy()
        height_m, mode, path = left.here[2], left.mode, left.state.path
        commands = GOES[goes](left)
        if path is not None and not path.circling:
            places = [command.at_nea_m for command in commands if isinstance(command, SetMode)]
            assert places == [None], f"{at}: it is sent back to where it hovered"
        safe = is_safe_alone(left, commands)
        assert left.here[2] <= height_m + 1e-3, f"{at}: it climbs on"
        landed = mode is Mode.LAND and (goes != "Ctrl-C" or left.landed is Landed.ON_GROUND)
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


@pytest.mark.parametrize("link", [True, False], ids=["only the clock", "link lost"])
@pytest.mark.parametrize("wait", SITUATIONS)
def test_every_wait_ends_with_a_reason_when_only_the_clock_goes_on_or_the_link_is_lost(
    wait: str, link: bool
) -> None:
    """But for somebody's word, as long as the link is there."""
    craft = SITUATIONS[wait]()
    if link:
        craft.take(*(events.Tick(time_s=craft.state.now_s + tick) for tick in range(1, 701)))
    else:
        lost = (3.0, 30.0, 600.0)
        craft.take(*(events.LinkLost(time_s=craft.now_s, silent_s=silent_s) for silent_s in lost))
    if wait not in ("waiting", "ready", "taken") or not link:
        assert craft.over, f"still {craft.phase.value} after twelve minutes"
        assert craft.end().outcome is Outcome.FAILED
