"""Events and decisions as journal entries: plain values of the types declared in `journal`."""

from collections.abc import Iterator
from typing import Any

import msgspec

from companion.mission import events, journal
from companion.mission.events import Command, Event
from companion.mission.state import State
from companion.planner.request import NotPlanned, Planned, PlanRequest

Entry = dict[str, Any]

def of_event(event: Event, state: State) -> Entry | None:
    """The entry of an event, None for those only in the telemetry log; state: after the event."""
    if isinstance(event, events.Entry):
        return _told(event)
    match event:
        case events.ScanDone():
            return _entry(
                journal.ScanDone,
                event.scan,
                blocks_asked=event.asked,
                blocks_answered=event.answered,
                cells_seen=int(state.flight.known.seen.sum()),
            )
        case events.PlanReady(outcome=Planned() as planned):
            curve = planned.subpath
            return _entry(
                journal.PlanReady,
                planned,
                length_m=curve.length_m,
                control_nea_m=curve.control_nea_m,
                out_of_time=planned.stopped_after is not None,
            )
        case events.PlanReady(outcome=NotPlanned() as refused):
            return _entry(
                journal.PlanRefused,
                refused,
                reason=refused.refusal.name,
                out_of_time=refused.stopped_after is not None,
            )
        case events.DuplicateId(certain=True, news=True):
            return _entry(journal.AnotherCompanion)
        case events.Order():
            return _entry(journal.OrderGiven, event, order=event.kind.name)
        case _:
            return None


def of_change(before: State, after: State) -> Iterator[Entry]:
    """The entries of the mission's progress."""
    if after.phase is not before.phase or after.reason is not before.reason:
        yield _entry(
            journal.Phase,
            phase=after.phase,
            was=before.phase,
            reason=None if after.reason is None else after.reason.text,
            code=None if after.reason is None else after.reason.name,
        )
    path, was_on = after.path, before.path
    if path is not None and path.outside_m and not (was_on is not None and was_on.outside_m):
        yield _entry(journal.PathLeft, left_path_m=path.outside_m)
    if after.flight.legs_flown != before.flight.legs_flown:
        yield _entry(journal.LegBegun, number=after.flight.legs_flown)


def of_command(command: Command) -> Entry | None:
    """The entry of a command; None for those that are only in the telemetry log."""
    return _told(command) if command.kind in journal.KINDS else None


def of_request(request: PlanRequest, due_s: float) -> Entry:
    """The entry of a plan request."""
    start = request.start
    return _entry(
        journal.PlanAsked,
        request,
        due_s=due_s,
        start_nea_m=start.position_nea_m,
        tangent_nea=start.tangent_nea,
        curvature_nea_1_m=start.curvature_nea_1_m,
    )


def _entry(kind: type[journal.Entry], source: object = None, **others: Any) -> Entry:
    """An entry without its time: fields are others, or of that name in the source."""
    values = {
        name: getattr(source, name) for name in kind.__struct_fields__ if hasattr(source, name)
    }
    return _told(kind(**{"time_s": 0.0, **values, **others}))


def _told(entry: journal.Entry) -> Entry:
    """Its fields, but for the time, which is added where it is noted."""
    told: Entry = msgspec.to_builtins(entry, enc_hook=journal.plain)
    for name in ("t_s", *journal.UNTOLD):
        told.pop(name, None)
    return told
