"""Right of way of one vehicle: what it enters it has claimed, and every wait has an end."""

import math
from collections.abc import Callable
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from made_up import planned
from renewed import replace
from wild import Wild

from companion.geodesy import FloatArray
from companion.mavlink.autopilots import ALL, ARDUCOPTER
from companion.mission import following
from companion.mission.events import (
    ClaimWay,
    Order,
    OrderKind,
    OthersHeard,
    PlanReady,
    Setpoint,
    StatusText,
    Vector,
)
from companion.mission.mission import TrafficRules
from companion.mission.state import Phase, Reason, Traffic
from companion.mission.traffic import limits, observe
from companion.mission.vehicle_traits import VehicleTraits
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg
from companion.world.traffic import CLAIM_S, STRAIGHT_M, Claim, Track

OURS = 2
RULES = TrafficRules(separation_m=20.0, vertical_separation_m=10.0)
FAR = (640.0, 480.0)  # 800 m off, in the direction ALONG
ALONG = (0.8, 0.6)
SEEN = TrafficRules(claims=False)
PLANES = pytest.mark.parametrize(
    "traits", [each.traits for each in ALL if not each.traits.hovers], ids=lambda d: d.name
)
BOTH = pytest.mark.parametrize(
    "traits", [ARDUCOPTER.traits, ALL[-1].traits], ids=["copter", "plane"]
)
Heard = tuple[tuple[Track, ...], tuple[Claim, ...]]
SPREAD = (150.0, 150.0, 15.0)
NOBODY: Heard = ((), ())


def test_the_two_of_both_are_a_copter_and_a_plane() -> None:
    assert ARDUCOPTER.traits.hovers
    assert not ALL[-1].traits.hovers


class Among:
    """A calm vehicle among others: what it was, flew and claimed."""

    def __init__(
        self,
        traits: VehicleTraits,
        rules: TrafficRules = RULES,
        targets: tuple[tuple[float, float], ...] = (FAR,),
        others: Callable[[float], Heard] = lambda _now_s: NOBODY,
        ours: int = OURS,
        **limits: float,
    ) -> None:
        number = next(k for k, each in enumerate(ALL) if each.traits is traits)
        task = Wild(number).mission.task
        task = replace(task, claim_s=2.0 * CLAIM_S + 2.0, limits=replace(task.limits, **limits))
        self.wild = Wild.calmly(traits, traffic=rules, targets_ne_m=targets, task=task)
        self.wild.towards = lambda request: planned(request, 600.0)  # type: ignore[method-assign]
        self.others, self.ours = others, ours
        self.places: list[tuple[float, Phase, bool, Vector]] = []
        """When, in which phase, whether on a leg, where."""

    def tick(self) -> None:
        wild = self.wild
        tracks, claims = self.others(wild.now_s)
        heard = OthersHeard(time_s=0.0, ours=self.ours, tracks=tracks, claims=claims)
        wild.later.append((-math.inf, heard))
        wild.tick()
        state = wild.state
        self.places.append((wild.now_s, state.phase, state.flight.leg is not None, wild.here))

    def run_until(self, done: Callable[[Wild], bool], limit_s: float = 900.0) -> "Among":
        until_s = self.wild.now_s + limit_s
        while not done(self.wild):
            assert self.wild.now_s < until_s, f"nothing after {limit_s} s: {self.wild.state.phase}"
            self.tick()
        return self

    def run_for(self, seconds: float) -> "Among":
        until_s = self.wild.now_s + seconds - 1e-6
        return self.run_until(lambda wild: wild.now_s >= until_s)

    def fly_to(self, phase: Phase) -> "Among":
        return self.run_until(lambda wild: wild.state.phase is phase)

    def said(self) -> list[str]:
        return [each.text for each in self.wild.sent(StatusText)]

    def is_at_m(self, metres: float) -> Callable[[Wild], bool]:
        return lambda wild: wild.state.flight.reference.length_m >= metres

    def unclaimed_m(self) -> float:
        """How far it has been, on a leg, from any stretch that it claimed in the second before."""
        claims, worst_m, first = self.wild.sent(ClaimWay), 0.0, 0
        for now_s, phase, on_leg, place in self.places:
            if phase is not Phase.FLYING or not on_leg:
                continue
            while claims[first].time_s < now_s - 1.0:
                first += 1
            for claim in claims[first:]:
                if claim.time_s > now_s:
                    break
                worst_m = max(worst_m, off_m(claim, place))
        return worst_m


def off_m(claim: ClaimWay, place: Vector) -> float:
    """Distance of a place from a claim."""
    begin, end = claim.begin_nea_m, claim.end_nea_m
    way = [b - a for a, b in zip(begin, end, strict=True)]
    from_it = [b - a for a, b in zip(begin, place, strict=True)]
    squared = max(sum(w * w for w in way), 1e-9)
    share = sum(w * f for w, f in zip(way, from_it, strict=True)) / squared
    share = min(max(share, 0.0), 1.0)
    return math.dist([a + share * w for a, w in zip(begin, way, strict=True)], place)


def claim_at(along_m: float, now_s: float, system: int = 1, height_m: float = 3030.0) -> Claim:
    """Somebody stands on the way to FAR."""
    place = (along_m * ALONG[0], along_m * ALONG[1], height_m)
    return Claim(system=system, heard_s=now_s, begin_nea_m=place, end_nea_m=place)


def aircraft(now_s: float, place: Vector, climb_m_s: float = 0.0, **changes: Any) -> Track:
    track = Track(
        name="ADS-B 4B1234",
        time_s=now_s,
        position_nea_m=place,
        velocity_nea_m_s=(0.0, 0.0, climb_m_s),
        error_m=5.0,
        error_up_m=5.0,
        growth_m_s=0.1,
        growth_up_m_s=0.1,
    )
    return replace(track, **changes)


# --- claims


@BOTH
def test_what_is_entered_has_been_claimed_for_a_second(traits: VehicleTraits) -> None:
    among = Among(traits).fly_to(Phase.ARRIVED)
    limits = among.wild.mission.task.limits
    aside_m = 0.1 if limits.hovers else 2.0 * limits.loiter_radius_m  # it leaves its circle so
    assert among.unclaimed_m() <= aside_m + 2.0
    claims = among.wild.sent(ClaimWay)
    begun = next(c for c in claims if math.dist(c.begin_nea_m[:2], c.end_nea_m[:2]) > 5.0)
    sets_out_s = next(
        at_s
        for at_s, phase, on_leg, place in among.places
        if phase is Phase.FLYING and on_leg and math.dist(place, begun.begin_nea_m) > aside_m
    )
    assert sets_out_s - begun.time_s >= 1.0
    lengths = [math.dist(c.begin_nea_m, c.end_nea_m) for c in claims]
    assert max(lengths) < 300.0  # of 800 m
    times = [claim.time_s for claim in among.run_for(10.0).wild.sent(ClaimWay)]
    assert min(b - a for a, b in pairwise(times)) > 0.15  # on setpoints or not


def bent(wild: Wild, leg: Leg) -> PlanReady:
    """A successor that turns off at a right angle at p_prog."""
    task = wild.state.task
    start = leg.subpath.pose(leg.successor_at_m(task))
    north, east, _ = start.tangent_nea.tolist()
    ahead = np.linspace(0.0, 300.0, 4)[:, None] * np.array([-east, north, 0.0])
    later = [event for _, event in wild.later if isinstance(event, PlanReady)]
    [ready] = later
    outcome = replace(ready.outcome, subpath=Subpath(control_nea_m=start.position_nea_m + ahead))
    return replace(ready, outcome=replace(outcome, reaches_target=True))


@pytest.mark.parametrize(
    ("before_m", "taken"), [(35.0, True), (25.0, True), (18.0, False), (3.0, False)]
)
def test_no_path_is_changed_nearer_than_where_a_vehicle_can_claim_it_before(
    before_m: float, taken: bool
) -> None:
    """10 m/s and 2.5 m/s2: it needs 20 m to stop."""
    among = Among(ARDUCOPTER.traits)
    wild = among.wild
    among.run_until(
        lambda wild: (
            any(isinstance(e, PlanReady) for _, e in wild.later)
            and wild.state.flight.leg is not None
        )
    )
    leg = wild.state.flight.leg
    assert leg is not None
    ready = bent(wild, leg)
    wild.later = [each for each in wild.later if not isinstance(each[1], PlanReady)]
    among.run_until(among.is_at_m(leg.successor_at_m(wild.state.task) - before_m))
    wild.take(replace(ready, time_s=wild.now_s))
    assert (wild.state.flight.next_leg is not None) is taken
    wild.bad_plans = 1.0
    among.run_for(12.0)
    assert among.unclaimed_m() <= 2.0


# --- planes


@pytest.mark.sample(2)
@PLANES
def test_a_plane_waits_on_its_circle_until_the_way_is_free(traits: VehicleTraits) -> None:
    freed_s = math.inf

    def others(now_s: float) -> Heard:
        return (), () if now_s > freed_s else (claim_at(700.0, now_s),)

    among = Among(traits, others=others, ceiling_amsl_m=3080.0)  # no other level
    wild, limits = among.wild, among.wild.mission.task.limits
    among.run_until(lambda wild: wild.state.flight.reference.length_m > 0.0)
    first = wild.state.flight.leg
    among.run_until(lambda wild: wild.state.reason is Reason.GIVING_WAY)
    among.run_for(60.0)  # at 20 m/s it would be there long before
    circle = wild.state.flight.hover_nea_m
    assert circle is not None
    assert math.hypot(*circle[:2]) > 100.0  # it had set out
    waited = [place for at_s, _, _, place in among.places if at_s > wild.now_s - 45.0]
    assert max(math.dist(place[:2], circle[:2]) for place in waited) <= 1.5 * limits.loiter_radius_m
    sent = [c for c in wild.sent(Setpoint) if c.time_s > wild.now_s - 45.0]
    assert {(c.stay, c.position_nea_m) for c in sent} == {(True, circle)}
    assert first is not None
    start, end = first.subpath.pose(0.0).point_nea_m, (*FAR, circle[2])
    on_path = ClaimWay(time_s=0.0, begin_nea_m=start, end_nea_m=end)
    assert off_m(on_path, circle) < 1.0  # whose circles are proven
    ends = [c.end_nea_m for c in wild.sent(ClaimWay)]
    apart_m = RULES.separation_m + 2.0 * limits.loiter_radius_m
    assert max(end[0] * ALONG[0] + end[1] * ALONG[1] for end in ends) < 700.0 - apart_m
    texts = [text for text in among.said() if "giving way" in text]
    assert any(text.endswith("system 1") for text in texts)
    assert len(texts) < 4
    freed_s = wild.now_s
    among.run_until(lambda wild: wild.state.flight.reference.length_m > 0.0, limit_s=60.0)
    among.fly_to(Phase.ARRIVED)


@pytest.mark.sample(2)
@PLANES
def test_a_plane_before_which_nobody_is_does_not_wait(traits: VehicleTraits) -> None:
    among = Among(traits, others=lambda now_s: ((), (claim_at(1300.0, now_s),)))
    among.fly_to(Phase.ARRIVED)
    assert not any("giving way" in text or "hold" in text for text in among.said()[3:])
    assert among.wild.state.flight.legs_flown > 1  # past a join


@pytest.mark.sample(2)
@PLANES
def test_a_plane_told_to_return_waits_where_it_is_and_comes_home(traits: VehicleTraits) -> None:
    freed_s = math.inf

    def others(now_s: float) -> Heard:
        near = claim_at(-150.0, now_s)
        return (), (near,) if now_s < freed_s and back else ()

    back = False
    among = Among(traits, others=others).run_until(lambda w: math.hypot(*w.here[:2]) > 420.0)
    back, wild = True, among.wild
    wild.take(Order(time_s=wild.now_s, kind=OrderKind.RETURN))
    among.fly_to(Phase.RETURNING).run_for(20.0)
    from_m = math.hypot(*wild.here[:2])
    among.run_for(90.0)
    assert math.hypot(*wild.here[:2]) > 150.0  # outside of the others' claim and both circles
    changes = sum(a[1] is not b[1] for a, b in pairwise(among.places[-900:]))
    assert changes <= 2, "one wait, not one every few seconds"
    assert from_m > 150.0
    freed_s = wild.now_s
    start = next(place for _, _, on_leg, place in among.places if on_leg)
    among.run_until(lambda w: math.dist(w.here, start) < 100.0, limit_s=120.0)


@PLANES
def test_a_plane_is_sent_to_no_point_that_it_may_not_enter(traits: VehicleTraits) -> None:
    """In a tail wind it flies faster over the ground than V, and is sent farther ahead."""
    among = Among(traits).run_until(lambda w: w.state.flight.reference.length_m > 50.0)
    state = among.wild.state
    assert state.traffic is not None
    fast = replace(state.vehicle, velocity_nea_m_s=(30.0, 10.0, 0.0))
    most_m = min(traits.lead_s * math.hypot(30.0, 10.0), 1.3 * state.task.limits.lead_m)
    for left_m in (0.0, 40.0, 90.0, 500.0):
        traffic = replace(state.traffic, committed_m=state.traffic.flown_m + left_m)
        windy = replace(state, vehicle=fast, traffic=traffic)
        lead_m = following.lead_m(windy, state.flight.reference)
        assert lead_m == pytest.approx(min(left_m, most_m))


# --- tracks, and out of the way


class Above:
    """An aircraft over the vehicle, from some time on: at first that low that it must make way."""

    def __init__(self) -> None:
        self.tracks: tuple[Track, ...] = ()

    def __call__(self, now_s: float) -> Heard:
        return tuple(replace(track, time_s=now_s) for track in self.tracks), ()


def to_a_level() -> tuple[Among, Above]:
    """A copter that is about to leave for another level."""
    above = Above()
    among = Among(ARDUCOPTER.traits, SEEN, others=above)
    wild = among.run_until(lambda w: w.state.flight.reference.length_m > 60.0).wild
    north, east, height_m = wild.here
    above.tracks = (aircraft(wild.now_s, (north, east, height_m), error_m=300.0),)
    among.run_until(lambda w: w.state.traffic is not None and w.state.traffic.level_m is not None)
    return among.run_for(0.5), above


def on_its_way_to_a_level() -> tuple[Among, Above]:
    among, above = to_a_level()
    among.run_until(lambda w: w.state.traffic is not None and w.state.traffic.climbs)
    return among.run_for(1.0), above


def test_a_copter_stops_on_the_way_to_a_level_that_is_free_no_longer() -> None:
    among, above = on_its_way_to_a_level()
    wild = among.wild
    assert wild.state.traffic is not None
    level_m, height_m = wild.state.traffic.level_m, wild.here[2]
    assert level_m is not None
    assert abs(level_m - height_m) > 10.0
    north, east, _ = wild.here
    above.tracks = (aircraft(wild.now_s, (north, east, level_m), error_m=300.0),)
    among.tick()
    assert wild.state.traffic.level_m != level_m
    towards = math.copysign(1.0, level_m - height_m)
    among.run_for(20.0)
    heights = [place[2] for *_, place in among.places[-200:]]
    assert max(towards * (height - height_m) for height in heights) < 2.0


def test_a_return_ordered_before_it_leaves_for_a_level_is_carried_out() -> None:
    among, above = to_a_level()
    among.wild.take(Order(time_s=among.wild.now_s, kind=OrderKind.RETURN))
    above.tracks = ()
    among.run_until(lambda w: w.state.phase is not Phase.HOLDING, limit_s=20.0)


def test_a_copter_goes_on_by_itself_from_the_level_that_it_went_to() -> None:
    among, above = on_its_way_to_a_level()
    left_m = among.wild.here[2]
    among.run_until(lambda w: w.state.flight.leg is not None, limit_s=60.0)
    assert abs(among.wild.here[2] - left_m) > 5.0
    assert above.tracks
    above.tracks = ()
    among.fly_to(Phase.ARRIVED)


def test_a_copter_stays_where_it_is_if_an_aircraft_has_passed_before_it_could_be_elsewhere() -> (
    None
):
    """It is gone in ten seconds; its height is known to 40 m only: a free level is 20 s away."""
    tracks: tuple[Track, ...] = ()
    among = Among(ARDUCOPTER.traits, SEEN, others=lambda _now_s: (tracks, ()))
    wild = among.run_until(lambda w: w.state.flight.reference.length_m > 60.0).wild
    (north, east, height_m), seen_s = wild.here, wild.now_s
    comes = {"velocity_nea_m_s": (30.0, 0.0, 0.0), "error_m": 200.0, "error_up_m": 40.0}
    tracks = (aircraft(seen_s, (north - 60.0, east, height_m), **comes),)
    stood = False
    while wild.now_s < seen_s + 15.0:
        among.tick()
        assert wild.state.traffic is not None
        stood = stood or wild.state.traffic.forced_since_s < wild.now_s
        assert wild.state.traffic.level_m is None
    assert stood
    among.fly_to(Phase.ARRIVED)


def test_a_copter_whose_way_is_closed_at_every_level_makes_room_at_one_after_the_other() -> None:
    """Somebody may need the level at which it waits: of four in a knot nobody went on for good."""

    def others(now_s: float) -> Heard:
        if not closed:
            return NOBODY
        foot, top = ((0.3 * FAR[0], 0.3 * FAR[1], height_m) for height_m in (0.0, 9000.0))
        return (), (Claim(system=1, heard_s=now_s, begin_nea_m=foot, end_nea_m=top),)

    closed = True
    among = Among(ARDUCOPTER.traits, others=others)
    wild = among.run_until(lambda w: w.state.flight.reference.speed_m_s > 5.0).wild
    among.run_until(lambda w: w.state.flight.reference.speed_m_s == 0.0)
    stood_s = wild.now_s
    among.run_for(90.0)
    waits = [(now_s, round(place[2])) for now_s, _, on_leg, place in among.places if on_leg]
    assert len({height_m for now_s, height_m in waits if 0.0 < now_s - stood_s < 55.0}) == 1
    assert len({height_m for now_s, height_m in waits if now_s > stood_s}) > 1
    closed = False
    among.fly_to(Phase.ARRIVED)


@pytest.mark.parametrize(
    ("traits", "count", "radius_m", "ceiling_amsl_m"),
    [
        (ARDUCOPTER.traits, 3, 150.0, 3045.0),  # none has room above or below
        (ALL[-1].traits, 4, 600.0, 3150.0),
    ],
    ids=["copters", "planes"],
)
def test_all_whose_ways_cross_in_one_point_get_through_one_after_the_other(
    traits: VehicleTraits, count: int, radius_m: float, ceiling_amsl_m: float
) -> None:
    """Copters that came near the point before, and all planes, stood in the way for good."""
    said: dict[int, Claim] = {}
    fleet: dict[int, Among] = {}
    for system in range(1, count + 1):
        turn = math.tau * system / count
        north, east = radius_m * math.cos(turn), radius_m * math.sin(turn)

        def others(_now_s: float, ours: int = system) -> Heard:
            return (), tuple(said[each] for each in said if each != ours)

        fleet[system] = Among(
            traits,
            targets=((-north, -east),),
            others=others,
            ours=system,
            ceiling_amsl_m=ceiling_amsl_m,
        )
        fleet[system].wild.here = (north, east, 3000.0)
    while not all(among.wild.state.phase is Phase.DONE for among in fleet.values()):
        for system, among in fleet.items():
            among.tick()
            now_s, sent = among.wild.now_s, reversed(among.wild.said_to)
            assert now_s < 200.0
            for claim in (each for each in sent if isinstance(each, ClaimWay)):
                ends = {"begin_nea_m": claim.begin_nea_m, "end_nea_m": claim.end_nea_m}
                said[system] = Claim(system=system, heard_s=now_s, **ends)
                break
        for here, there in combinations([among.wild.here for among in fleet.values()], 2):
            above = abs(here[2] - there[2]) > RULES.vertical_separation_m
            assert above or math.dist(here[:2], there[:2]) > RULES.separation_m


def test_who_goes_to_another_level_leaves_room_for_what_others_may_have_entered() -> None:
    """Of claims that lead by where it stands and end over or under it, drawn at random."""
    among = Among(ARDUCOPTER.traits, others=lambda now_s: ((), (claim_at(80.0, now_s),)))
    among.run_until(lambda wild: wild.state.phase is Phase.FLYING and bool(wild.sent(Setpoint)))
    among.run_for(15.0)
    state, context = among.wild.state, among.wild.context
    traffic, now_s, here = state.traffic, state.now_s, np.array(state.vehicle.position_nea_m)
    assert traffic is not None
    errors_m = 2.0 * state.task.error_m
    kept_m = np.array([RULES.separation_m, RULES.vertical_separation_m]) + errors_m

    def is_near(places: FloatArray, low_m: float, high_m: float, bends_m: float) -> FloatArray:
        level_m = np.hypot(*(places - here)[:, :2].T)
        up_m = np.maximum(np.maximum(low_m - places[:, 2], places[:, 2] - high_m), 0.0)
        return (level_m < kept_m[0] + bends_m) & (up_m < kept_m[1] + bends_m)

    rng, gone = np.random.default_rng(0), 0
    for _ in range(300):
        turn, side = rng.uniform(0.0, math.tau), rng.choice([-1.0, 1.0])
        far_m, high_m = kept_m * rng.uniform(0.7, 1.5, 2)
        edge = here + [far_m, far_m, side * high_m] * np.array(
            [math.cos(turn), math.sin(turn), 1.0]
        )
        end = here + rng.uniform([-20.0, -20.0, 0.0], [20.0, 20.0, 40.0]) * [1.0, 1.0, side]
        end[2] += side * high_m
        begin = edge - rng.uniform(0.3, 1.5) * (end - edge)
        way = np.linspace(begin, end, 200)
        blocked = is_near(way, here[2], here[2], 4.0 * STRAIGHT_M)
        if blocked[0]:
            continue  # it is not where the vehicle stands
        system = int(rng.choice([1, 3]))
        ends = {"begin_nea_m": tuple(begin.tolist()), "end_nea_m": tuple(end.tolist())}
        claims = (Claim(system=system, heard_s=now_s, **ends),)
        among_it = replace(traffic, claims=claims, level_m=None, moved_at_s=now_s - 50.0)
        after = observe(replace(state, traffic=among_it), context)[0].traffic
        assert after is not None
        if (level_m := after.level_m) is None:
            continue
        gone += 1
        entered = way[: int(blocked.argmax())] if blocked.any() else way
        assert not is_near(entered, min(here[2], level_m), max(here[2], level_m), 0.0).any()
    assert gone > 100


def test_who_is_named_is_in_the_way() -> None:
    """Not a nearer one that has agreed on who flies where."""

    def others(now_s: float) -> Heard:
        ahead = aircraft(now_s, (200.0 * ALONG[0], 200.0 * ALONG[1], 3030.0))
        aside = aircraft(now_s, (-300.0, -40.0, 3030.0), name="system 9", system=9)
        return (ahead, aside), (claim_at(-300.0, now_s, system=9),)

    among = Among(ARDUCOPTER.traits, others=others).run_for(30.0)
    named = [text for text in among.said() if "giving way" in text]
    assert named
    assert all(text.endswith(": ADS-B 4B1234") for text in named)


def test_what_a_copter_cannot_stop_before_is_its_own() -> None:
    """Led back to its path after a restart it is in flight, and has claimed nothing yet."""
    among = Among(ARDUCOPTER.traits).run_until(lambda w: w.state.flight.reference.speed_m_s > 9.99)
    state = replace(among.wild.state, traffic=Traffic(rules=RULES, ours=OURS))
    after, _ = observe(state, among.wild.context)
    assert after.traffic is not None
    until_m, speed_m_s = limits(after, None, math.inf)
    assert until_m == pytest.approx(state.flight.reference.length_m + 20.0, abs=0.1)
    assert speed_m_s == pytest.approx(10.0, abs=0.02)


@BOTH
@pytest.mark.sample(5)  # of both kinds
@pytest.mark.parametrize("seed", range(4))
def test_whatever_others_do_it_goes_on_once_they_are_gone(traits: VehicleTraits, seed: int) -> None:
    rng = np.random.default_rng(seed)

    def others(now_s: float) -> Heard:
        if now_s > 150.0:
            return NOBODY
        if rng.random() < 0.05:
            drawn.clear()
            for system in range(1, int(rng.integers(1, 5))):
                near = [wild.here[k] + float(rng.normal(0.0, s)) for k, s in enumerate(SPREAD)]
                far = [near[k] + float(rng.normal(0.0, s)) for k, s in enumerate(SPREAD)]
                velocity = tuple(float(v) for v in rng.normal(0.0, (20.0, 20.0, 3.0)))
                drawn.append((system, tuple(near), tuple(far), velocity))
        late_s = float(rng.choice([0.0, 0.0, 2.0]))
        claims = [
            Claim(system=system, heard_s=now_s - late_s, begin_nea_m=near, end_nea_m=far)
            for system, near, far, _ in drawn
            if system % 2
        ]
        tracks = [
            aircraft(now_s, near, velocity_nea_m_s=velocity)
            for system, near, _, velocity in drawn
            if not system % 2
        ]
        return tuple(tracks), tuple(claims)

    drawn: list[Any] = []
    among = Among(traits, others=others)
    wild = among.wild
    among.run_until(lambda w: w.now_s > 150.0).run_until(lambda w: w.over, limit_s=400.0)
    assert wild.watch.phases & {Phase.ARRIVED, Phase.DONE}
    assert Phase.FAULTED not in wild.watch.phases
