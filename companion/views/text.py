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
from companion.planner.settings import Task
from companion.telemetry.flight_summary import FlightSummary
from companion.views.words import rounded_down, share_of
from companion.world.near_map import NearSensor


def mission_summary(mission: Mission) -> str:
    """Summary of a mission, as text for the operator."""
    limits, settings = mission.task.limits, mission.task.settings
    profile, upwards = settings.profile, "straight up to" if limits.hovers else "to"
    lines = [
        f"{mission.name}: profile {profile.name}",
        f"  {_vehicle(mission)}",
        f"  Take off, climb {upwards} {_m(mission.task.take_off_amsl_m)} AMSL, "
        f"then fly at {limits.speed_m_s:g} m/s between {_m(limits.floor_amsl_m)} and "
        f"{_m(limits.ceiling_amsl_m)} AMSL.",
        f"  {_targets(mission)}",
        f"  Turns no tighter than {_m(limits.turn_radius_m)}, climbs to "
        f"{math.degrees(limits.climb_angle_rad):g}, dives to "
        f"{math.degrees(limits.dive_angle_rad):g} degrees.",
        f"  {_sight(mission)}",
        f"  Kept from terrain and keep-outs: {_m(settings.safety_distance_m)} (d_s). "
        f"{_threats(mission)}",
        f"  Each subpath: {settings.evaluations} candidates at {profile.samples} points; "
        + ("proven safe before it is flown." if profile.verified else "flown unproven."),
        "  If no safe subpath is found it flies the last one to its end, stops there and tries "
        f"again; after {mission.attempts} attempts: {mission.fallback.value}.",
    ]
    return "\n".join(lines)


def _targets(mission: Mission) -> str:
    last = {
        EndAction.HOLD: "hold there",
        EndAction.LAND: "land there",
        EndAction.RETURN: "come back along the flown path",
    }[mission.end_action]
    limits = mission.task.limits
    if not limits.hovers:
        last += f"; each is passed within {_m(limits.tracking_error_m)}, then circled"
    if mission.targets_from_vehicle:
        return f"Go to the waypoints of the vehicle's own mission, and {last}."
    places = [
        f"{_m(abs(north))} {'south' if north < 0.0 else 'north'}, "
        f"{_m(abs(east))} {'west' if east < 0.0 else 'east'}"
        for north, east in mission.targets_ne_m
    ]
    route = " then ".join(places)
    ends = [(0.0, 0.0), *mission.targets_ne_m]
    straight = sum(math.dist(a, b) for a, b in itertools.pairwise(ends))
    return f"Go to {route} of the origin ({_m(straight)} straight from there), and {last}."


def _threats(mission: Mission) -> str:
    task = mission.task
    radars = f"{len(task.radars)} radars are known and avoided where possible"
    inner = sum(zone.keep_in for zone in task.zones)
    outer = len(task.zones) - inner
    zones = f"{outer} keep-outs are never entered" if outer else "no keep-outs"
    kept = f"; {inner} keep-ins are never left" if inner else ""
    own = "; and the vehicle's own fence" if mission.fence_from_vehicle else ""
    return f"{radars}; {zones}{kept}{own}."


def _sight(mission: Mission) -> str:
    """What is known of the terrain, and how more becomes known."""
    task, settings = mission.task, mission.task.settings
    known = ""
    if mission.known is not None:
        known_m = np.isfinite(mission.known.upper_m)
        hole_ha = float(np.count_nonzero(~known_m)) * mission.known.cell_m**2 / 1e4
        hole = f" (all but {max(math.ceil(hole_ha), 1):,} ha)" if hole_ha else ""
        known = f" Terrain of {share_of(known_m.mean())} of the map is known in advance{hole}."
        if mission.known.guess_m is not None:
            share = float(np.isfinite(mission.known.guess_m).mean())
            known = f" A file guides over {share_of(share)} of the map, and proves nothing."
    if mission.near is not None:
        return _near_sight(mission, mission.near)
    if mission.scanner_component_id is None:
        return f"There is no terrain radar: only known terrain is flown over.{known}"
    gaps = ""
    if not mission.scanner_complete:
        gaps = " It may miss ground in its sight: nothing bounds what it does not show."
    return (
        f"The radar sees {_m(settings.scan_range_m)} (R).{gaps} "
        f"{_handover(task, f'scans for up to {settings.scan_time_s:g} s, ')}{known}"
    )


def _handover(task: Task, scans: str = "") -> str:
    """Where on a subpath the next one is planned and taken, p_scan and p_prog (`Leg.scan_at_m`)."""
    begins = f"{_m(task.scan_distance_m)} (L) before the end of each subpath it {scans}plans"
    plans = f"for {task.settings.planning_time_s:g} s (T)"
    return f"{begins} {plans}, and goes over to the next subpath {_m(task.tail_m)} before the end."


def _near_sight(mission: Mission, sensor: NearSensor) -> str:
    """What looks about, and what that proves."""
    return (
        f"{sensor.kind.upper()} of component {sensor.component_id} shows what stands within "
        f"{_m(sensor.range_m)} (R) at the height of flight; what it has not passed is unknown. "
        f"{_handover(mission.task)} What stands in the way stops the vehicle at once."
    )


def _vehicle(mission: Mission) -> str:
    """The vehicle, and who may command it."""
    limits = mission.task.limits
    kind = f"{mission.kind}, {mission.autopilot or 'whichever autopilot is found'}"
    if not limits.hovers:
        kind += f", holding on circles of {_m(limits.loiter_radius_m)}"
    who = ", ".join(f"{system}/{component}" for system, component in mission.commanders)
    return f"{kind}; obeys {who or 'nobody'} (0: any component)."


def _m(value_m: float) -> str:
    return f"{value_m / 1000:.4g} km" if abs(value_m) >= 1000.0 else f"{value_m:g} m"


def flight_table(flown: FlightSummary) -> Table:
    """How a flight went."""
    session = flown.session
    title = Text(f"{session.mission.name}: {session.state.phase.value}")
    table = Table(title=title, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    rows = [("outcome", "none" if flown.end is None else flown.end.outcome.value)]
    arrived = flown.end is not None and flown.end.outcome is Outcome.ARRIVED
    if arrived and not session.mission.task.limits.hovers and flown.passed_m < math.inf:
        rows.append(("passed the target at", f"{flown.passed_m:,.1f} m"))
    elif flown.to_go_m is not None:
        rows.append(("distance to target", f"{flown.to_go_m:,.1f} m"))
    since = " since it was resumed" if flown.resumed else ""
    rows.append((f"vehicle time{since}", f"{session.clock.passed_s:,.1f} s"))
    rows.append((f"wall time{since}", f"{flown.elapsed_s:,.1f} s"))
    rows.append(("times real time", f"{flown.times_real_time:,.0f}x"))
    rows.append(("subpaths flown", f"{session.state.flight.legs_flown}"))
    if flown.plans:
        rows.append(("cost of all subpaths", f"{sum(plan.cost for plan in flown.plans):.1f}"))
        nearest = min((plan.certificate for plan in flown.plans), key=lambda each: each.clearance_m)
        rows.append(("least proven clearance", clearance_text(nearest)))
        inside = sum(plan.certificate.radar_m for plan in flown.plans)
        rows.append(("planned inside radar ranges", f"{inside:,.0f} m"))
    if flown.plans_s:
        median, worst = statistics.median(flown.plans_s), max(flown.plans_s)
        rows.append(("planning, median / longest", f"{median * 1e3:,.0f} / {worst * 1e3:,.0f} ms"))
    if flown.out_of_time:
        remedy = "raise planner.planning_time_s, or use a faster computer"
        rows.append(("plans cut by time", f"{flown.out_of_time}: {remedy}"))
    for name, value in rows:
        table.add_row(name, value)
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
    return f"{rounded_down(certificate.clearance_m):,.0f} m" if proven else "not proven"


_COLOURS = {CheckStatus.PASSED: "green", CheckStatus.NOTED: "yellow", CheckStatus.REFUSED: "red"}


def checks_table(checks: list[Check]) -> Table:
    """The preflight checks, one a row, each with its remedy."""
    table = Table(show_header=False, box=None, padding=(0, 1))
    for check in checks:
        verdict = Text(check.status.value, style=_COLOURS[check.status])
        what = f"{check.what}. {check.remedy}" if check.remedy else check.what
        table.add_row(verdict, Text(check.name), Text(what))
    return table
