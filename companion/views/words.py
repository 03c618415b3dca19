"""The entries of a journal in words, for people."""

import math
from typing import Final

from companion.mavlink.dialect import wire
from companion.mission import journal as noted
from companion.mission.journal import Entry

BAD: Final = "bad"
"""Marks what went wrong, or stopped the vehicle."""
_BAD_PHASES: Final = ("holding", "faulted", "handing over")


def entry_words(entry: Entry) -> tuple[str, str] | None:
    """What an entry says, and `BAD` or nothing; None: nothing that people would miss."""
    match entry:
        case noted.Phase(phase=phase, reason=reason):
            why = f": {reason}" if reason else ""
            return f"{phase}{why}", BAD if phase in _BAD_PHASES else ""
        case noted.LegBegun(number=number):
            return f"begins subpath {number}", ""
        case noted.ScanDone():
            return f"scan: {entry.blocks_answered} of {entry.blocks_asked} blocks answered", (
                BAD if entry.blocks_answered < entry.blocks_asked else ""
            )
        case noted.PlanReady(certificate=proven):
            says = f"plan {entry.plan_id}: {metres(entry.length_m)}"
            says += " to the target" if entry.reaches_target else ""
            if proven.broken:
                return f"{says}, not proven: {', '.join(proven.broken)}", BAD
            return f"{says}, {metres(proven.clearance_m)} or more from terrain", ""
        case noted.PlanRefused(reason=reason, broken=broken):
            bounds = f" ({', '.join(broken)})" if broken else ""
            return f"plan {entry.plan_id}: none, {_plain(reason)}{bounds}", BAD
        case noted.Fence(zones=zones):
            return f"the vehicle's fence: {len(zones)} zones", ""
        case noted.Targets(targets_ne_m=targets):
            return f"the vehicle's mission: {len(targets)} targets", ""
        case noted.CommandHeard(sender=sender, command=number, result=result, why=why):
            known = wire.enums["MAV_CMD"].get(number)
            name = f"command {number}" if known is None else _plain(known.name[len("MAV_CMD_") :])
            answer = f": {_plain(result.removeprefix('MAV_RESULT_'))}" if result else ""
            reason = f" ({why})" if why else ""
            return f"{sender} asks for {name}{answer}{reason}", BAD if why else ""
        case noted.OrderGiven(order=order, sender=sender):
            return f"order of {sender}: {_plain(order)}{_order_values(entry)}", ""
        case noted.VehicleFound(name=name, system_id=system_id):
            return f"found {name}, system {system_id}", ""
        case noted.Prepared(item=item, refusal=refusal):
            return (f"{item}: {refusal}", BAD) if refusal else None
        case noted.LinkLost(silent_s=silent_s):
            return f"link lost: nothing was heard for {silent_s:g} s", BAD
        case noted.LinkDelay(round_trip_s=trip_s):
            return f"link delay: {trip_s * 1e3:.0f} ms to the vehicle and back", ""
        case noted.MessagesDropped(count=count):
            return f"{count} messages dropped: they arrived faster than they could be handled", BAD
        case noted.Resumed(lost=lost, map_lost=map_lost):
            missing = "; ".join(each for each in (lost, map_lost) if each)
            return "the companion was started again" + (f": {missing}" if missing else ""), BAD
        case noted.PartDied(part=part, error=error):
            return f"a part of the companion has died{f' ({part})' if part else ''}: {error}", BAD
        case noted.Said(text=text, warning=warning):
            return f"companion: {text}", BAD if warning else ""
        case noted.VehicleSays(text=text):
            return f"vehicle: {text}", ""
        case noted.End(outcome=outcome, reason=reason):
            return f"{outcome}: {reason}", "" if outcome == "arrived" else BAD
        case _ if type(entry) in _PLAIN:
            words, is_bad = _PLAIN[type(entry)]
            return words.format(entry=entry), BAD if is_bad else ""
        case _:
            return None


_PLAIN: Final[dict[type[Entry], tuple[str, bool]]] = {
    noted.StopAsked: ("a person asked for the end", True),
    noted.PlanLate: ("plan {entry.plan_id} was not ready in time", True),
    noted.Setting: ("setting: {entry.what}", False),
    noted.VehicleRebooted: ("the autopilot has rebooted", True),
    noted.AnotherCompanion: ("another companion uses the same ids", True),
    noted.ModeAsked: ("asks the autopilot for the mode {entry.mode}", False),
    noted.ArmAsked: ("arms the vehicle", False),
    noted.TakeOffAsked: ("takes off, to {entry.above_home_m:.0f} m above home", False),
    noted.SetpointRefused: ("a setpoint out of range was not sent: {entry.setpoint}", True),
}


def metres(length_m: float | None) -> str:
    """A length as people read it."""
    if length_m is None or math.isnan(length_m):
        return "unknown"
    if math.isinf(length_m):
        return "unbounded"
    if abs(length_m) >= 10_000.0:
        return f"{length_m / 1000.0:,.1f} km"
    return f"{length_m:,.{0 if abs(length_m) >= 50.0 else 1 if abs(length_m) >= 5.0 else 2}f} m"


def _plain(name: str) -> str:
    return name.lower().replace("_", " ")


def _order_values(order: noted.OrderGiven) -> str:
    """Where to, or how fast, if it says so."""
    if order.target_ne_m is not None:
        north_m, east_m = order.target_ne_m
        return f" to {metres(north_m)} north, {metres(east_m)} east"
    return "" if order.speed_m_s is None else f" {order.speed_m_s:g} m/s"
