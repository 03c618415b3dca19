"""A mission as text, and a flight as a table."""

import itertools
import math
import statistics

import numpy as np
from rich.table import Table
from rich.text import Text

from companion.mavlink.preflight import Check, CheckStatus
from companion.mission.events import Outcome
from companion.mission.mission import EndAction, Mission
from companion.path.certificate import Certificate
from companion.planner.request import Planned
from companion.telemetry.flight_summary import FlightSummary
from companion.views.words import metres, metres_at_least, share_of

_COLOURS = {CheckStatus.PASSED: "green", CheckStatus.NOTED: "yellow", CheckStatus.REFUSED: "red"}
_LAST = {
    EndAction.HOLD: "hold there",
    EndAction.LAND: "land there",
    EndAction.RETURN: "come back along the flown path",
}


def mission_summary(mission: Mission) -> str:
    """Summary of a mission, as text for the operator."""
    task, limits, settings = mission.task, mission.task.limits, mission.task.settings
    who = ", ".join(f"{system}/{component}" for system, component in mission.commanders)
    circles = "" if limits.hovers else f", holding on circles of {metres(limits.loiter_radius_m)}"
    passed = "" if limits.hovers else "; each is passed, then circled"
    inner = sum(zone.keep_in for zone in task.zones)
    own = " and the vehicle's own fence" if mission.fence_from_vehicle else ""
    proven = "proven safe before it is flown" if settings.profile.verified else "flown unproven"
    lines = [
        f"{mission.name}: profile {settings.profile.name}",
        f"{mission.kind}, {mission.autopilot or 'whichever autopilot is found'}{circles}; "
        f"obeys {who or 'nobody'} (0: any component).",
        f"Take off, climb to {metres(task.take_off_amsl_m)} AMSL, then fly at "
        f"{limits.speed_m_s:g} m/s between {metres(limits.floor_amsl_m)} and "
        f"{metres(limits.ceiling_amsl_m)} AMSL.",
        f"Go to {_targets(mission)}, and {_LAST[mission.end_action]}{passed}.",
        f"Turns no tighter than {metres(limits.turn_radius_m)}, climbs to "
        f"{math.degrees(limits.climb_angle_rad):g}, dives to "
        f"{math.degrees(limits.dive_angle_rad):g} degrees.",
        _sight(mission),
        f"Kept from terrain and keep-outs: {metres(settings.safety_distance_m)} (d_s). "
        f"Known: {len(task.radars)} radars, {len(task.zones) - inner} keep-outs, "
        f"{inner} keep-ins{own}.",
        f"Each subpath: {settings.evaluations} candidates at {settings.profile.samples} points; "
        f"{proven}.",
        "If no safe subpath is found it flies the last one to its end, stops there and tries "
        f"again; after {mission.attempts} attempts: {mission.fallback.value}.",
    ]
    return "\n  ".join(lines)


def _targets(mission: Mission) -> str:
    if mission.targets_from_vehicle:
        return "the waypoints of the vehicle's own mission"
    places = [
        f"{metres(abs(north))} {'south' if north < 0.0 else 'north'}, "
        f"{metres(abs(east))} {'west' if east < 0.0 else 'east'}"
        for north, east in mission.targets_ne_m
    ]
    ends = [(0.0, 0.0), *mission.targets_ne_m]
    straight_m = sum(math.dist(a, b) for a, b in itertools.pairwise(ends))
    return f"{' then '.join(places)} of the origin ({metres(straight_m)} straight from there)"


def _sight(mission: Mission) -> str:
    """What is known of the terrain, how more becomes known, and where it is planned with."""
    task, settings, known = mission.task, mission.task.settings, ""
    if (sensor := mission.near) is not None:
        return (
            f"{sensor.kind.upper()} of component {sensor.component_id} shows what stands within "
            f"{metres(sensor.range_m)} (R); what it has not passed is unknown. What stands in the "
            f"way stops the vehicle at once. It plans for {settings.planning_time_s:g} s (T), "
            "again and again, and goes over to each next subpath as soon as that is proven."
        )
    if mission.known is not None:
        share = float(np.isfinite(mission.known.upper_m).mean())
        known = f" Terrain of {share_of(share)} of the map is known in advance."
        if mission.known.guess_m is not None:
            share = float(np.isfinite(mission.known.guess_m).mean())
            known = f" A file guides over {share_of(share)} of the map, and proves nothing."
    if mission.scanner_component_id is None:
        return f"There is no terrain radar: only known terrain is flown over.{known}"
    seen = f"The radar sees {metres(settings.scan_range_m)} (R)."
    if not mission.scanner_complete:
        seen += " It may miss ground in its sight: nothing bounds what it does not show."
    return (
        f"{seen} {metres(task.scan_distance_m)} (L) before the end of each subpath it scans for up "
        f"to {settings.scan_time_s:g} s, plans for {settings.planning_time_s:g} s (T), and goes "
        f"over to the next subpath {metres(task.tail_m)} before the end.{known}"
    )


def flight_table(flown: FlightSummary) -> Table:
    """How a flight went."""
    session = flown.session
    title = Text(f"{session.mission.name}: {session.state.phase.value}")
    table = Table(title=title, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_row("outcome", "none" if flown.end is None else flown.end.outcome.value)
    arrived = flown.end is not None and flown.end.outcome is Outcome.ARRIVED
    if arrived and not session.mission.task.limits.hovers and flown.passed_m < math.inf:
        table.add_row("passed the target at", f"{flown.passed_m:,.1f} m")
    elif flown.to_go_m is not None:
        table.add_row("distance to target", f"{flown.to_go_m:,.1f} m")
    since = " since it was resumed" if flown.resumed else ""
    table.add_row(f"vehicle time{since}", f"{session.clock.passed_s:,.1f} s")
    table.add_row(f"wall time{since}", f"{flown.elapsed_s:,.1f} s")
    table.add_row("times real time", f"{flown.times_real_time:,.0f}x")
    table.add_row("subpaths flown", f"{session.state.flight.legs_flown}")
    if flown.plans:
        table.add_row("cost of all subpaths", f"{sum(plan.cost for plan in flown.plans):.1f}")
        nearest = min((plan.certificate for plan in flown.plans), key=lambda each: each.clearance_m)
        table.add_row("least proven clearance", clearance_text(nearest))
        inside_m = sum(plan.certificate.radar_m for plan in flown.plans)
        table.add_row("planned inside radar ranges", f"{inside_m:,.0f} m")
    if flown.plans_s:
        median, worst = statistics.median(flown.plans_s), max(flown.plans_s)
        table.add_row("planning, median / longest", f"{median * 1e3:,.0f} / {worst * 1e3:,.0f} ms")
    if flown.out_of_time:
        remedy = "raise planner.planning_time_s, or use a faster computer"
        table.add_row("plans cut by time", f"{flown.out_of_time}: {remedy}")
    return table


def plans_table(plans: tuple[Planned, ...]) -> Table:
    """Subpath by subpath, what was planned."""
    table = Table()
    for heading in ("subpath", "cost", "length", "clearance", "tightest turn", "inside radars"):
        table.add_column(heading, justify="right")
    for number, planned in enumerate(plans, start=1):
        certificate = planned.certificate
        turn_km = certificate.turn_radius_m / 1000.0
        table.add_row(
            f"{number}",
            f"{planned.cost:.2f}",
            f"{planned.subpath.length_m / 1000:.1f} km",
            clearance_text(certificate),
            f"{turn_km:.1f} km" if turn_km < 100.0 else "straight",
            f"{certificate.radar_m / 1000:.1f} km",
        )
    return table


def clearance_text(certificate: Certificate) -> str:
    """The clearance that is proven for a subpath, or which bounds are not."""
    proven = certificate.proven
    return metres_at_least(certificate.clearance_m) if proven else "not proven"


def checks_table(checks: list[Check]) -> Table:
    """The preflight checks, one a row, each with its remedy."""
    table = Table(show_header=False, box=None, padding=(0, 1))
    for check in checks:
        verdict = Text(check.status.value, style=_COLOURS[check.status])
        what = f"{check.what}. {check.remedy}" if check.remedy else check.what
        table.add_row(verdict, Text(check.name), Text(what))
    return table
