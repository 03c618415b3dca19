"""Preflight checks: the vehicle's reports against the mission.

One list, for `companion preflight`, which shows it, and for `fly`, which does not arm before it has
passed (`Preflight`).
"""

import math
from collections.abc import Iterator
from typing import Protocol, final

from companion.mavlink import fence
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mavlink.checks import PATIENCE_S, Check, CheckStatus, check, remark
from companion.mavlink.dialect import COMPANION_COMPONENT
from companion.mavlink.frames import Receiver
from companion.mavlink.link import TO_COMPONENT_1, VehicleSelector, ids_in_words
from companion.mavlink.plan_client import FENCE
from companion.mavlink.sensors import Sensor
from companion.mavlink.signing import Signing
from companion.mission import ground, stopped
from companion.mission.battery import battery_lasts
from companion.mission.decisions import Context
from companion.mission.events import Item, Landed, Prepared, ScanDone, Vector
from companion.mission.health import distrust
from companion.mission.mission import Mission
from companion.mission.state import Phase, Reason, State

_MAX_LOOKS = 3
_CHECK_S = 1.0  # between two looks at a vehicle that waits
_LOOK_AGAIN_S = 60.0
"""Between two scans of a vehicle that waits: a radar that is off is told before the flight."""


class PreflightInputs(Protocol):
    """The part of a session that the checks read."""

    state: State
    last_scan: ScanDone | None
    mission: Mission
    context: Context
    vehicle: AutopilotClient | None
    vehicle_name: str
    selector: VehicleSelector
    receiver: Receiver
    signing: Signing | None
    sensors: tuple[Sensor, ...]

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
        self._looked_s = self._checked_s = -math.inf
        self._begin(math.nan)

    def _begin(self, preparing_since_s: float) -> None:
        """The vehicle is prepared, or prepared anew."""
        self._preparing_since_s = preparing_since_s
        self._looked, self._looks = False, 0
        self._failing_s = math.inf
        """Since when it does not pass."""
        self._last_refusal = ""

    def scan_position(self, heard: PreflightInputs) -> Vector | None:
        """Position to scan from now; None if no scan is needed."""
        state, position = heard.state, heard.state.vehicle.position_nea_m
        if position is None or state.phase not in (Phase.PREPARING, Phase.READY):
            return None
        if state.phase is Phase.READY:
            if heard.mission.near or _is_within(_LOOK_AGAIN_S, self._looked_s, state.now_s):
                return None
        else:
            if state.stage.since_s != self._preparing_since_s:
                self._begin(state.stage.since_s)
            if self._looked or state.airborne or not state.targets_ne_m or heard.context.shadow:
                return None
            if distrust(state.vehicle, state.now_s, state.task.limits) is not None:
                return None
            heard.last_scan = None  # of one that is ready, what the last scan saw counts till then
            self._looked, self._looks = True, self._looks + 1
        self._looked_s = state.now_s
        return position

    def judged(self, heard: PreflightInputs, *, at_once: bool = False) -> Prepared | None:
        """That the checks have passed, or which has failed for some seconds; None: nothing new.

        Of a vehicle that is ready, only what fails.  at_once: a moment is enough; somebody has said
        go.
        """
        state, now_s = heard.state, heard.state.now_s
        ready = state.phase is Phase.READY
        asked = self._looked and heard.last_scan is not None and Item.CHECKS not in state.prepared
        prepares = state.phase is Phase.PREPARING and asked and not waiting_for(heard)
        seldom = (ready or bool(self._last_refusal)) and not at_once
        waits = seldom and _is_within(_CHECK_S, self._checked_s, now_s)
        if waits or not (ready or prepares):
            return None
        self._checked_s = now_s
        refused = (each for each in checks_of(heard) if each.status is CheckStatus.REFUSED)
        if (first := next(refused, None)) is None:
            self._failing_s = math.inf
            return None if ready else Prepared(time_s=now_s, item=Item.CHECKS)
        waited = bool(state.unready) and now_s - self._looked_s > _LOOK_AGAIN_S
        if not ready and first.name == "radar" and (self._looks < _MAX_LOOKS or waited):
            self._looked = False
            return None
        self._failing_s = min(self._failing_s, now_s)
        if not at_once and now_s - self._failing_s < PATIENCE_S:
            return None
        refusal = f"{first.name}: {first.what}"
        again, self._last_refusal = refusal == self._last_refusal and not ready, refusal
        prepared = Prepared(time_s=now_s, item=Item.CHECKS, refusal=refusal, remedy=first.remedy)
        return None if again else prepared


def _is_within(period_s: float, since_s: float, now_s: float) -> bool:
    """Whether less has passed; after a clock that fell, not."""
    return 0.0 <= now_s - since_s < period_s


def waiting_for(heard: PreflightInputs) -> str:
    """What is still missing, as text; empty if nothing."""
    state, vehicle = heard.state, heard.vehicle
    if vehicle is None:
        return "the vehicle's heartbeat"
    answered = {Item.PARAMETERS: vehicle.parameters.is_done, Item.PLANS: vehicle.plans.is_done}
    waits = [item.value for item, done in answered.items() if not done]  # refused or not
    if state.vehicle.home_nea_m is None:
        waits.append("home")
    if distrusted := distrust(state.vehicle, state.now_s, state.task.limits):
        waits.append(f"its position ({distrusted.text})")
    return ", ".join(waits)


def checks_of(session: PreflightInputs) -> list[Check]:
    """All checks, in the order of a manual checklist."""
    vehicle = session.vehicle
    if vehicle is None:
        return [check("vehicle", False, *not_heard(session))]
    state, scan, heard = session.state, session.last_scan, ids_in_words(session.senders)
    return [
        *_link(session, vehicle),
        *_parameters(vehicle),
        *_fence(session, vehicle),
        *_position(session),
        _battery(session),
        *(each for sensor in session.sensors for each in sensor.checks(state, scan, heard)),
        *_signing(session),
    ]


# --- link, ids


def not_heard(session: PreflightInputs) -> tuple[str, str]:
    """Why there is no vehicle: what is heard instead; and what to do about it."""
    if session.vehicle_name:
        what = f"{session.vehicle_name}: none that this mission is for"
        return what, "Check vehicle.kind and vehicle.autopilot of the mission."
    selector, wanted = session.selector, session.mission.system_id
    others, elsewhere = sorted(selector.others), sorted(selector.elsewhere)
    names, nobody = ", ".join(map(str, others)), Reason.NO_VEHICLE.text
    if any(wanted in (None, system) for system, _ in elsewhere) or (elsewhere and not others):
        what = f"{nobody} as component 1; heard: an autopilot as {ids_in_words(elsewhere)}"
        return what, TO_COMPONENT_1
    if others and wanted is None:
        return f"systems {names} were heard", "Choose one with --system."
    if others:
        what = f"vehicle.system_id = {wanted}: only system {names} was heard"
        return what, "Give the vehicle's own system id with --system, or write it into the mission."
    if session.senders:
        what = f"{nobody}: {ids_in_words(session.senders)} without an autopilot's HEARTBEAT"
        return what, "Connect to where the autopilot sends it."
    if session.signing is not None and session.signing.refused:
        what = f"{nobody}; what comes in is not signed with this key"
        return what, "Set the same key up on the vehicle."
    if session.receiver.passed:
        what = f"{nobody}; what comes in is no MAVLink"
        return what, "Check the baud rate, and that --connect names the autopilot's port."
    return nobody, Reason.NO_VEHICLE.remedy


def _link(session: PreflightInputs, vehicle: AutopilotClient) -> Iterator[Check]:
    state = session.state
    what = f"{vehicle.autopilot.name}, system {vehicle.system_id}"
    if others := ", ".join(map(str, sorted(session.selector.others))):
        what += f"; also heard: {others}"
    yield check("vehicle", True, what)
    if state.reason is Reason.LINK_LOST:
        yield check("link", False, Reason.LINK_LOST.text, Reason.LINK_LOST.remedy)
    missing = vehicle.streams.missing
    what = f"{', '.join(missing)} asked for and not sent" if missing else "all that was asked for"
    yield check("messages", not missing, what, "Give the link more bandwidth, or check its rates.")
    is_doubled = state.duplicate_id or state.is_duplicate_suspected
    our_ids = f"{vehicle.system_id}/{COMPANION_COMPONENT}"
    what = f"{our_ids}: {Reason.NOT_ALONE.text}" if is_doubled else f"nobody else is {our_ids}"
    yield check("companion", not is_doubled, what, Reason.NOT_ALONE.remedy)


# --- what the autopilot holds


def _parameters(vehicle: AutopilotClient) -> Iterator[Check]:
    if not vehicle.parameters.is_done:
        yield check("parameters", False, _not_read(vehicle.parameters.waiting), "Check the link.")
        return
    for finding in vehicle.findings:
        name = f"{finding.name} = " + ("missing" if finding.value is None else f"{finding.value:g}")
        if finding.set_to is not None:
            yield remark(name, f"{finding.rule}; will be set to {finding.set_to:g}")
        else:
            remedy = f"{finding.remedy}." if finding.remedy else ""
            yield check(name, False, finding.rule, remedy)
    if not vehicle.findings:
        count = len(vehicle.parameters.values)
        yield check("parameters", True, f"{count} read, none against the mission")


def _fence(session: PreflightInputs, vehicle: AutopilotClient) -> Iterator[Check]:
    state, mission = session.state, session.mission
    if Item.PLANS not in state.prepared and not vehicle.plans.is_done:
        yield check("fence", False, _not_read(vehicle.plans.waiting), "Check the link.")
        return
    if not mission.fence_from_vehicle:
        yield remark("fence", "the vehicle's own fence is left out, as the mission says")
    elif items := vehicle.plans.plans[FENCE].changing:
        what = f"the fence has changed: reading {items:,} items"
        yield check("fence", False, what, "Wait until it is read.")
    elif (drawn := vehicle.own_fence.fence) is not None:
        against = fence.conflicts(drawn, mission.task, state.targets_ne_m)
        yield from (check("fence", False, *_parted(line)) for line in against)
        yield from (remark("fence", line) for line in drawn.notes)
        if drawn.misread:
            yield remark("fence", *_parted(drawn.misread))
        if not against:
            yield check("fence", True, f"{len(drawn.zones)} zones of the vehicle's own are kept to")
    elif vehicle.parameters.is_done:
        is_known = state.vehicle.home_nea_m is not None
        what = "it is being read" if is_known else "it is drawn about home, which is not known"
        yield check("fence", False, what, "Wait for it.")
    targets = len(state.targets_ne_m)
    what = f"{targets} target{'' if targets == 1 else 's'}"
    yield check("targets", targets > 0, what, "Upload a mission with waypoints.")
    if landing := stopped.landing_words(state, session.context):
        yield remark("landing", landing)


def _not_read(waiting: tuple[str, ...]) -> str:
    return f"not read: {', '.join(waiting)}"


def _parted(line: str) -> tuple[str, str]:
    """A line that ends with its remedy, in two."""
    what, _, remedy = line.rpartition(". ")
    return what, f"{remedy}."


# --- where it is


def _position(session: PreflightInputs) -> Iterator[Check]:
    state, vehicle = session.state, session.state.vehicle
    on_ground, position = vehicle.landed is Landed.ON_GROUND, vehicle.position_nea_m
    if vehicle.armed and on_ground and not state.armed_by_us:
        yield check("armed", False, Reason.ARMED_ALREADY.text, Reason.ARMED_ALREADY.remedy)
    if distrusted := distrust(vehicle, state.now_s, state.task.limits):
        is_early = distrusted is Reason.NO_FIX and vehicle.fix_at_s < 0.0
        what = "no GPS fix was heard yet" if is_early else distrusted.text
        yield check("position", False, what, distrusted.remedy)
    elif position is not None:
        error = "" if vehicle.error_m is None else f", to {vehicle.error_m:.1f} m"
        north_m, east_m = (round(value) + 0 for value in position[:2])
        yield check("position", True, f"{north_m} m north, {east_m} m east{error}")
    if position is None:
        return
    if vehicle.home_nea_m is not None:
        height_m = ground.height_m(state)
        what = f"the climb ends {height_m:.0f} m above home"
        yield check("take-off", height_m > 0.0, what, Reason.HOME_TOO_HIGH.remedy)
    clear = ground.may_take_off(state)
    where = "on the map and clear of zones" if clear else Reason.OUTSIDE.text
    yield check("place", clear, where, Reason.OUTSIDE.remedy)
    known = session.mission.known
    if known is not None and known.is_known(*position[:2]):
        above_m = position[2] - float(known.upper_m[known.cell_of(*position[:2])])
        ok = state.airborne or above_m > -(session.mission.task.error_m + known.cell_m)
        side = "above" if above_m >= 0.0 else "below"
        what = f"the vehicle stands {abs(above_m):.0f} m {side} the highest terrain of its cell"
        yield check("datum", ok, what, "The terrain's vertical datum differs: see terrain.*.")


def _battery(session: PreflightInputs) -> Check:
    state, mission = session.state, session.mission
    left = state.vehicle.battery
    if left is None:
        return remark("battery", "the vehicle does not say what is left")
    what = f"{math.floor(100.0 * left + 1e-6)}% left, reserve {100.0 * mission.reserve:g}%"
    if mission.endurance_s is None:
        what += "; battery.endurance_s is not given, so range is not checked"
    lasts = battery_lasts(state, mission)
    what = what if lasts else f"{what}: {Reason.BATTERY_SHORT.text}"
    return check("battery", lasts, what, Reason.BATTERY_SHORT.remedy)


# --- sensors


def _signing(session: PreflightInputs) -> Iterator[Check]:
    """A link on which one of the two signs."""
    signed = session.receiver.signed
    if session.signing is not None:
        yield check("signing", True, f"{signed} signed frames heard")  # else no vehicle is
    elif signed:
        what = "the vehicle signs, and no key was given"
        yield check("signing", False, what, "Give the key with --signing-key.")
