"""A flight at one moment, as values: what the terminal, `fly --json` and the live view show.

Made a few times a second from a session's newest state, by whichever thread shows it: what decides
does no work for it.
"""

import math
from typing import Final, Literal, final

import numpy as np
from msgspec import Struct

from companion.mission.battery import way_left_m
from companion.mission.decisions import reason_text
from companion.mission.events import Outcome
from companion.mission.phases import IN_AIR, ON_PATH, Holding, Phase, Reason
from companion.mission.state import State
from companion.mission.stopped import FAILSAFE_OVER
from companion.planner.procedure import off_path_m
from companion.telemetry.flight_summary import FlightSummary
from companion.world.columns import distance_to_terrain_m

LOADS: Final = "loads the planner: compiled the first time, in 15 s, on a busy computer in minutes"
_LOOKS = 0.5  # of the scan range R: what is farther away is not looked for
_WARNED_S = 60.0  # for how long a warning or a text stands
_MOVES_M_S = 0.2
_WAITS_FOR: Final = (
    "waits for go: send MISSION_START from a ground station (no terminal is here for a yes, and "
    "--start was not given)",
    "waits for go: type yes here, or send MISSION_START from a ground station",
)
"""How to say go: there is no terminal for it in a service or a script."""


@final
class FlightStatus(Struct, frozen=True, kw_only=True, tag_field="kind", tag="status"):
    """The flight at one moment."""

    t_s: float
    """Vehicle time: seconds since its boot (until its clock is known, since the start)."""
    times_real_time: float | None
    """Vehicle time over wall time since the vehicle was first heard; null before."""
    phase: str
    """Of the mission (docs/reference/mission-states.md)."""
    reason: str | None
    """Why it holds or ends, as text; null: it does neither."""
    code: str | None
    """The reason's name, which stays the same if its text is improved."""
    remedy: str | None
    """What to do about it."""
    waits_for: str | None
    """What it waits for before it takes off: its planner, or a person's go; null: neither."""
    warning: str | None
    """The companion's latest warning of this phase, for a minute."""
    vehicle_text: str | None
    """The autopilot's latest STATUSTEXT, for a minute."""
    mode: str | None
    """The autopilot's flight mode, in the companion's words."""
    armed: bool
    """As the autopilot reports."""
    failsafe: bool
    """Whether the autopilot reports a failsafe, in the air."""
    target: int
    """Which target is flown to, counted from 1; 0: none is known."""
    targets: int
    """How many there are."""
    to_go_m: float | None
    """From the vehicle to that target, straight, horizontally."""
    time_left_s: float | None
    """To the last target, or what is left of the way back; null while nothing is flown."""
    latitude_deg: float | None
    """Of the vehicle, WGS84."""
    longitude_deg: float | None
    """Of the vehicle, WGS84."""
    position_age_s: float | None
    """How old that is."""
    altitude_amsl_m: float | None
    """Of the vehicle."""
    above_ground_m: float | None
    """Height above the highest ground that the known map allows for below; null: unknown."""
    clearance_m: float | None
    """Distance to the terrain and things that are known; at most `looked_m`."""
    looked_m: float
    """How far around the vehicle they are looked for."""
    safety_distance_m: float
    """d_s of the mission: what the vehicle has to keep from them."""
    speed_m_s: float
    """Over ground."""
    course_rad: float | None
    """Of that, clockwise from the local frame's north; null at rest."""
    climb_m_s: float
    """Upwards."""
    off_path_m: float | None
    """Distance from the path, across it; null: there is none."""
    battery_left: float | None
    """Share, 0 to 1; null: the autopilot does not say."""
    battery_reserve: float
    """What the mission wants to be left at the target."""
    link_age_s: float | None
    """Since the autopilot's clock was last heard; null: never."""
    frames_heard: int
    """From the autopilot since the start."""
    frames_lost: int
    """Gaps in their sequence numbers: lost, or filtered on the way."""
    subpaths_flown: int
    """Subpaths begun, this one included."""
    plans_failed: int
    """Failed attempts in a row, from rest."""
    refusal: str | None
    """Why the newest request has no plan, as text."""
    plan_cost: float | None
    """Of the newest plan (eq. 5)."""
    plan_took_s: float | None
    """How long the newest answer took."""
    plan_clearance_m: float | None
    """Distance to terrain that is proven for all of it; null: it is not proven."""


def flight_status(flown: FlightSummary) -> FlightStatus:
    """The flight as it stands now."""
    session = flown.session
    state, clock, autopilot = session.state, session.clock, session.vehicle
    vehicle, flight, task = state.vehicle, state.flight, state.task
    position, now_s = vehicle.position_nea_m, clock.going_on_s
    reason, remedy = _reason(state)
    warned_at_s, warning = session.warned
    said_at_s, vehicle_text = (-math.inf, "") if autopilot is None else autopilot.last_text
    looked_m = _LOOKS * task.settings.scan_range_m
    latitude = longitude = above_m = clear_m = None
    if position is not None:
        latitude, longitude = map(float, session.mission.frame.to_geodetic_deg(*position[:2]))
        known = flight.known
        if known.is_known(*position[:2]):
            above_m = position[2] - float(known.upper_m[known.cell_of(*position[:2])])
        clear_m = distance_to_terrain_m(known, np.asarray(position), looked_m, seen_only=True)
    north_m_s, east_m_s, up_m_s = vehicle.velocity_nea_m_s
    speed_m_s = math.hypot(north_m_s, east_m_s)
    has_way = state.phase in ON_PATH and position is not None and len(state.targets_ne_m) > 0
    path, off_m = state.path, None
    if path is not None and position is not None:
        off_m = off_path_m(path.reference, path.leg, np.asarray(position))
    plan = flown.plans[-1] if flown.plans else None
    proof = None if plan is None else plan.certificate
    heard, lost = session.frames_heard
    return FlightStatus(
        t_s=round(now_s, 6),
        times_real_time=flown.times_real_time if flown.elapsed_s > 0.0 else None,
        phase=state.phase.value,
        reason=reason,
        code=None if state.reason is None else state.reason.name,
        remedy=remedy,
        waits_for=_waits_for(flown),
        warning=warning if _stands(warned_at_s, now_s, state.stage.since_s) else None,
        vehicle_text=vehicle_text if _stands(said_at_s, now_s) else None,
        mode=None if vehicle.mode is None else vehicle.mode.value,
        armed=vehicle.armed,
        failsafe=vehicle.failsafe and state.phase in IN_AIR,
        target=min(flight.target + 1, len(state.targets_ne_m)),
        targets=len(state.targets_ne_m),
        to_go_m=flown.to_go_m,
        time_left_s=way_left_m(state) / task.limits.speed_m_s if has_way else None,
        latitude_deg=latitude,
        longitude_deg=longitude,
        position_age_s=None if position is None else now_s - vehicle.position_at_s,
        altitude_amsl_m=None if position is None else position[2],
        above_ground_m=above_m,
        clearance_m=clear_m,
        looked_m=looked_m,
        safety_distance_m=task.settings.safety_distance_m,
        speed_m_s=speed_m_s,
        course_rad=math.atan2(east_m_s, north_m_s) % math.tau if speed_m_s >= _MOVES_M_S else None,
        climb_m_s=up_m_s,
        off_path_m=off_m,
        battery_left=vehicle.battery,
        battery_reserve=session.mission.reserve,
        link_age_s=now_s - clock.now_s if clock.is_known else None,
        frames_heard=heard,
        frames_lost=lost,
        subpaths_flown=flight.legs_flown,
        plans_failed=flight.failures,
        refusal=None if flight.refusal is None else flight.refusal.value,
        plan_cost=None if plan is None else plan.cost,
        plan_took_s=flown.plans_s[-1] if flown.plans_s else None,
        plan_clearance_m=proof.clearance_m if proof is not None and proof.proven else None,
    )


def _waits_for(flown: FlightSummary) -> str | None:
    if flown.loads:
        return LOADS
    return _WAITS_FOR[flown.asks_here] if flown.session.state.phase is Phase.READY else None


def _reason(state: State) -> tuple[str | None, str | None]:
    """Why the mission holds or ends, and the remedy."""
    reason, stage = state.reason, state.stage
    if reason is None:
        return None, None
    if reason is Reason.FAILSAFE and isinstance(stage, Holding) and stage.failsafe_over:
        return FAILSAFE_OVER, None
    detail, remedy = reason_text(state, reason)
    return f"{reason.text}{state.detail or detail}", state.remedy or remedy


def _stands(said_at_s: float, now_s: float, since_s: float = -math.inf) -> bool:
    """Whether a text is news: said in this phase, and not long ago."""
    return said_at_s >= since_s and 0.0 <= now_s - said_at_s < _WARNED_S


# --- the lines of `fly --json`


SCHEMA: Final = "companion-flight"
VERSION: Final = 2
"""Of the lines.  What may come without a new one: more fields, more kinds of lines."""


@final
class FlightBegun(Struct, frozen=True, kw_only=True, tag_field="kind", tag="begun"):
    """The first line."""

    schema: Literal["companion-flight"]
    """Says what these lines are."""
    version: int
    """Of this schema."""
    mission: str
    """The mission's name."""
    run_folder: str
    """Where the flight is recorded."""
    profile: str
    """How the planner takes the paper: flight or paper."""
    seed: int
    """Of the search."""
    lockstep: bool
    """Whether vehicle and companion wait for each other."""
    shadow: bool
    """Whether it only watches."""
    companion: str
    """The version of the program."""


@final
class FlightEnded(Struct, frozen=True, kw_only=True, tag_field="kind", tag="ended"):
    """The last line."""

    outcome: Outcome
    """How it has ended."""
    reason: str
    """Why, and what to do about it."""
    exit_code: int
    """Of the program."""


LINES: Final = FlightBegun, FlightStatus, FlightEnded
"""What `fly --json` prints: one, then many, then one."""
