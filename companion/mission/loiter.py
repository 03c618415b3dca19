"""Loiter clearance: moves a plane's loiter circle away from zones (design 7).

A fence changed in flight, other settings, or the place of a take-over may put its circle too near
to a zone.  It is then sent to loiter elsewhere, over known ground.  If there is no such place, as
before the first scan, it scans at once, at its current position and height, and moves as soon as a
place is known.  It never flies to unknown ground, and otherwise stays.
"""

from msgspec.structs import replace

from companion.mission import following
from companion.mission.decisions import Context, Step, cannot_fly
from companion.mission.events import Command, Position, ScanDone, StartScan, StatusText, Vector
from companion.mission.state import LoiterScan, Phase, Scanning, State
from companion.planner.loiter_search import LoiterQuery, loiter_point
from companion.world.zone_index import index_of

_PHASES = (Phase.FLYING, Phase.HOLDING)
_SLACK_M = 0.5  # a leg may end where its circle just keeps the clearance


def enforce_loiter_clearance(state: State, event: Position) -> Step | None:
    """Move a plane whose loiter circle is too near to a zone; None: left to the phase.

    Each place is checked once under the same rules, and again after a scan.
    """
    flight, hover = state.flight, state.flight.hover_nea_m
    if state.vehicle.traits.hovers or state.phase not in _PHASES or flight.leg is not None:
        return None
    if hover is None or _is_judged(state, hover) or cannot_fly(state, event) is not None:
        return None
    nearest, gap_m = index_of(state.task.zones).nearest(hover[0], hover[1])
    zone = "" if nearest is None else nearest.name
    if gap_m >= state.task.zone_clearance_m - _SLACK_M:
        return replace(state, flight=replace(flight, loiter_checked=(state.task, hover))), [], None
    refuge = loiter_point(
        flight.known,
        state.task,
        LoiterQuery(
            here_nea_m=event.position_nea_m,
            velocity_nea_m_s=event.velocity_nea_m_s,
            height_amsl_m=hover[2],
            stays_m=gap_m - state.task.limits.loiter_radius_m,
        ),
    )
    if refuge is None:
        return _scan_for_loiter(state, hover, zone)
    flight = following.at_rest(flight, refuge)
    flight = replace(flight, loiter_checked=(state.task, refuge), progress_at_s=state.now_s)
    says = StatusText(text=f"circling elsewhere: too near to {zone}", warning=True)
    return replace(state, flight=flight), [says], None


def _scan_for_loiter(state: State, hover: Vector, zone: str) -> Step:
    """Scan now, at any height, to find a place to loiter."""
    flight, task = replace(state.flight, loiter_checked=(state.task, hover)), state.task
    if flight.loiter_scan_rules is task:
        says: Command = StatusText(text=f"nowhere to circle clear of {zone}", warning=True)
        return replace(state, flight=flight), [says], None
    here = state.vehicle.position_nea_m or hover
    commands: list[Command] = [
        StatusText(text=f"looking for a place clear of {zone}", warning=True)
    ]
    if not isinstance(flight.search, Scanning | LoiterScan):
        commands.append(StartScan(centre_nea_m=here))
    flight = replace(flight, loiter_scan_rules=task, search=LoiterScan(), planning_backtrack=None)
    flight = replace(flight, progress_at_s=state.now_s)
    return replace(state, flight=flight), commands, None


def on_loiter_scan(state: State, _event: ScanDone, _context: Context) -> Step | None:
    """End a loiter scan: recheck at the next position.  None: it was another scan."""
    flight = state.flight
    if not isinstance(flight.search, LoiterScan):
        return None
    return replace(state, flight=replace(flight, search=None, loiter_checked=None)), [], None


def _is_judged(state: State, hover: Vector) -> bool:
    loiter_checked = state.flight.loiter_checked
    return (
        loiter_checked is not None
        and loiter_checked[0] is state.task
        and loiter_checked[1] == hover
    )
