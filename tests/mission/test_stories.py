"""What users live through, a flight in a line: how it begins, what happens then, how it ends.

Each step is an order, how long it flies on, until which phase or reason, or what else happens; one
that says no is a law that is broken.  What holds at every step of any flight: `watch`.
"""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from made_up import (
    AWAY,
    HOME_AMSL_M,
    LAND,
    MISSION,
    NEAR,
    SITUATIONS,
    TAKEN,
    Craft,
    Step,
    arrived,
    backtrack,
    flying,
    hears,
    holding_without_fix,
    home_or_on,
    moving,
    now,
    only_the_first,
    order_of,
    position,
    says,
    tell,
    texts,
    told,
)
from made_up_plans import not_planned, planned, straight
from renewed import replace

from companion.mission import changes, events, phases
from companion.mission.battery import battery_lasts
from companion.mission.decisions import Context
from companion.mission.events import Landed, Mode, OrderKind, Outcome, Setpoint
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.phases import Phase, Reason
from companion.mission.stopped import FAILSAFE_OVER
from companion.planner.procedure import Reference
from companion.planner.request import NotPlanned, PlanOutcome, PlanRequest, Refusal
from companion.world.zones import CircleZone

PAUSE, CONTINUE, RETURN = OrderKind.PAUSE, OrderKind.CONTINUE, OrderKind.RETURN
START, LANDS = OrderKind.START, OrderKind.LAND
preparing, ready = SITUATIONS["preparing"], SITUATIONS["ready"]
READY, HOLDING, FLYING, DONE = Phase.READY, Phase.HOLDING, Phase.FLYING, Phase.DONE
LANDING, RETURNING, PREPARING = Phase.LANDING, Phase.RETURNING, Phase.PREPARING
ELSEWHERE = ((8_000.0, 2_000.0), (2_000.0, 8_000.0))
OUT_NEA_M = (3_000.0, -2_000.0, HOME_AMSL_M + 100.0)
"""Where a pilot has flown it before the companion was started."""

# --- how it begins


def under_way(**changes: object) -> Callable[[], Craft]:
    """At speed, of a mission so changed; there is a way on, and back."""
    of = replace(AWAY, **changes) if changes else AWAY
    return lambda: flying(of, plan=home_or_on)


def taken_over(of: Mission = AWAY) -> Craft:
    """Started in the air, 3.6 km from home."""
    craft = Craft(of, plan=home_or_on).aloft(Mode.GUIDED)
    craft.here = OUT_NEA_M
    return craft


def closed_in(request: PlanRequest) -> NotPlanned:
    return NotPlanned(plan_id=request.plan_id, refusal=Refusal.START_NEAR_TERRAIN)


def landing_begun() -> Craft:
    return SITUATIONS["landing"]().run_until(lambda craft: craft.mode is Mode.LAND).run_for(3.0)


# --- what happens


def until(done: Callable[[Craft], object], limit_s: float = 3600.0) -> Callable[[Craft], Craft]:
    return lambda craft: craft.run_until(done, limit_s)


LOW = now(battery=0.1)
GIVEN_BACK = now(mode=Mode.GUIDED, obeys_modes=True)
FALLEN = now(mode=Mode.OTHER, armed=False, landed=Landed.ON_GROUND)
LED_ON = until(lambda craft: craft.state.reference.length_m > 2_000.0)
TAKES_OVER = until(lambda craft: craft.state.held_for in (*phases.TAKES_OVER, Reason.NO_PLAN))


def half_back(request: PlanRequest) -> PlanOutcome:
    """Half of the way back is proven, and no way home from there."""
    if request.flown is None:
        is_home = math.hypot(*request.target_ne_m) < 10.0
        return not_planned(request) if is_home else planned(request)
    north, east, up = here = request.scan_nea_m
    half = straight(here, (0.5 * north, 0.5 * east, up))
    return backtrack(request, half, reaches_start=False)


def is_found(aside_m: float) -> Callable[[Craft], None]:
    """So far to the north, all at once."""
    return lambda craft: setattr(craft, "here", (craft.here[0] + aside_m, *craft.here[1:]))


EARLIER = Reference(length_m=3_000.0, speed_m_s=90.0)
HOME_ZONE = CircleZone(name="z", north_m=0.0, east_m=0.0, radius_m=100.0)
FENCED_OFF = hears(events.FenceChanged, zones=(HOME_ZONE,))
CHECK, PARAMETER = "signing: none", "GUID_OPTIONS = 16"
LOSSES: dict[str, Callable[[Craft], object]] = {
    Reason.NO_FIX.text: now(fix=False),
    Reason.LINK_LOST.text: hears(events.LinkLost, silent_s=3.0),
    Reason.BATTERY_SHORT.text: now(
        context=Context(mission=replace(NEAR, endurance_s=600.0), seed=1), battery=0.1
    ),
    Reason.POSITION_JUMPED.text: now(here=(1e6, 0.0, HOME_AMSL_M)),
    Reason.OUTSIDE.text: FENCED_OFF,
    CHECK: hears(events.Prepared, item=events.Item.CHECKS, refusal=CHECK, remedy="x"),
    PARAMETER: hears(events.Prepared, item=events.Item.PARAMETERS, refusal=PARAMETER),
    Reason.NO_TARGETS.text: hears(events.TargetsChanged, targets_ne_m=()),
}
"""What may be lost while it waits for go, by what is said of it."""
NAMESAKE = hears(events.DuplicateId, certain=True, news=True)
LANDS_BY_ITSELF = now(mode=Mode.LAND, failsafe=True, obeys_modes=False)
FENCE_CHANGES = hears(events.FenceReading, items=5010)
FENCE_IS_READ = (hears(events.FenceChanged, zones=()), hears(events.FenceReading, items=0))


# --- what must be so


def arrives(craft: Craft) -> bool:
    return craft.end().outcome is Outcome.ARRIVED


def is_down(craft: Craft) -> bool:
    return craft.landed is Landed.ON_GROUND and not craft.armed


def is_home(craft: Craft) -> bool:
    return math.dist(craft.here[:2], craft.home_nea_m[:2]) < 100.0 and is_down(craft)


def back_by_itself(craft: Craft) -> bool:
    """Its autopilot returns, from where the way that was proven ends."""
    return craft.mode is Mode.RETURN and math.dist(craft.here[:2], OUT_NEA_M[:2]) < 1.0


def asked_for_no_way_home(craft: Craft) -> bool:
    """But for the way back: the origin of the map is nobody's home."""
    requests = [plan.request for plan in craft.sent(events.Plan)]
    return {r.target_ne_m for r in requests if r.flown is None} == set(AWAY.targets_ne_m)


def holds_for(reason: Reason) -> Callable[[Craft], bool]:
    return lambda craft: (craft.phase, craft.state.reason) == (HOLDING, reason)


def is_flying(craft: Craft) -> bool:
    return craft.phase is FLYING


def is_led_level(craft: Craft) -> bool:
    """Where it was when its landing was broken off."""
    heights = {round(each.position_nea_m[2]) for each in craft.sent(Setpoint)[-100:]}
    return heights == {round(craft.here[2])} and craft.here[2] > HOME_AMSL_M


def modes(craft: Craft) -> list[Mode]:
    """All that it was asked for."""
    return [each.mode for each in craft.sent(events.SetMode)]


def told_nothing(craft: Craft) -> bool:
    return not moving(craft.commands)


def ends(*why: Reason) -> Callable[[Craft], bool]:
    """For that, with what helps against the last of them."""
    said = ": ".join(reason.text for reason in why), why[-1].remedy
    return lambda craft: (craft.end().reason, craft.end().remedy) == said


def ends_as(outcome: Outcome, why: str) -> Callable[[Craft], bool]:
    return lambda craft: (craft.end().outcome, craft.end().reason) == (outcome, why)


def asks_for_the_whole_way(craft: Craft) -> bool:
    """That it has flown, for its way back."""
    flown = craft.sent(events.Plan)[-1].request.flown or ()
    apart_m = sum(each.until_m - each.from_m for each in flown) - math.hypot(*craft.here[:2])
    return abs(apart_m) < 0.01 * math.hypot(*craft.here[:2])


def is_told_50_m_off(craft: Craft) -> bool:
    """It stops within a tick."""
    said = texts(craft.commands)[-1].rpartition(f"{Reason.POSITION_ELSEWHERE.text}: ")[2]
    return 42.0 < float(said.split(" m ")[0]) < 58.0


def is_led_nowhere(craft: Craft) -> bool:
    """Nor does it plan."""
    return not [c for c in craft.during(30.0) if isinstance(c, Setpoint | events.Plan)]


def refuses(kind: OrderKind, why: str) -> Callable[[Craft], bool]:
    """Such an order, for now, and says why."""
    return lambda craft: (
        tell(craft, kind) is changes.OrderResult.NOT_NOW
        and why in changes.why_not(craft.state, order_of(craft, kind))
    )


IS_PAUSED, UNREAD = holds_for(Reason.PAUSED), holds_for(Reason.FENCE_UNREAD)
BACK = says(": flying back, then home")
EMPTY_ONCE = (hears(events.Battery, remaining=0.0), 2.0, hears(events.Battery, remaining=0.0), 2.5)
NO_PAUSE = refuses(PAUSE, f"pause refused: {Reason.BATTERY_LOW.text}")
TAKES_OFF = until(lambda craft: craft.sent(events.TakeOff))
ASKS_BACK = until(lambda craft: getattr(craft.state.stage, "backtrack", None))
PAUSED_BEFORE = (RETURN, now(plan=lambda _: None), ASKS_BACK, PAUSE, now(plan=home_or_on), 5.0)
STAYS_PAUSED = (400.0, IS_PAUSED, CONTINUE, RETURNING)


def answered(nth: int) -> Callable[[Craft], object]:
    """A way back for its last request, or for one before."""
    return lambda craft: craft.hear(
        events.PlanReady(
            time_s=craft.now_s, outcome=home_or_on(craft.sent(events.Plan)[nth].request)
        )
    )


ELSEWHERE_FOUND = (holds_for(Reason.POSITION_ELSEWHERE), lambda it: it.mode is Mode.HOLD)
BROKEN_OFF = (
    *(now(mode=Mode.GUIDED, failsafe=False), 120.0, IS_PAUSED, is_led_level),
    *(says("MISSION_START"), START, DONE, arrives, is_down),
)
STORIES: dict[str, tuple[Callable[[], Craft], *tuple[Step, ...]]] = {
    # a battery below its reserve
    "low, and started again": (under_way(fallback=Fallback.LAND),
        LOW, 3.0, Craft.restart, DONE, is_down),
    "low when it is given back": (under_way(),
        TAKEN, HOLDING, LOW, 10.0, GIVEN_BACK, DONE, is_home),
    "low, and told to return": (under_way(fallback=Fallback.HOLD), LOW, RETURN, DONE, is_home),
    "low in a pause on the way back": (under_way(fallback=Fallback.LAND),
        RETURN, RETURNING, 10.0, PAUSE, HOLDING, 20.0, IS_PAUSED, LOW, DONE, is_home),
    "low in a pause": (under_way(),
        PAUSE, HOLDING, 5.0, LOW, Reason.BATTERY_LOW, says(f"hold: {Reason.BATTERY_LOW.text}"),
        DONE, is_home, lambda it: it.end().outcome is Outcome.FAILED),
    "low after it was told to go on": (under_way(),
        now(plan=lambda r: not_planned(r) if r.flown is None else None), Reason.NO_PLAN, PAUSE,
        now(plan=planned), CONTINUE, FLYING, 20.0, LOW, Reason.BATTERY_LOW),
    "low while a pilot has it": (under_way(),
        TAKEN, HOLDING, LOW, 4.0, says(Reason.BATTERY_LOW.text), holds_for(Reason.MODE_TAKEN)),
    "a battery may say once that it is empty": (lambda: flying(AWAY),
        now(battery=0.8), *EMPTY_ONCE, *EMPTY_ONCE, is_flying,
        lambda it: it.state.path.stop is None),
    "what a battery says is believed after three seconds": (lambda: flying(AWAY),
        now(battery=0.19), 3.0, is_flying, lambda it: it.state.flight.fallen_back is None,
        until(lambda it: it.state.flight.fallen_back is Reason.BATTERY_LOW, 2.0)),
    "one word of a battery that falls silent is believed after ten": (lambda: flying(AWAY),
        hears(events.Battery, remaining=0.19), 9.5,
        lambda it: it.state.flight.fallen_back is None,
        until(lambda it: it.state.flight.fallen_back is Reason.BATTERY_LOW, 1.0)),
    "a pause that the battery would end at once": (under_way(fallback=Fallback.LAND),
        LOW, 5.0, NO_PAUSE, DONE, is_down),
    "a pause on the way back that the battery would end": (under_way(fallback=Fallback.LAND),
        RETURN, RETURNING, 10.0, LOW, 5.0, says(Reason.BATTERY_LOW.text), NO_PAUSE, DONE, is_down),
    # home is where the vehicle has it, and not where it was taken over
    "told to return": (taken_over, LED_ON, RETURN, DONE, is_home, BACK),
    "told to return at once": (taken_over, TAKES_OVER, RETURN, DONE, is_home,
        says(": planning a way home")),
    "at the last target": (lambda: taken_over(replace(NEAR, end_action=EndAction.RETURN)),
        DONE, is_home, arrives),
    "from where nothing leads away": (taken_over,
        LED_ON, now(plan=closed_in), DONE, lambda it: it.mode is Mode.RETURN,
        asked_for_no_way_home),
    "no home is known": (taken_over,
        now(home_nea_m=None), LED_ON, RETURN, DONE, back_by_itself, asked_for_no_way_home,
        says("home is not known"), says("told to return: its autopilot is told to return")),
    "home is off the map": (taken_over,
        now(home_nea_m=(0.0, 1e6, HOME_AMSL_M)), LED_ON, RETURN, DONE, back_by_itself,
        asked_for_no_way_home, says("home: it lies outside the map")),
    "home is told anew after a reboot": (under_way(),
        20.0, Craft.reboot, lambda it: setattr(it, "home_nea_m", it.here), FLYING,  # in the air
        RETURN, DONE, lambda it: math.hypot(*it.here[:2]) < 1.0),
    "half of the way back is proven, and no way home": (lambda: flying(AWAY, plan=half_back),
        20.0, RETURN, DONE, lambda it: it.mode is Mode.RETURN and RETURNING in it.phases,
        ends_as(Outcome.STOPPED, "its autopilot returns by itself: told to return")),
    **{f"told to return after a {again.__name__}, found in {found.value}": (under_way(),
        30.0, again, now(mode=found), 20.0, RETURN, ASKS_BACK, asks_for_the_whole_way)
        for again in (Craft.restart, Craft.reboot) for found in (Mode.GUIDED, Mode.HOLD)},
    "held without a gap while its way back is looked for": (under_way(),
        RETURN, RETURNING,
        lambda it: max(np.diff([each.time_s for each in it.sent(Setpoint)]).tolist()) < 0.15),
    # a pause gives back what it broke off
    "paused as it takes off": (Craft,  # from below the band nothing could be planned
        Phase.TAKING_OFF, 0.2, PAUSE, Reason.PAUSED, 5.0,
        lambda it: HOME_AMSL_M < it.here[2] < it.state.task.band_amsl_m[0], CONTINUE,
        until(lambda it: it.state.flight.plan_id > 0, 60.0), Phase.ARRIVED),
    "a return paused at once": (under_way(),
        RETURN, PAUSE, 2.0, CONTINUE, DONE, is_home,
        ends_as(Outcome.STOPPED, f"landed: {Reason.RETURN_ASKED.text}")),
    "a return paused before its answer": (under_way(), *PAUSED_BEFORE, answered(-1), *STAYS_PAUSED),
    "an answer to the first of two requests for its way back": (under_way(), *PAUSED_BEFORE,
        now(plan=lambda _: None), RETURN, ASKS_BACK, answered(-2), holds_for(Reason.RETURN_ASKED),
        answered(-1), RETURNING),
    "a return paused, and a restart": (under_way(), *PAUSED_BEFORE, Craft.restart, *STAYS_PAUSED),
    "a return for want of plans, paused": (under_way(fallback=Fallback.RETURN),
        now(plan=lambda r: not_planned(r) if r.flown is None else home_or_on(r)),
        RETURNING, 10.0, PAUSE, 1.0, CONTINUE, DONE, is_home),
    "at its target its nose stays where it was": (lambda: flying(AWAY),
        DONE, arrives, lambda it: abs(it.sent(Setpoint)[-1].yaw_rad - math.pi / 4) < 0.02),
    # plans, links, restarts and reboots
    "there is no plan at all": (lambda: Craft(plan=not_planned),
        DONE, is_down, lambda it: [p.request.attempt for p in it.sent(events.Plan)] == [0, 1, 2, 3],
        says(f"{Reason.NO_PLAN.text}: it broke floor")),
    "a plan is late": (
        lambda: flying(AWAY, plan=lambda r: planned(r) if r.plan_id == 1 else None),
        until(lambda it: len(it.sent(events.Plan)) == 2), 6.0, hears(events.PlanLate, plan_id=2),
        is_flying, HOLDING, holds_for(Reason.PLAN_LATE)),
    "it falls behind, and follows again": (flying,
        now(follows=False, velocity=(0.5, 0.5, 0.0)), 10.0,
        lambda it: it.sent(Setpoint)[-1].velocity_nea_m_s == (0.0, 0.0, 0.0), now(follows=True),
        70.0, lambda it: math.hypot(*it.velocity) > 149.9),
    "a second try succeeds": (
        lambda: flying(AWAY, plan=lambda r: not_planned(r) if r.plan_id == 2 else planned(r)),
        HOLDING, DONE, arrives),
    "the radar is silent over known land": (lambda: flying(AWAY),
        now(answered=0), HOLDING, holds_for(Reason.RADAR_SILENT), DONE, arrives),
    "in flight a radar that left something out is asked once": (lambda: flying(AWAY),
        now(answered=1, asked=2), until(lambda it: len(it.sent(events.Plan)) == 2),
        lambda it: len(it.sent(events.StartScan)) == 2),
    "from rest a radar that left something out is asked twice more": (Craft,
        now(asked=2), until(lambda it: it.sent(events.Plan)),
        lambda it: len(it.sent(events.StartScan)) == 3),
    "a fix where it cannot be": (lambda: Craft().fly_to(FLYING).run_for(10.0),
        now(fix=False), 3.0, now(fix=True), is_found(50.0), 15.0, *ELSEWHERE_FOUND,
        is_told_50_m_off, is_led_nowhere,
        is_found(-50.0), 10.0, is_flying),
    "the same while a pilot has it, who then gives it back": (
        lambda: Craft().fly_to(FLYING).run_for(10.0),
        now(mode=Mode.OTHER, fix=False), 3.0, now(fix=True), is_found(50.0), 10.0,
        now(mode=Mode.GUIDED), 5.0, *ELSEWHERE_FOUND, is_led_nowhere,
        is_found(-50.0), 10.0, is_flying),
    "in guided mode again while it still moves": (holding_without_fix,
        2.0, now(fix=True), 1.0, now(mode=Mode.GUIDED, follows=False, velocity=(0.8, 0.0, 0.0)),
        lambda it: events.SetMode(mode=Mode.HOLD) in it.during(2.0)),
    "the link comes back": (lambda: flying(NEAR),
        2.0, hears(events.LinkLost, silent_s=30.0), Reason.LINK_LOST, PREPARING, DONE, arrives),
    "its own hold is no person's after a restart": (under_way(),
        Craft.restart, until(lambda it: it.mode is Mode.HOLD), now(velocity=(0.0, 0.0, 0.0)),
        DONE, arrives),
    "a reboot at its target": (arrived, Craft.reboot, PREPARING, DONE, arrives),
    "a restart on a leg that it leaves earlier than is proven": (under_way(),
        1.0, lambda it: setattr(it.state.path, "leg", replace(it.state.leg, p_prog=EARLIER)),
        Craft.restart, lambda it: it.state.leg.successor_at_m == EARLIER.length_m),
    "a restart before it has lifted off": (lambda: Craft(NEAR),
        Phase.TAKING_OFF, Craft.restart, DONE, arrives),
    "a restart while it spins its motors up": (lambda: Craft(NEAR),
        now(takes_off=False, accepts=True), TAKES_OFF, 0.5, Craft.restart, 3.0,
        now(climb_to_m=NEAR.task.take_off_amsl_m), DONE, arrives),
    "without its memory": (under_way(),
        30.0, lambda it: it.restart(torn=True), DONE, arrives, says("without memory"),
        says("torn")),
    "without its memory on the ground": (Craft,
        lambda it: it.restart(torn=True), DONE, ends(Reason.GROUNDED), told_nothing),
    "armed before a restart, and nobody says go": (lambda: Craft().fly_to(Phase.ARMING),
        until(lambda it: it.armed), now(context=Context(mission=MISSION, seed=1)), Craft.restart,
        DONE,
        lambda it: it.state.reason is Reason.NOT_READY and not it.sent(events.TakeOff),
        lambda it: len(it.sent(events.Disarm)) > 0),
    "a reboot in its landing": (landing_begun, Craft.reboot, DONE, is_down),
    "a reboot in a landing that was ordered, which a pilot breaks off": (under_way(),
        LANDS, LANDING, 5.0, Craft.reboot, TAKEN, Reason.MODE_TAKEN, GIVEN_BACK, 20.0, IS_PAUSED,
        START, DONE, is_down, ends_as(Outcome.STOPPED, "landed: told to land")),
    "a landing asked for in vain": (lambda: arrived(LAND),
        now(obeys_modes=False), LANDING, now(mode=Mode.GUIDED), 5.0,
        lambda it: it.phase is LANDING, now(obeys_modes=True), DONE, is_down),
    "its autopilot says that it flies elsewhere": (lambda: flying(AWAY),
        *6 * (hears(events.Echo, position_nea_m=OUT_NEA_M), 0.5), says(Reason.NOT_TAKEN.text)),
    "it will not arm": (lambda: Craft(NEAR),
        now(arms=False), DONE, ends(Reason.NOT_ARMED), now(armed=True), 5.0,
        lambda it: (it.mode, it.here[2]) == (Mode.HOLD, HOME_AMSL_M)),
    "a take-off that is refused is asked for each second": (lambda: Craft(NEAR),
        now(takes_off=False), TAKES_OFF, 5.8, lambda it: len(it.sent(events.TakeOff)) == 6),
    "one that was accepted and does not begin is asked for again": (lambda: Craft(NEAR),
        now(takes_off=False, accepts=True), TAKES_OFF, 5.8,
        lambda it: len(it.sent(events.TakeOff)) == 2),
    "a take-off to 4 m above home has not ended as it lifts off": (lambda: Craft(NEAR),
        now(home_nea_m=(0.0, 0.0, NEAR.task.take_off_amsl_m - 4.0)), TAKES_OFF, now(climbs=False),
        hears(events.LandedState, landed=Landed.IN_AIR),
        lambda it: it.take(position(it.now_s + 0.05, (0.0, 0.0, NEAR.task.take_off_amsl_m - 3.7))),
        lambda it: it.phase is Phase.TAKING_OFF),
    # a landing that is broken off is held where it is until somebody says go on
    "broken off": (landing_begun, *BROKEN_OFF),
    "broken off after a restart": (landing_begun, Craft.restart, *BROKEN_OFF),
    "broken off by a pilot": (landing_begun, TAKEN, Reason.MODE_TAKEN, GIVEN_BACK, *BROKEN_OFF),
    "broken off by a failsafe": (landing_begun,
        now(mode=Mode.RETURN, failsafe=True), Reason.FAILSAFE, *BROKEN_OFF),
    "broken off by its fence": (landing_begun,
        hears(events.FenceBreach), now(mode=Mode.HOLD, obeys_modes=False), Reason.FENCE_BREACHED,
        GIVEN_BACK, *BROKEN_OFF),
    "its failsafe lands it": (flying,
        hears(events.Estimator, good=False), now(estimator=False), LANDS_BY_ITSELF, DONE,
        ends(Reason.DISARMED, Reason.FAILSAFE, Reason.ESTIMATOR)),
    "its failsafe lands it after it was held": (flying,
        now(estimator=False), HOLDING, LANDS_BY_ITSELF, DONE,
        ends(Reason.DISARMED, Reason.FAILSAFE, Reason.ESTIMATOR)),
    **{f"its failsafe is over{when}": (lambda: flying(AWAY),
        now(mode=Mode.RETURN, failsafe=True, obeys_modes=False), HOLDING, *again, Reason.FAILSAFE,
        now(fix=False), 5.0, now(failsafe=False, mode=Mode.HOLD), 5.0, says(FAILSAFE_OVER, 0),
        now(fix=True), 100.0, says(FAILSAFE_OVER, 1),
        holds_for(Reason.FAILSAFE), now(obeys_modes=True), START, DONE, arrives)
        for when, again in (("", ()), (" after a restart", (Craft.restart, 20.0)))},
    # orders
    "started where a pilot had it": (SITUATIONS["taken"],
        5.0, now(obeys_modes=True), START, 3.0, lambda it: it.mode is Mode.GUIDED, FLYING),
    "other targets, and then none": (under_way(),
        hears(events.TargetsChanged, targets_ne_m=ELSEWHERE),
        hears(events.TargetsChanged, targets_ne_m=()), Reason.NEW_TARGET, DONE,
        lambda it: math.dist(it.here[:2], ELSEWHERE[-1]) < 1.0),
    "told to return, taken and given back where there is no way back": (under_way(),
        RETURN, HOLDING, now(mode=Mode.HOLD, obeys_modes=False), Reason.MODE_TAKEN,
        now(obeys_modes=True), 10.0, START, Reason.RETURN_ASKED, now(plan=not_planned),
        Phase.HANDING_OVER),
    "told to return when its hold was asked for": (arrived,
        now(plan=home_or_on), until(lambda it: Mode.HOLD in modes(it)), RETURN,
        now(mode=Mode.HOLD), RETURNING),
    "its autopilot does not hold about its target": (arrived,
        now(obeys_modes=False), 5.0,
        lambda it: it.sent(events.SetMode)[-1] == events.SetMode(mode=Mode.HOLD)),
    "told to land": (under_way(),
        5.0, LANDS, is_flying, LANDING, lambda it: math.hypot(*it.velocity) < 0.5, DONE, is_down,
        lambda it: it.end().reason == "landed: told to land"),
    # a fence that has changed is held for until it is read
    "a fence is changed": (under_way(),
        FENCE_CHANGES, says("reading 5,010 items"), HOLDING, 153.0, UNREAD,
        lambda it: it.state.flight.failures == 0, *FENCE_IS_READ, FLYING),
    "a fence is never read": (under_way(fallback=Fallback.HOLD),
        FENCE_CHANGES, HOLDING, until(lambda it: it.phase is not HOLDING, 320.0),
        DONE, ends(Reason.FENCE_UNREAD)),
    "a fence that is read keeps it from its return": (under_way(),
        FENCE_CHANGES, HOLDING, RETURN, says("it returns once the changed fence is read"), 100.0,
        lambda it: it.phase is HOLDING, *FENCE_IS_READ, DONE, is_home),
    "a fence is read within seconds": (under_way(),
        hears(events.FenceReading, items=9), 2.0, *FENCE_IS_READ, 10.0, is_flying),
    "a mission that goes on meanwhile": (under_way(goes_on_while_reading=True),
        FENCE_CHANGES, says("reading 5,010 items"), 10.0, is_flying),
    "low, it does not wait for a fence": (under_way(),
        LOW, Reason.BATTERY_LOW, FENCE_CHANGES, 60.0, lambda it: it.phase is not HOLDING),
    "a fence that is read after a restart lies across its path": (flying,
        Craft.restart, PREPARING, lambda it: it.state.path is not None,
        hears(events.FenceChanged, zones=(replace(HOME_ZONE, north_m=7e3, east_m=7e3),)),
        until(lambda it: len(it.sent(events.Plan)) > 1),
        lambda it: it.sent(events.Plan)[-1].request.from_rest),
    "a fence on its way back in a pause": (under_way(),
        RETURN, RETURNING, 10.0, PAUSE, HOLDING, FENCED_OFF, 5.0, IS_PAUSED),
    # who says go, and to what
    "it is ready for as long as it takes": (ready,
        200.0, told_nothing, says("waits for go", 1), START, Phase.TAKING_OFF,
        lambda it: len(it.sent(events.Arm)) > 0),
    "its parameters are refused": (preparing,
        hears(events.Prepared, item=events.Item.PARAMETERS, refusal="A = 1", remedy="Set it."),
        DONE, lambda it: it.end().reason == f"{Reason.REFUSED.text}: A = 1",
        lambda it: it.end().remedy == "Set it."),
    "a go is not kept over a reboot": (ready,
        now(obeys_modes=False), START, Craft.reboot, READY, 30.0, now(fix=False),
        Craft.reboot, 150.0, lambda it: it.phase is PREPARING),
    "what is mended is ready again once it has been checked": (ready,
        now(fix=False), 20.0, now(fix=True), 2.0, lambda it: it.phase is PREPARING,
        hears(events.Prepared, item=events.Item.CHECKS), READY, START),
    **{f"ready, and then {why}": (ready,
        happens, PREPARING, says(f"not ready any more: {why}"), refuses(START, why), 200.0,
        lambda it: it.phase is PREPARING and len(it.sent(events.RequestStreams)) == 1,
        told_nothing)
        for why, happens in LOSSES.items()},
    "somebody arms it after a reboot, and keeps it": (lambda: Craft().fly_to(Phase.ARMING),
        until(lambda it: it.state.armed_by_us), Craft.reboot, now(armed=True, mode=Mode.OTHER),
        150.0, DONE, ends(Reason.ARMED_ALREADY)),
    "somebody arms what is ready": (ready,
        now(armed=True, mode=Mode.GUIDED), DONE, ends(Reason.ARMED_ALREADY), told_nothing),
    "a pilot's mode before its take-off is broken off": (lambda: Craft().fly_to(Phase.ARMING),
        LANDS, hears(events.VehicleStatus, mode=Mode.OTHER, armed=False, failsafe=False),
        lambda it: not moving(it.take(*(events.Tick(time_s=it.now_s + s) for s in (1.0, 2.0))))),
    # another companion of the same vehicle is heard: on the ground both refuse
    "another companion before it is armed": (lambda: Craft().fly_to(Phase.ARMING),
        now(arms=False), 2.0, NAMESAKE, DONE, ends(Reason.NOT_ALONE),
        lambda it: not it.sent(events.TakeOff)),
    "another companion in flight": (under_way(),
        NAMESAKE, *20 * (1.0, hears(events.DuplicateId, certain=True, news=False)),
        says(f"{Reason.NOT_ALONE.text}: end it", 1), DONE, arrives),
    # it is stopped
    "stopped in a landing for want of plans": (
        lambda: Craft(replace(NEAR, fallback=Fallback.LAND), plan=closed_in),
        LANDING, hears(events.StopAsked), DONE, ends(Reason.STOPPED)),
    # what falls meanwhile is never armed again
    "fallen in a reboot": (under_way(), Craft.reboot, FALLEN, 150.0, DONE),
    "fallen in a restart": (under_way(), Craft.restart, FALLEN, 150.0, DONE),
}  # fmt: skip


@pytest.mark.parametrize("story", STORIES)
def test_a_flight_ends_as_its_user_expects(story: str) -> None:
    begins, *script = STORIES[story]
    told(begins(), *script)


# --- a flight that cannot go on: never in the air, unless the mission or a person says so

HANDED = "its autopilot returns by itself"


def no_plan(of: Mission) -> Craft:
    return flying(of, plan=only_the_first)


FAILURES: dict[Reason, tuple[Callable[[Mission], Craft], *tuple[Step, ...]]] = {
    Reason.NO_PLAN: (no_plan,),
    Reason.RADAR_SILENT: (no_plan, now(answered=0)),
    Reason.BATTERY_LOW: (no_plan, now(battery=0.1)),
    Reason.NOT_FOLLOWING: (flying, now(follows=False, velocity=(0.0, 0.0, 0.0))),
    Reason.NO_FIX: (holding_without_fix,),
}


def fails(failure: Reason, fallback: Fallback) -> Craft:
    begins, *script = FAILURES[failure]
    return told(begins(replace(AWAY, fallback=fallback)), *script)


@pytest.mark.parametrize("failure", FAILURES, ids=lambda reason: reason.name)
@pytest.mark.parametrize("fallback", Fallback)
def test_a_flight_that_fails_ends_by_its_fallback(failure: Reason, fallback: Fallback) -> None:
    """No way back is proven: its autopilot returns; but what does not know where it is lands.

    That is said before it is done.
    """
    craft = fails(failure, fallback).fly_to(DONE)
    assert craft.end().outcome is Outcome.FAILED
    if fallback is Fallback.HOLD:
        assert (craft.mode, craft.armed) == (Mode.HOLD, True)
        assert not {Mode.RETURN, Mode.LAND} & set(modes(craft))
        return
    why = failure.text + ": it broke floor" * (failure is Reason.NO_PLAN)
    mode, how, end = Mode.LAND, "landing here", "landed"
    if fallback is Fallback.RETURN and failure is not Reason.NO_FIX:
        mode, how, end = Mode.RETURN, "its autopilot is told to return", HANDED
    assert f"{why}: {how}" in texts(
        craft.commands[: craft.commands.index(events.SetMode(mode=mode))]
    )
    assert (Mode.RETURN in modes(craft), craft.armed) == (mode is Mode.RETURN,) * 2
    assert (craft.mode, craft.end().reason) == (mode, f"{end}: {why}")


@pytest.mark.parametrize("obeys", [True, False])
@pytest.mark.parametrize("how", [Fallback.RETURN, Fallback.LAND])
def test_who_does_not_take_the_one_is_asked_for_the_other(how: Fallback, obeys: bool) -> None:
    """Or, if that is in vain, to hold, and a person to take over."""
    phases = [(Phase.HANDING_OVER, Mode.RETURN), (LANDING, Mode.LAND)]
    first, second = phases if how is Fallback.RETURN else reversed(phases)
    script = (first[0], now(obeys_modes=False), second[0], now(obeys_modes=obeys), DONE)
    craft = told(fails(Reason.NOT_FOLLOWING, how), *script)
    if obeys:
        assert craft.mode is second[1]
        assert craft.end().reason.partition(": ")[0] in ("landed", HANDED)
    else:
        asked = [mode for mode, _ in itertools.groupby(modes(craft))]
        assert asked[-3:] == [first[1], second[1], Mode.HOLD]
        assert craft.end().reason == Reason.NOT_OBEYING.text
        assert "by hand" in craft.end().remedy


@pytest.mark.parametrize("refusal", Refusal)
def test_a_hold_for_want_of_a_plan_says_why_and_the_end_what_helps(refusal: Refusal) -> None:
    """In the planner's own words, also if the companion is started again in the landing."""
    land = replace(AWAY, fallback=Fallback.LAND)
    craft = Craft(land, plan=lambda asked: NotPlanned(plan_id=asked.plan_id, refusal=refusal))
    end = told(craft, LANDING, Craft.restart, DONE).end()
    why, _, remedy = refusal.value.partition("; ")
    said = Reason.NO_PLAN.text + (f": {why}" if refusal is not Refusal.NOTHING_SAFE else "")
    assert next(c.warning for c in craft.sent(events.StatusText) if c.text == f"hold: {said}")
    assert (end.outcome, end.reason) == (Outcome.FAILED, f"landed: {said}")
    assert end.remedy.lower() == f"{remedy}.".lower() != Reason.NO_PLAN.remedy.lower()


def test_what_was_flown_of_the_way_back_before_a_pause_is_not_left_to_fly() -> None:
    back = flying(AWAY, plan=home_or_on)
    craft = told(back, RETURN, RETURNING, 10.0, PAUSE, HOLDING, 5.0)
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
