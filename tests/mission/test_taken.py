"""Who takes the vehicle has it: a person, the autopilot's failsafe, or its own fence, by name.

It is not fought for, and not taken back unasked; and a fence that changes is kept to from then on.
"""

import json
import math
from collections.abc import Callable

import pytest
from made_up import (
    EACH,
    HOLDS_FOR_SETPOINTS,
    MISSION,
    Craft,
    flying,
    hears,
    moving,
    now,
    order_of,
    texts,
    told,
)
from renewed import deep, replace

from companion.mission import checkpoint
from companion.mission.events import (
    FenceBreach,
    FenceChanged,
    Mode,
    OrderKind,
    Plan,
    Setpoint,
    StatusText,
    VehicleStatus,
)
from companion.mission.phases import Phase, Reason
from companion.mission.state import Way
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

BY_ITSELF = (Mode.HOLD, Mode.RETURN, Mode.LAND)
"""Modes that a failsafe selects, and a person may."""


def drawn(craft: Craft, place_ne_m: tuple[float, ...], radius_m: float) -> FenceChanged:
    north, east = place_ne_m
    zone = CircleZone(name="drawn", north_m=north, east_m=east, radius_m=radius_m)
    return FenceChanged(time_s=craft.now_s, zones=(zone,))


def knows(
    place_ne_m: tuple[float, ...] | None = None, **changes: object
) -> Callable[[Craft], None]:
    """It has read a fence there, or around it."""

    def take(craft: Craft) -> None:
        fence = replace(drawn(craft, place_ne_m or craft.here[:2], 200.0), **changes)
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
    return hears(VehicleStatus, mode=mode, armed=True, failsafe=failsafe)


BREACH = hears(FenceBreach)
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
def test_who_takes_it_has_it_by_name_and_a_word_gives_it_back(
    traits: VehicleTraits, who: str
) -> None:
    """A breach alone is nothing: GF_ACTION may be a warning only."""
    script, why = TAKES[who]
    craft = told(flown_by(traits), *script)
    assert (craft.state.taken, craft.state.reason) == (True, why)
    assert f"hold: {why.text}" in texts(craft.commands)
    assert not moving(craft.steps[-1][3])
    told(craft, OrderKind.START)
    assert craft.state.stage.released_at_s == craft.now_s


@HOLDS_FOR_SETPOINTS
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
    place_ne_m, craft = None if around else (5_000.0, -5_000.0), flown_by(traits)
    reads = knows(place_ne_m, misread=misread)
    told(craft, *[reads] * known, now(mode=Mode.HOLD, failsafe=True), Phase.HOLDING)
    assert craft.state.reason is (why if known and around else Reason.STREAM_LOST)
    assert told(craft, reads, 10.0).state.reason is why
    assert craft.state.taken is (why is Reason.FENCE_BREACHED)
    later = Reason.FAILSAFE if why is Reason.STREAM_LOST else why
    assert told(craft, 30.0).state.reason is later


# --- a fence that is changed in flight; while it is read: `test_stories`

AHEAD_NE_M = (10_000.0 * math.sqrt(0.5), 10_000.0 * math.sqrt(0.5))
"""On the first leg."""


@pytest.mark.parametrize("is_ahead", [True, False])
def test_a_fence_across_the_path_or_around_it_stops_the_vehicle_and_plans_anew(
    is_ahead: bool,
) -> None:
    """Clear of the one ahead, and out of the one around it."""
    craft = flying()
    place, radius_m = (AHEAD_NE_M, 500.0) if is_ahead else (craft.here[:2], 200.0)
    craft.hear(drawn(craft, place, radius_m))
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.NEW_THREAT
    clear_m = radius_m + MISSION.task.zone_clearance_m
    assert not is_ahead or math.dist(craft.here[:2], place) > clear_m
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert craft.sent(Plan)[-1].request.from_rest


def test_a_fence_that_does_not_touch_the_path_changes_the_next_plan_and_the_band_only() -> None:
    craft = flying()
    before = craft.state.flight
    low = replace(drawn(craft, (4_000.0, -4_000.0), 500.0), ceiling_amsl_m=4_000.0)
    assert [type(command) for command in craft.take(low)] == [StatusText]
    assert craft.state.flight == before
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    task = craft.sent(Plan)[-1].request.task
    assert "drawn" in {zone.name for zone in task.zones}
    assert task.limits.ceiling_amsl_m == 4_000.0
    craft.take(FenceChanged(time_s=craft.now_s, zones=()))
    assert craft.state.task.limits == MISSION.task.limits


def test_a_fence_that_a_path_leads_out_of_stops_nobody_told_again_or_after_a_restart() -> None:
    """But what was proven for another mission is proven for none."""
    craft = told(flying(), knows())
    around, leg = craft.state.fence, replace(craft.state.leg, rules=craft.state.task)
    craft.state = before = replace(craft.state, path=replace(craft.state.path, leg=leg))
    craft.take(replace(around, time_s=craft.now_s + 1.0))
    assert (craft.state.stage, craft.state.flight) == (before.stage, before.flight)
    craft.take(FenceChanged(time_s=craft.now_s, zones=(*around.zones, *around.zones)))
    assert craft.state.path.stop is None
    values = json.loads(json.dumps(checkpoint.values_of(before)))
    stricter = replace(MISSION.task, limits=replace(MISSION.task.limits, dead_man_s=9.0))
    for task, rules in ((MISSION.task, before.task), (stricter, stricter.unruled())):
        again = checkpoint.restored(replace(MISSION, task=task), before.flight.known, values)
        assert again.leg.rules == rules


def test_a_fence_on_the_way_back_of_a_vehicle_that_is_paused_leaves_it_led() -> None:
    """In guided mode silence is a lost stream, whatever has become of the way back."""
    craft = flying()
    leg = craft.state.leg
    craft.take(order_of(craft, OrderKind.PAUSE))
    craft.fly_to(Phase.HOLDING)
    flight = craft.state.flight
    assert flight.hover_nea_m is not None
    craft.state = replace(craft.state, flight=replace(flight, way=Way.BACK, back=(leg,)))
    craft.take(drawn(craft, AHEAD_NE_M, 500.0))
    assert craft.state.flight.hover_nea_m == flight.hover_nea_m
    assert any(isinstance(command, Setpoint) for command in craft.during(2.0))
    assert craft.state.reason is Reason.PAUSED
