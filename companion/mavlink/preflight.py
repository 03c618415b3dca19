"""Preflight checks: the vehicle's reports against the mission.

One list, for `companion preflight`, which shows it, and for `fly`, which does not arm before it has
passed (`Preflight`).  `flight_check` also runs the mission machine's own rules, so that whatever it
would refuse is reported here.
"""

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, final

from msgspec.structs import replace

from companion.mavlink import fence, near_sensing
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, wire
from companion.mavlink.frames import Receiver
from companion.mavlink.link import TO_COMPONENT_1, VehicleSelector, ids_in_words
from companion.mavlink.near_scanner import NearScanner
from companion.mavlink.near_sensing import in_words
from companion.mavlink.parameter_checks import Severity
from companion.mavlink.plan_client import FENCE
from companion.mavlink.rangefinder import Rangefinder
from companion.mavlink.signing import Signing, timestamp_of
from companion.mission import ground, stopped
from companion.mission.decisions import Context, is_duplicate_suspected
from companion.mission.events import Item, Prepared, ScanDone, Tick, Vector
from companion.mission.health import battery_lasts, distrust
from companion.mission.mission import Mission
from companion.mission.state import Phase, Reason, State, Trigger
from companion.world.near_map import NearSensor

_EARLIEST_S = 1_735_689_600.0  # 2025: a clock before that has not been set
_MAX_LOOKS = 3
_PATIENCE_S = 5.0  # for rates and delays that have not come yet
_CHECK_S = 1.0  # between two looks at a vehicle that waits
_LONG_DELAY_S = 0.5
_LARGEST_GEOID_M = 110.0
_FEWEST_ANSWERS = 0.9
_NO_RANGEFINDER = "Set RNGFND1_TYPE and RNGFND1_ORIENT 25, or leave rangefinder_error_m out."
_NO_RADAR = (
    "Start it, or correct vehicle.scanner_component_id. Where there is none, say so in a "
    "mission.toml, which may name a .plan: vehicle.scanner = false, and [terrain] with an "
    "elevation file, or with the highest ground there is, highest_amsl_m (docs/files.md)."
)
_RANGE_ROUNDED_M = 0.0101  # autopilots cut limits off to whole centimetres (proximity.md 2)
_LOOK_AGAIN_S = 60.0
"""Between two scans of a vehicle that waits: a radar that is off is told before the flight."""
_LISTENED_S = 5.0  # for other companions: `fly` does, before it takes over


class CheckStatus(enum.Enum):
    """Result of a check."""

    PASSED = "ok"
    NOTED = "note"
    REFUSED = "refused"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One check of the list."""

    name: str
    status: CheckStatus
    what: str
    """The finding and the rule."""
    remedy: str = ""


class PreflightInputs(Protocol):
    """The part of a session that the checks read."""

    mission: Mission
    context: Context
    state: State
    vehicle: AutopilotClient | None
    found: str
    selector: VehicleSelector
    receiver: Receiver
    signing: Signing | None
    near: NearScanner | None
    rangefinder: Rangefinder | None
    last_scan: ScanDone | None
    sensed: dict[int, set[tuple[int, int]]]

    @property
    def senders(self) -> list[tuple[int, int]]:
        """All that were heard."""
        ...


@final
class Preflight:
    """Preflight of `fly`: one radar scan, then every check must pass before arming.

    The scan is repeated if the radar did not answer: it may just have been switched on.
    """

    def __init__(self) -> None:
        self._preparing_since_s: float | None = None
        self._looked, self._looks = False, 0
        self._answered_s: float | None = None
        self._failing_s: float | None = None
        self._looked_s = self._checked_s = -math.inf
        self._told = ""

    def scan_position(self, heard: PreflightInputs) -> Vector | None:
        """Position to scan from now; None if no scan is needed."""
        state, here = heard.state, heard.state.vehicle.position_nea_m
        if state.phase is Phase.READY and here is not None:
            return here if self._looks_again(heard) else None
        if state.phase is not Phase.PREPARING or heard.context.shadow:
            return None
        if state.since_s != self._preparing_since_s:  # prepared anew
            self._preparing_since_s, self._answered_s = state.since_s, None
            self._looked, self._looks, self._told = False, 0, ""
        if self._looked or state.airborne or not state.targets_ne_m or here is None:
            return None
        if distrust(state.vehicle, state.now_s, state.task.limits) is not None:
            return None
        self._looked, heard.last_scan = True, None
        self._looks += 1
        self._looked_s = state.now_s
        return here

    def _looks_again(self, heard: PreflightInputs) -> bool:
        """Whether another scan is due while it is ready; what the last one saw counts till then."""
        now_s = heard.state.now_s
        due = heard.mission.near is None and not 0.0 <= now_s - self._looked_s < _LOOK_AGAIN_S
        if due:
            self._looked_s = now_s
        return due

    def failed(self, heard: PreflightInputs, *, at_once: bool = False) -> Prepared | None:
        """The check that a vehicle that is ready does not pass any more, for some seconds.

        at_once: for a moment is enough; somebody has said go.
        """
        now_s = heard.state.now_s
        if heard.state.phase is not Phase.READY:
            self._failing_s = None
            return None
        if not at_once and 0.0 <= now_s - self._checked_s < _CHECK_S:
            return None
        self._checked_s = now_s
        refused = _refused(heard)
        if refused is None:
            self._failing_s = None
            return None
        if self._failing_s is None:
            self._failing_s = now_s
        if not at_once and now_s - self._failing_s < _PATIENCE_S:
            return None
        return _as_event(refused, now_s)

    def result(self, heard: PreflightInputs) -> Prepared | None:
        """Whether the checks have passed, or which one failed; None while answers are missing."""
        state = heard.state
        due = self._looked and heard.last_scan is not None and Item.CHECKS not in state.prepared
        if not due or state.phase is not Phase.PREPARING or waiting_for(heard):
            return None
        if self._answered_s is None:
            self._answered_s = state.now_s
        if self._told and 0.0 <= state.now_s - self._checked_s < _CHECK_S:
            return None
        self._checked_s = state.now_s
        refused = _refused(heard)
        if refused is None:
            return Prepared(time_s=state.now_s, item=Item.CHECKS)
        waited = bool(state.unready) and state.now_s - self._looked_s > _LOOK_AGAIN_S
        if refused.name == "radar" and (self._looks < _MAX_LOOKS or waited):
            self._looked = False
            return None
        if state.now_s - self._answered_s < _PATIENCE_S:
            return None
        event = _as_event(refused, state.now_s)
        again, self._told = event.refusal == self._told, event.refusal
        return None if again else event


def _refused(heard: PreflightInputs) -> Check | None:
    """The first check that refuses the flight; None: none does."""
    return next((each for each in checks_of(heard) if each.status is CheckStatus.REFUSED), None)


def _as_event(refused: Check, now_s: float) -> Prepared:
    refusal = f"{refused.name}: {refused.what}"
    return Prepared(time_s=now_s, item=Item.CHECKS, refusal=refusal, remedy=refused.remedy)


def waiting_for(heard: PreflightInputs) -> str:
    """What is still missing, as text; empty if nothing."""
    state, vehicle = heard.state, heard.vehicle
    if vehicle is None:
        return "the vehicle's heartbeat"
    answered = {Item.PARAMETERS: vehicle.parameters.is_done, Item.PLANS: vehicle.plans.is_done}
    waits = [item.value for item, done in answered.items() if not done]  # refused or not
    if state.vehicle.home_nea_m is None:
        waits.append("home")
    distrusted = distrust(state.vehicle, state.now_s, state.task.limits)
    if distrusted is not None:
        waits.append(f"its position ({distrusted.text})")
    return ", ".join(waits)


def checks_of(session: PreflightInputs) -> list[Check]:
    """All checks, in the order of a manual checklist."""
    vehicle = session.vehicle
    checks = [_heard(session)]
    if vehicle is None:
        return checks
    state = session.state
    checks += _link(session, vehicle)
    checks.append(_unique_ids(vehicle, state))
    checks += _parameters(vehicle)
    checks += _fence(session, vehicle)
    checks += _position(session, state)
    checks += _battery(session, state)
    checks += _radar(session)
    if session.rangefinder is not None:
        heard = session.state.now_s - session.rangefinder.heard_s <= _PATIENCE_S
        what = "the one that faces down, of component 1: " + ("heard" if heard else "not heard")
        what += "" if heard else _instead(session, (near_sensing.SECTORS,), AUTOPILOT_COMPONENT)
        checks.append(_check("rangefinder", heard, what, _NO_RANGEFINDER))
    checks += _signing(session)
    return checks


def _check(name: str, passed: bool, what: str, remedy: str = "") -> Check:
    status = CheckStatus.PASSED if passed else CheckStatus.REFUSED
    return Check(name=name, status=status, what=what, remedy="" if passed else remedy)


def _remark(name: str, what: str, remedy: str = "") -> Check:
    return Check(name=name, status=CheckStatus.NOTED, what=what, remedy=remedy)


# --- link, ids


def _heard(session: PreflightInputs) -> Check:
    vehicle, others = session.vehicle, sorted(session.selector.others)
    names = ", ".join(str(system) for system in others)
    if vehicle is not None:
        what = f"{vehicle.autopilot.name}, system {vehicle.system_id}"
        return _check("vehicle", True, what + (f"; also heard: {names}" if others else ""))
    if session.found:
        what = f"{session.found}: none that this mission is for"
        remedy = "Check vehicle.kind and vehicle.autopilot of the mission."
        return _check("vehicle", False, what, remedy)
    return _check("vehicle", False, *not_heard(session))


def not_heard(session: PreflightInputs) -> tuple[str, str]:
    """Why there is no vehicle: what is heard instead; and what to do about it."""
    selector, wanted = session.selector, session.mission.system_id
    others, elsewhere = sorted(selector.others), sorted(selector.elsewhere)
    names = ", ".join(str(system) for system in others)
    if any(wanted in (None, system) for system, _ in elsewhere) or (elsewhere and not others):
        what = f"none was heard as component 1; heard: an autopilot as {ids_in_words(elsewhere)}"
        return what, TO_COMPONENT_1
    if others and wanted is None:
        return f"systems {names} were heard", "Choose one with --system."
    if others:
        what = f"vehicle.system_id = {wanted}: only system {names} was heard"
        return what, "Give the vehicle's own system id with --system, or write it into the mission."
    if session.senders:
        what = f"none was heard: {ids_in_words(session.senders)} without an autopilot's HEARTBEAT"
        return what, "Connect to where the autopilot sends it."
    if session.receiver.passed.total():
        what = "none was heard; what comes in is no MAVLink"
        return what, "Check the baud rate, and that --connect names the autopilot's port."
    return "none was heard", "Start it, or check --connect."


def _link(session: PreflightInputs, vehicle: AutopilotClient) -> Iterator[Check]:
    if session.state.reason is Reason.LINK_LOST:
        lost = Reason.LINK_LOST
        yield _check("link", False, lost.text, lost.remedy)
    missing = vehicle.streams.missing
    what = f"{', '.join(missing)} asked for and not sent" if missing else "all that was asked for"
    yield _check("messages", not missing, what, "Give the link more bandwidth, or check its rates.")
    delay_s = vehicle.round_trip_s
    if delay_s is None:
        yield _remark("link delay", "the vehicle does not answer TIMESYNC: taken as none")
    else:
        what = f"{delay_s * 1e3:.0f} ms there and back"
        ok = delay_s <= _LONG_DELAY_S
        what += (
            "; setpoints are sent so much ahead"
            if ok
            else f", more than {_LONG_DELAY_S * 1e3:.0f} ms"
        )
        yield _check("link delay", ok, what, "Use a faster link.")
    if noise := session.receiver.noise:
        yield _remark("noise", f"passed over: {noise}")


def _unique_ids(vehicle: AutopilotClient, state: State) -> Check:
    """No other component uses the companion's ids."""
    found = state.duplicate_id or is_duplicate_suspected(state)
    ours = f"{vehicle.system_id}/{COMPANION_COMPONENT}"
    what = f"{ours}: {Reason.NOT_ALONE.text}" if found else f"nobody else is {ours}"
    return _check("companion", not found, what, Reason.NOT_ALONE.remedy)


# --- what the autopilot holds


def _parameters(vehicle: AutopilotClient) -> Iterator[Check]:
    if not vehicle.parameters.is_done:
        waiting = ", ".join(vehicle.parameters.waiting) or "no answer"
        yield _check("parameters", False, f"not read: {waiting}", "Check the link.")
        return
    for finding in vehicle.findings:
        refused = finding.severity is Severity.REFUSE
        status = CheckStatus.REFUSED if refused else CheckStatus.NOTED
        what = finding.rule
        if finding.severity is Severity.SET and finding.set_to is not None:
            what = f"{what}; will be set to {finding.set_to:g}"
        value = "missing" if finding.value is None else f"{finding.value:g}"
        remedy = f"{finding.remedy}." if finding.remedy and finding.set_to is None else ""
        yield Check(name=f"{finding.name} = {value}", status=status, what=what, remedy=remedy)
    if not vehicle.findings:
        count = len(vehicle.parameters.values)
        yield _check("parameters", True, f"{count} read, none against the mission")


def _fence(session: PreflightInputs, vehicle: AutopilotClient) -> Iterator[Check]:
    state, mission = session.state, session.mission
    if Item.PLANS not in state.prepared and not vehicle.plans.is_done:
        waiting = ", ".join(vehicle.plans.waiting)
        yield _check("fence", False, f"not read: {waiting}", "Check the link.")
        return
    if mission.fence_from_vehicle and (items := vehicle.plans.changing.get(FENCE)):
        what = f"the fence has changed: reading {items:,} items"
        yield _check("fence", False, what, "Wait until it is read.")
    if not mission.fence_from_vehicle:
        yield _remark("fence", "the vehicle's own fence is left out, as the mission says")
    elif vehicle.fence is not None:
        yield from _against_fence(vehicle.fence, session)
    targets = len(state.targets_ne_m)
    remedy = "Upload a mission with waypoints."
    yield _check("targets", targets > 0, f"{targets} targets", remedy)
    landing = stopped.landing_words(state, session.context)
    if landing:
        yield _remark("landing", landing)


def _against_fence(drawn: fence.Fence, session: PreflightInputs) -> Iterator[Check]:
    against = fence.conflicts(drawn, session.mission.task, session.state.targets_ne_m)
    for line in against:
        what, _, remedy = line.rpartition(". ")
        yield _check("fence", False, what, f"{remedy}.")
    for line in drawn.notes:
        yield _remark("fence", line)
    if drawn.misread:
        what, _, remedy = drawn.misread.rpartition(". ")
        yield _remark("fence", what, f"{remedy}.")
    if not against:
        yield _check("fence", True, f"{len(drawn.zones)} zones of the vehicle's own are kept to")


# --- where it is


def _position(session: PreflightInputs, state: State) -> Iterator[Check]:
    vehicle, limits = state.vehicle, state.task.limits
    distrusted = distrust(vehicle, state.now_s, limits)
    if distrusted is not None:
        yield _check("position", False, distrusted.text, distrusted.remedy)
    here, home = vehicle.position_nea_m, vehicle.home_nea_m
    if here is None:
        return
    if distrusted is None:
        error = "" if vehicle.error_m is None else f", to {vehicle.error_m:.1f} m"
        north_m, east_m = (round(value) + 0 for value in here[:2])
        yield _check("position", True, f"{north_m} m north, {east_m} m east{error}")
    height_m = ground.height_m(state)
    if home is not None:
        what = f"the climb ends {height_m:.0f} m above home"
        yield _check("take-off", height_m > 0.0, what, Reason.HOME_TOO_HIGH.remedy)
    clear = ground.may_take_off(state)
    where = "on the map and clear of zones" if clear else Reason.OUTSIDE.text
    yield _check("place", clear, where, Reason.OUTSIDE.remedy)
    yield from _datum(session, here)


def _datum(session: PreflightInputs, here_nea_m: tuple[float, float, float]) -> Iterator[Check]:
    """The vehicle's AMSL against the ellipsoid, and against the terrain that is known."""
    geoid_m = None if session.vehicle is None else session.vehicle.geoid_m
    if geoid_m is not None:
        what = f"the vehicle's AMSL lies {geoid_m:.1f} m above the ellipsoid"
        ok = abs(geoid_m) <= _LARGEST_GEOID_M
        yield _check("geoid", ok, what, "Its altitudes are not AMSL: check its GPS.")
    known = session.mission.known
    if known is None or not known.is_known(*here_nea_m[:2]):
        return
    row, column = known.cell_of(*here_nea_m[:2])
    above_m = here_nea_m[2] - float(known.upper_m[row, column])
    on_ground = not session.state.airborne
    allowed_m = session.mission.task.error_m + known.cell_m
    ok = not on_ground or above_m > -allowed_m
    side = "above" if above_m >= 0.0 else "below"
    what = f"the vehicle stands {abs(above_m):.0f} m {side} the highest terrain of its cell"
    yield _check("datum", ok, what, "The terrain's vertical datum differs: see terrain.*.")


def _battery(session: PreflightInputs, state: State) -> Iterator[Check]:
    left, mission = state.vehicle.battery, session.mission
    if left is None:
        yield _remark("battery", "the vehicle does not say what is left")
        return
    what = f"{math.floor(100.0 * left + 1e-6)}% left, reserve {100.0 * mission.reserve:g}%"
    if mission.endurance_s is None:
        what += "; battery.endurance_s is not given, so range is not checked"
    lasts = battery_lasts(state, mission)
    what = what if lasts else f"{what}: {Reason.BATTERY_SHORT.text}"
    yield _check("battery", lasts, what, Reason.BATTERY_SHORT.remedy)


def _radar(session: PreflightInputs) -> Iterator[Check]:
    scan, mission = session.last_scan, session.mission
    if mission.near is not None:
        yield from _near_sensor(session, mission.near)
    elif mission.scanner_component_id is None:
        yield _remark("radar", "none: only terrain that is known in advance is flown over")
    elif not session.state.targets_ne_m or session.state.vehicle.position_nea_m is None:
        yield _remark("radar", "not asked: where from and where to is not known")
    elif scan is None or not scan.answered:
        component = mission.scanner_component_id
        what = f"the terrain radar, component {component}, did not answer TERRAIN_REQUEST"
        others = _instead(session, (wire.MAVLINK_MSG_ID_TERRAIN_DATA,), component)
        remedy = "Write the one that it is into vehicle.scanner_component_id."
        yield _check("radar", False, what + others, remedy if others else _NO_RADAR)
    else:
        what = f"{scan.answered} of {scan.asked} blocks answered"
        if scan.answered >= _FEWEST_ANSWERS * scan.asked:
            yield _check("radar", True, what)
        else:  # what is left out stays unknown, and is asked for again in flight
            remedy = "Give its link more bandwidth, or raise planner.scan_time_s."
            yield _remark("radar", f"{what} in time: it sees less at once", remedy)


def _near_sensor(session: PreflightInputs, sensor: NearSensor) -> Iterator[Check]:
    state = session.state
    what = f"{sensor.kind.upper()} of component {sensor.component_id}: {state.vehicle.sight.value}"
    sees, remedy = not state.vehicle.sight.is_blind, Reason.SENSOR_SILENT.remedy
    sender = session.selector.system_id or 0, sensor.component_id
    if not sees and sender not in session.sensed.get(near_sensing.MESSAGES[sensor.kind], ()):
        others = _instead(session, tuple(near_sensing.MESSAGES.values()), None)
        what += others
        remedy = "Write those that it is into scanner.kind and component." if others else remedy
    yield _check("sensor", sees, what, remedy)
    if session.near is None:
        return
    yield from _near_limits(session.near.limits_m, mission=session.mission)
    for words in in_words(session.near.refused):
        yield _remark("sensor", words)


def _near_limits(limits_m: tuple[float, float] | None, mission: Mission) -> Iterator[Check]:
    """What the sensor says of itself against the mission."""
    range_m = mission.task.settings.scan_range_m
    if limits_m is None:
        what = f"it has not told how far it sees: R = {range_m:g} m is believed"
        yield _remark("sensor range", what, "Show it something within its reach.")
        return
    least_m, most_m = limits_m
    what = f"it sees {most_m:g} m, and planner.scan_range_m is {range_m:g} m"
    remedy = f"Set planner.scan_range_m to {most_m:g} or less, or use a sensor that sees farther."
    yield _check("sensor range", most_m >= range_m - _RANGE_ROUNDED_M, what, remedy)
    if mission.near is not None and least_m > mission.near.blind_m + _RANGE_ROUNDED_M:
        what = f"it sees nothing nearer than {least_m:g} m, and scanner.blind_m is less"
        yield _remark("sensor range", what, f"Raise scanner.blind_m to {least_m:g}.")


def _instead(session: PreflightInputs, numbers: tuple[int, ...], component: int | None) -> str:
    """Who else sends these messages, as text; component: of who should, None: nobody."""
    ours = session.selector.system_id
    found = []
    for number in numbers:
        senders = sorted(session.sensed.get(number, set()) - {(ours or 0, component or 0)})
        if senders:
            found.append(f"{wire.mavlink_map[number].msgname} of {ids_in_words(senders)}")
    return f"; heard: {'; '.join(found)}" if found else ""


# --- signing and clock


def _signing(session: PreflightInputs) -> Iterator[Check]:
    signed = session.receiver.signed
    if session.signing is None:
        if signed:
            remedy = "Give the key with --signing-key."
            yield _check("signing", False, "the vehicle signs, and no key was given", remedy)
        else:
            yield _remark("signing", "the link is not signed")
        return
    refused = sum(session.signing.refused.values())
    what = f"{signed} signed frames accepted, {refused} refused"
    yield _check("signing", signed > 0, what, "Set the same key up on the vehicle.")
    remedy = "Set this computer's clock."
    is_set = session.signing.timestamp > timestamp_of(_EARLIEST_S)
    yield _check("clock", is_set, "this computer's clock", remedy)


# --- all of it


def flight_check(session: PreflightInputs) -> Check:
    """The mission machine's own verdict on a vehicle that has passed the checks."""
    context = Context(mission=session.mission, seed=0)
    state = session.state
    prepared = state.prepared | {Item.CHECKS}
    state = replace(state, prepared=prepared, reason=None, since_s=state.now_s - _LISTENED_S)
    event = Tick(time_s=state.now_s)
    after, _, trigger = ground.preparing(state, event, context)
    if trigger is None:  # it would wait, and what for it says at the end
        late = replace(state, since_s=-1e9)
        after, _, trigger = ground.preparing(late, event, context)
    if trigger is Trigger.GIVE_UP and after.reason is not None:
        remedy = after.remedy or after.reason.remedy
        return _check("ready", False, f"{after.reason.text}{after.detail}", remedy)
    if trigger is not Trigger.READY:
        return _remark("ready", "it is in the air: it would be taken over there")
    return _check("ready", True, "it would be armed and take off, once somebody says go")
