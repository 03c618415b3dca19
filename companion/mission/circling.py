"""Where a plane circles while it has no leg: never knowingly near a zone (design 7).

A fence that is drawn in flight, other settings, or the place where it took over may put its circle
too near to one.  Then it is sent to circle elsewhere, over ground that is known.  Where none is, as
before the first scan, it looks at once, from where it is and as low as it is, and goes as soon as
it has seen a place.  Unknown ground is never flown to: if there is nothing else it stays.
"""

from msgspec.structs import replace

from companion.mission import following
from companion.mission.decisions import Step, cannot_fly
from companion.mission.events import Command, Position, Say, ScanDone, StartScan, Vector
from companion.mission.state import Looking, Phase, Scanning, State
from companion.planner.refuge import Circler, loiter_point
from companion.world.zone_index import index_of

_PHASES = (Phase.FLYING, Phase.HOLDING)
_SLACK_M = 0.5  # a leg may end where its circle just keeps the clearance


def kept_clear(state: State, event: Position) -> Step | None:
    """What a plane does whose circle is too near to a zone; None: it is left to the phase.

    Each place is looked at once under the same rules, and once more when a look is over.
    """
    flight, hover = state.flight, state.flight.hover_nea_m
    if state.vehicle.driving.hovers or state.phase not in _PHASES or flight.leg is not None:
        return None
    if hover is None or _is_judged(state, hover) or cannot_fly(state, event) is not None:
        return None
    nearest, gap_m = index_of(state.task.zones).nearest(hover[0], hover[1])
    zone = "" if nearest is None else nearest.name
    if gap_m >= state.task.zone_clearance_m - _SLACK_M:
        return replace(state, flight=replace(flight, circled=(state.task, hover))), [], None
    refuge = loiter_point(
        flight.known,
        state.task,
        Circler(
            here_nea_m=event.position_nea_m,
            velocity_nea_m_s=event.velocity_nea_m_s,
            height_amsl_m=hover[2],
            stays_m=gap_m - state.task.limits.loiter_radius_m,
        ),
    )
    if refuge is None:
        return _looks(state, hover, zone)
    flight = following.at_rest(flight, refuge)
    flight = replace(flight, circled=(state.task, refuge), progress_at_s=state.now_s)
    says = Say(text=f"circling elsewhere: too near to {zone}", warning=True)
    return replace(state, flight=flight), [says], None


def _looks(state: State, hover: Vector, zone: str) -> Step:
    """Scan now, whatever the height: not for a plan, but to see where to circle."""
    flight, task = replace(state.flight, circled=(state.task, hover)), state.task
    if flight.looked_under is task:
        says: Command = Say(text=f"nowhere to circle clear of {zone}", warning=True)
        return replace(state, flight=flight), [says], None
    here = state.vehicle.position_nea_m or hover
    commands: list[Command] = [Say(text=f"looking for a place clear of {zone}", warning=True)]
    if not isinstance(flight.search, Scanning | Looking):
        commands.append(StartScan(centre_nea_m=here))
    flight = replace(flight, looked_under=task, search=Looking(), planning_back=None)
    flight = replace(flight, progress_at_s=state.now_s)
    return replace(state, flight=flight), commands, None


def looked(state: State, event: ScanDone) -> Step | None:
    """The look is over: the place is judged again with the next position.  None: it was no look."""
    del event  # the map has it already
    flight = state.flight
    if not isinstance(flight.search, Looking):
        return None
    return replace(state, flight=replace(flight, search=None, circled=None)), [], None


def _is_judged(state: State, hover: Vector) -> bool:
    circled = state.flight.circled
    return circled is not None and circled[0] is state.task and circled[1] == hover
