"""Rows of what changes: modes, arming, landing, fixes, estimators."""

from collections.abc import Callable, Hashable, Iterator
from typing import Any, NamedTuple

from conformance.log import enum_name
from conformance.rows import Comparison, Row, changes, interval_s, paired, timed_rows

_ARMED = 0x80
_SLOWEST_S = 2.1


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
    _State("current mode", 436, _field("custom_mode")),
    _State("intended mode", 436, _field("intended_custom_mode")),
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
