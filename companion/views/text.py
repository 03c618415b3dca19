"""A mission as text; a flight, its plans and the checks before it as tables."""

import itertools
import math
import statistics
from collections.abc import Iterator

import numpy as np
from rich.table import Column, Table
from rich.text import Text

from companion.geodesy import FloatArray
from companion.mavlink.checks import Check, CheckStatus
from companion.mission.events import Outcome
from companion.mission.mission import EndAction, Mission
from companion.path.certificate import Certificate
from companion.planner.request import Planned
from companion.telemetry.flight_summary import FlightSummary
from companion.views.words import at_least, counted, metres, metres_at_least, number

_COLOURS = {CheckStatus.PASSED: "green", CheckStatus.NOTED: "yellow", CheckStatus.REFUSED: "red"}
_LAST = {
    EndAction.HOLD: "hold there",
    EndAction.LAND: "land there",
    EndAction.RETURN: "come back along the flown path",
}

_STRAIGHT_M = 100_000.0  # a radius from which on nobody sees a bend


def mission_summary(mission: Mission) -> str:
    """Summary of a mission, as text for the operator."""
    task, limits, settings = mission.task, mission.task.limits, mission.task.settings
    who = ", ".join(f"{system}/{component}" for system, component in mission.commanders)
    circles = "" if limits.hovers else f"; holds on circles of {metres(limits.loiter_radius_m)}"
    inner = sum(zone.keep_in for zone in task.zones)
    own = ", the vehicle's own fence" if mission.fence_from_vehicle else ""
    proven = "proven safe before it is flown" if settings.profile.verified else "flown unproven"
    climb_deg, dive_deg = map(math.degrees, (limits.climb_angle_rad, limits.dive_angle_rad))
    rows = {
        "vehicle": f"{mission.kind}, {mission.autopilot or 'any autopilot'}{circles}",
        "obeys": f"{who or 'nobody'} (system/component, 0: any)",
        "take-off": f"to {metres(task.take_off_amsl_m)} AMSL",
        "flies": f"at {limits.speed_m_s:g} m/s between {metres(limits.floor_amsl_m)} and "
        f"{metres(limits.ceiling_amsl_m)} AMSL, to {_targets(mission)}",
        "then": _LAST[mission.end_action],
        "bounds": f"turn radius {metres(limits.turn_radius_m)}, climb {climb_deg:g}, dive "
        f"{dive_deg:g} degrees",
        "keeps": f"{metres(settings.safety_distance_m)} (d_s) from terrain and zones",
        "knows": f"{counted(len(task.radars), 'radar')}, "
        f"{counted(len(task.zones) - inner, 'keep-out')}, {counted(inner, 'keep-in')}{own}",
        "sees": _sight(mission),
        "subpaths": f"{proven}; planned for {settings.planning_time_s:g} s (T); after "
        f"{counted(mission.attempts, 'attempt')} without one: {mission.fallback.value}",
    }
    lines = [f"{mission.name}: profile {settings.profile.name}"]
    return "\n".join([*lines, *(f"  {name:<9} {text}" for name, text in rows.items())])


def _targets(mission: Mission) -> str:
    if mission.targets_from_vehicle:
        return "the waypoints of the vehicle's own mission"
    places = [
        f"{metres(abs(north))} {'south' if north < 0.0 else 'north'}, "
        f"{metres(abs(east))} {'west' if east < 0.0 else 'east'}"
        for north, east in mission.targets_ne_m
    ]
    ends = itertools.pairwise([(0.0, 0.0), *mission.targets_ne_m])
    straight_m = sum(itertools.starmap(math.dist, ends))
    return f"{' then '.join(places)} of the origin ({metres(straight_m)} straight from there)"


def _sight(mission: Mission) -> str:
    """What is known of the terrain in advance, and how more becomes known."""
    known, range_m, sensor = mission.known, mission.task.settings.scan_range_m, mission.near
    if sensor is not None:
        kind = f"{sensor.kind.upper()} of component {sensor.component_id}"
        return f"{metres(sensor.range_m)} (R) far, by {kind}; stops at once for what is in the way"
    sight = f"{metres(range_m)} (R) far, {metres(mission.task.scan_distance_m)} (L) before the end "
    sight += "of each subpath, by terrain radar"
    if mission.scanner_component_id is None:
        sight = "nothing: there is no terrain radar, and only known terrain is flown over"
    elif not mission.scanner_complete:
        sight += ", which may miss ground in its sight: nothing bounds what it does not show"
    if known is not None:
        sight += f". Terrain of {_share(known.upper_m)} of the map is known in advance"
        if known.guess_m is not None:
            sight += f"; a file guides over {_share(known.guess_m)} of it, and proves nothing"
    return sight


def _share(heights_m: FloatArray) -> str:
    """How many cells are known: all of them is only all of them."""
    return f"{at_least(100.0 * float(np.isfinite(heights_m).mean()), 1)}%"


def flight_table(flown: FlightSummary) -> Table:
    """How a flight went; of one that was resumed, since then."""
    title = f"{flown.session.mission.name}: {flown.session.state.phase.value}"
    table = Table("", Column(justify="right"), title=Text(title), show_header=False)
    for heading, value in _flown(flown):
        table.add_row(heading, value)
    return table


def _flown(flown: FlightSummary) -> Iterator[tuple[str, str]]:
    session, plans = flown.session, flown.plans
    arrived = flown.end is not None and flown.end.outcome is Outcome.ARRIVED
    since = " since it was resumed" if flown.resumed else ""
    yield "outcome", "none" if flown.end is None else flown.end.outcome.value
    if arrived and not session.mission.task.limits.hovers and flown.passed_m < math.inf:
        yield "passed the target at", f"{number(flown.passed_m, 1)} m"
    elif flown.to_go_m is not None:
        yield "distance to target", f"{number(flown.to_go_m, 1)} m"
    yield f"vehicle time{since}", f"{number(session.clock.passed_s, 1)} s"
    yield "times real time", f"{number(flown.times_real_time)}x"
    yield "subpaths flown", f"{session.state.flight.legs_flown}"
    if plans:
        yield "cost of all subpaths", number(sum(plan.cost for plan in plans), 1)
        proofs = [plan.certificate for plan in plans]
        nearest = min(proofs, key=lambda proof: proof.clearance_m)
        yield "least proven clearance", clearance_text(nearest)
        inside_m = sum(proof.radar_m for proof in proofs)
        yield "planned inside radar ranges", f"{number(inside_m)} m"
    if flown.plans_s:
        median_s, worst_s = statistics.median(flown.plans_s), max(flown.plans_s)
        took = f"{number(1e3 * median_s)} / {number(1e3 * worst_s)} ms"
        yield "planning, median / longest", took
    if flown.out_of_time:
        remedy = "raise planner.planning_time_s, or use a faster computer"
        yield "plans cut by time", f"{flown.out_of_time}: {remedy}"


def plans_table(plans: tuple[Planned, ...]) -> Table:
    """Subpath by subpath, what was planned."""
    table = Table()
    for heading in ("subpath", "cost", "length", "clearance", "tightest turn", "inside radars"):
        table.add_column(heading, justify="right")
    for index, planned in enumerate(plans, start=1):
        proof = planned.certificate
        table.add_row(
            f"{index}",
            number(planned.cost, 2),
            metres(planned.subpath.length_m),
            clearance_text(proof),
            metres(proof.turn_radius_m) if proof.turn_radius_m < _STRAIGHT_M else "straight",
            metres(proof.radar_m),
        )
    return table


def clearance_text(certificate: Certificate) -> str:
    """The clearance that is proven for a subpath, or which bounds are not."""
    return metres_at_least(certificate.clearance_m) if certificate.proven else "not proven"


def checks_table(checks: list[Check]) -> Table:
    """The preflight checks, one a row, each with its remedy."""
    table = Table(show_header=False, box=None, padding=(0, 1))
    for check in checks:
        verdict = Text(check.status.value, style=_COLOURS[check.status])
        what = f"{check.what}. {check.remedy}" if check.remedy else check.what
        table.add_row(verdict, Text(check.name), Text(what))
    return table
