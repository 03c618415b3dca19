"""Ground that is nearer than the map says: the vehicle stops, and waits for the two to agree."""

from msgspec.structs import replace

from companion.mission import following
from companion.mission.decisions import Step
from companion.mission.events import GroundSeen, StatusText
from companion.mission.state import Phase, Reason, State


def on_ground_seen(state: State, event: GroundSeen) -> Step:
    """Stop on the path, but on the way back: what was flown before is flown again."""
    state = replace(state, vehicle=replace(state.vehicle, ground_above_m=event.above_m))
    flight = state.flight
    goes_back = flight.returning or flight.homeward
    if not event.above_m or state.phase is not Phase.FLYING or goes_back or flight.leg is None:
        return state, [], None
    if flight.stop is not None:
        return state, [], None  # `stopped` waits for it, too
    state, commands, trigger = following.stop(state, Reason.GROUND_NEARER)
    text = f"{Reason.GROUND_NEARER.text}: by {event.above_m:.1f} m"
    return state, [StatusText(text=text, warning=True), *commands], trigger
