"""How a flight ends that cannot go on: never in the air, unless the mission or a person says so."""

import math
from collections.abc import Callable

import pytest
from made_up import (
    AWAY,
    Craft,
    Step,
    flying,
    holding_without_fix,
    home_or_on,
    now,
    only_the_first,
    texts,
    told,
    warnings,
)
from renewed import replace

from companion.mission.battery import battery_lasts
from companion.mission.events import Mode, OrderKind, Outcome, SetMode
from companion.mission.mission import Fallback, Mission
from companion.mission.phases import Phase, Reason
from companion.planner.request import NotPlanned, Refusal

HANDED, LANDS = "its autopilot returns by itself", "landed"
RETURN, PAUSE = OrderKind.RETURN, OrderKind.PAUSE


def no_plan(of: Mission) -> Craft:
    return flying(of, plan=only_the_first)


FAILURES: dict[str, tuple[Callable[[Mission], Craft], *tuple[Step, ...]]] = {
    "no plan": (no_plan,),
    "the radar is silent": (no_plan, now(answered=0)),
    "the battery is empty": (no_plan, now(battery=0.1)),
    "it does not follow": (flying, now(follows=False)),
    "no fix": (holding_without_fix,),
}


def fails(failure: str, fallback: Fallback) -> Craft:
    begins, *script = FAILURES[failure]
    return told(begins(replace(AWAY, fallback=fallback)), *script)


def modes(craft: Craft) -> list[Mode]:
    """What it was told at last, without what was repeated."""
    told = [command.mode for command in craft.sent(SetMode)]
    return [mode for mode, before in zip(told, [None, *told], strict=False) if mode is not before]


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("fallback", Fallback)
def test_a_flight_that_fails_ends_by_its_fallback_and_that_is_said_before_it_is_done(
    failure: str, fallback: Fallback
) -> None:
    """No way back is proven: its autopilot returns; but what does not know where it is lands."""
    craft = fails(failure, fallback).fly_to(Phase.DONE)
    assert craft.end().outcome is Outcome.FAILED
    if fallback is Fallback.HOLD:
        assert (craft.mode, craft.armed) == (Mode.HOLD, True)
        assert not {Mode.RETURN, Mode.LAND} & set(modes(craft))
        return
    why = craft.state.flight.fallen_back.text + ": it broke floor" * (failure == "no plan")
    mode, how, end = Mode.LAND, "landing here", LANDS
    if fallback is Fallback.RETURN and failure != "no fix":
        mode, how, end = Mode.RETURN, "its autopilot is told to return", HANDED
    assert f"{why}: {how}" in texts(craft.commands[: craft.commands.index(SetMode(mode=mode))])
    assert (Mode.RETURN in modes(craft), craft.armed) == (mode is Mode.RETURN,) * 2
    assert (craft.mode, craft.end().reason) == (mode, f"{end}: {why}")


@pytest.mark.parametrize("obeys", [True, False])
@pytest.mark.parametrize("how", [Fallback.RETURN, Fallback.LAND])
def test_what_does_not_take_the_one_is_asked_for_the_other_or_to_hold_and_a_person_to_take_over(
    how: Fallback, obeys: bool
) -> None:
    phases = [(Phase.HANDING_OVER, Mode.RETURN), (Phase.LANDING, Mode.LAND)]
    first, second = phases if how is Fallback.RETURN else reversed(phases)
    script = (first[0], now(obeys_modes=False), second[0], now(obeys_modes=obeys), Phase.DONE)
    craft = told(fails("it does not follow", how), *script)
    if obeys:
        assert craft.mode is second[1]
        assert craft.end().reason.partition(": ")[0] in (LANDS, HANDED)
    else:
        assert modes(craft)[-3:] == [first[1], second[1], Mode.HOLD]
        assert craft.end().reason == Reason.NOT_OBEYING.text
        assert "by hand" in craft.end().remedy


@pytest.mark.parametrize("refusal", Refusal)
def test_a_hold_for_want_of_a_plan_says_why_and_the_end_what_helps(refusal: Refusal) -> None:
    """In the planner's own words, also if the companion is started again in the landing."""
    land = replace(AWAY, fallback=Fallback.LAND)
    craft = Craft(land, plan=lambda asked: NotPlanned(plan_id=asked.plan_id, refusal=refusal))
    end = told(craft, Phase.LANDING, Craft.restart, Phase.DONE).end()
    why, _, remedy = refusal.value.partition("; ")
    said = Reason.NO_PLAN.text + (f": {why}" if refusal is not Refusal.NOTHING_SAFE else "")
    assert f"hold: {said}" in warnings(craft.commands)
    assert (end.outcome, end.reason) == (Outcome.FAILED, f"landed: {said}")
    assert end.remedy.lower() == f"{remedy}.".lower() != Reason.NO_PLAN.remedy.lower()


def test_what_was_flown_of_the_way_back_before_a_pause_is_not_left_to_fly() -> None:
    back = flying(AWAY, plan=home_or_on)
    craft = told(back, RETURN, Phase.RETURNING, 10.0, PAUSE, Phase.HOLDING, 5.0)
    left_s = math.dist(craft.here[:2], (0.0, 0.0)) / craft.state.task.limits.speed_m_s
    state = replace(craft.state, vehicle=replace(craft.state.vehicle, battery=1.0))
    for share, lasts in ((0.98, False), (1.02, True)):
        mission = replace(AWAY, reserve=0.0, endurance_s=share * left_s)
        assert battery_lasts(state, mission) is lasts


def test_every_reason_says_what_happened_and_what_to_do_in_a_text_of_50_bytes() -> None:
    texts = [reason.text for reason in Reason]
    assert len(set(texts)) == len(texts)
    for reason in Reason:
        assert len(reason.text.encode()) + len("hold: ") <= 60
        assert reason.remedy.endswith(".")
        assert reason.text == reason.text.strip().rstrip(".")
