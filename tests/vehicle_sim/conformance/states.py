"""Rows of what changes: modes, arming, landing, fixes, estimators, texts and events."""

import dataclasses
import re
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, NamedTuple

from conformance.log import EVENT, enum_name
from conformance.rows import (
    NOTHING,
    Comparison,
    Row,
    changes,
    interval_s,
    paired,
    row,
    timed_row,
    timed_rows,
)

_ARMED = 0x80
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
_DIRECTION = re.compile(r"\b(direction|heading|deg)\b")
_WHOLE_MAY_DIFFER, _OTHERS_MAY_DIFFER, _PART_MAY_DIFFER = 1.0, 0.2, 0.02
"""Numbers in a text: whole ones, others, and either by this part if that is more."""
_SLOWEST_S = 2.1
_STATUSTEXT, _COMMAND_LONG = 253, 76


class _State(NamedTuple):
    kind: str
    message: int
    value: Callable[[Any], Hashable]


def _mode_of(vehicle: str) -> Callable[[Hashable], str]:
    enum = {"ardupilot copter": "COPTER_MODE", "ardupilot plane": "PLANE_MODE"}.get(vehicle)

    def label(value: Hashable) -> str:
        assert isinstance(value, int)
        return f"{value:#010x}" if enum is None else enum_name(enum, value)

    return label


def _tuple_of(*fields: str) -> Callable[[Any], Hashable]:
    return lambda m: tuple((f, getattr(m, f)) for f in fields)


def _field(name: str) -> Callable[[Any], Hashable]:
    return lambda m: getattr(m, name)


_STATES = (
    _State("mode", 0, _field("custom_mode")),
    _State("armed", 0, lambda m: "armed" if m.base_mode & _ARMED else "disarmed"),
    _State("base mode", 0, lambda m: m.base_mode & ~_ARMED),
    _State("system status", 0, lambda m: enum_name("MAV_STATE", m.system_status)),
    _State("vehicle", 0, _tuple_of("type", "autopilot", "mavlink_version")),
    _State("landed", 245, lambda m: enum_name("MAV_LANDED_STATE", m.landed_state)),
    _State("vtol", 245, _field("vtol_state")),
    _State("fix", 24, lambda m: enum_name("GPS_FIX_TYPE", m.fix_type)),
    _State("estimator", 193, _field("flags")),
    _State("estimator", 230, _field("flags")),
    _State("sensors", 1, lambda m: ("present", m.onboard_control_sensors_present)),
    _State("sensors", 1, lambda m: ("enabled", m.onboard_control_sensors_enabled)),
    _State("sensors", 1, lambda m: ("health", m.onboard_control_sensors_health)),
    _State("current mode", 436, _field("custom_mode")),
    _State("intended mode", 436, _field("intended_custom_mode")),
    _State("standard mode", 436, _field("standard_mode")),
    _State("mission", 42, _tuple_of("seq", "total", "mission_state", "mission_mode")),
    _State("echo", 85, _tuple_of("coordinate_frame", "type_mask")),
    _State("echo", 87, _tuple_of("coordinate_frame", "type_mask")),
)


def state_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each change of each state."""
    recording = comparison.recording
    mode = _mode_of(f"{recording.firmware} {recording.kind}")
    for state in _STATES:
        real = comparison.real.of(state.message)
        label = mode if state.kind.endswith("mode") and state.kind[0] in "mci" else _label
        matches = paired(
            changes(real, state.value), changes(comparison.simulated.of(state.message), state.value)
        )
        seen_s = min(interval_s([t for t, _ in real]), _SLOWEST_S)
        yield from timed_rows(comparison, state.kind, matches, label, interval_s=seen_s)


def _label(value: Hashable) -> str:
    if isinstance(value, tuple):
        return ", ".join(_label(v) for v in value) if _is_pairs(value) else _pair(value)
    return f"{value:#x}" if isinstance(value, int) else str(value)


def _is_pairs(value: tuple[Any, ...]) -> bool:
    return bool(value) and isinstance(value[0], tuple)


def _pair(value: tuple[Any, ...]) -> str:
    name, number = value
    return f"{name} {number:#x}" if number > 9 else f"{name} {number}"


# --- texts and events -----------------------------------------------------------------------------


class _Said(NamedTuple):
    severity: int
    pattern: str


def text_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each STATUSTEXT: severity, wording, numbers and time."""
    sides = [
        [(t, _Said(m.severity, _pattern(m.text)), m.text) for t, m in side.of(_STATUSTEXT)]
        for side in (comparison.real, comparison.simulated)
    ]
    real, simulated = ([(t, said) for t, said, _ in side] for side in sides)
    for match in paired(real, simulated):
        words = [
            None if event is None else next(text for t, s, text in side if (t, s) == event)
            for event, side in zip(match, sides, strict=True)
        ]
        timed = timed_row(comparison, "text", match, _text_label, more=_numbers_differ(*words))
        shown = " but ".join(dict.fromkeys(w for w in words if w is not None))
        yield dataclasses.replace(timed, name=f"{shown} ({timed.name})")


def _text_label(said: _Said) -> str:
    return enum_name("MAV_SEVERITY", said.severity).lower()


def _pattern(text: str) -> str:
    """The text with a # for each number that may differ: not those that belong to a name."""
    return _NUMBER.sub("#", text) if _measures(text) else text


def _measures(text: str) -> bool:
    """Numbers of an IMU, a GPS or a lane are part of what is said; measured ones have a unit."""
    return bool(re.search(r"\d+(\.\d+)?( ?(m|m/s|m/s/s|deg|sec|s|V|%))\b|= ?-?\d", text))


def _numbers_differ(one: str | None, other: str | None) -> float:
    """The worst difference between the numbers of two texts, in tolerances."""
    if one is None or other is None or not _measures(one):
        return 0.0
    worst = 0.0
    for a, b in zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=False):
        least = _OTHERS_MAY_DIFFER if "." in a else _WHOLE_MAY_DIFFER
        allowed = max(least, _PART_MAY_DIFFER * abs(float(a)))
        difference = abs(float(a) - float(b))
        if _DIRECTION.search(one):
            difference = min(difference, abs(360.0 - difference))
        worst = max(worst, difference / allowed)
    return worst


def event_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each EVENT by id and time, and one for the arguments of all with that id."""
    sides = [s.of(EVENT) for s in (comparison.real, comparison.simulated)]
    real, simulated = ([(t, (m.id, m.log_levels)) for t, m in side] for side in sides)
    yield from timed_rows(comparison, "event", paired(real, simulated), _event_label)
    arguments = [_arguments(side) for side in sides]
    for number in sorted(arguments[0]):
        ours, theirs = arguments[0][number], arguments[1].get(number, [])
        shown = [" ".join(a.hex() or NOTHING for a in side) or NOTHING for side in (ours, theirs)]
        yield row("event arguments", f"event {number}", shown, "equal", ours != theirs)


def _event_label(key: tuple[int, int]) -> str:
    return f"event {key[0]} (levels {key[1]:#x})"


def _arguments(side: Sequence[tuple[float, Any]]) -> dict[int, list[bytes]]:
    found = dict[int, list[bytes]]()
    for _, message in side:
        found.setdefault(message.id, []).append(message.arguments)
    return found


def order_rows(comparison: Comparison) -> Iterator[Row]:
    """A row for each COMMAND_LONG that the autopilot itself sends (PX4: to gimbals)."""
    real, simulated = (
        [(t, (m.command, m.confirmation, _rounded(m))) for t, m in side.of(_COMMAND_LONG)]
        for side in (comparison.real, comparison.simulated)
    )
    yield from timed_rows(comparison, "order", paired(real, simulated), _order_label)


def _rounded(message: Any) -> tuple[str, ...]:
    """The parameters as text: NaN is not equal to itself."""
    return tuple(f"{getattr(message, f'param{i}'):g}" for i in range(1, 8))


def _order_label(key: tuple[int, int, tuple[str, ...]]) -> str:
    return f"command {key[0]} ({', '.join(key[2])}), confirmation {key[1]}"
