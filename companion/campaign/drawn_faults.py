"""Fault scripts drawn at random: what goes wrong, when, how badly and for how long.

A script is a function of (family, seed, index) and of the vehicle.  It is a timeline of the
simulator's (docs/reference/faults.md), with lines that the simulator does not know (`split`):
`companion_off` kills the companion, which is started again afterwards.
"""

import re
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from companion.mavlink.autopilots import named
from companion.mission.events import Mode

FAMILIES: Final = ("single", "combined")
"""One thing after the other from a list; two or three of them."""
KILLED: Final = "companion_off"
_FROM_S: Final = 35.0
"""About when vehicles are in the air."""
_UNTIL_S: Final = {"copter": 110.0, "plane": 140.0}
_PLANES_SIZE: Final = 3.5
"""Of fences and distances: planes need more room."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FaultScript:
    """Which one of a family."""

    family: str
    seed: int
    index: int

    def __str__(self) -> str:
        return f"{self.family}-{self.seed}/{self.index}"


class Subject(NamedTuple):
    """What a script is drawn for."""

    vehicle: str
    """`ardupilot-copter`, ..."""
    speed_m_s: float


# --- timelines

_LINE: Final = re.compile(r"at ([\d.]+) s(?: for ([\d.]+) s)?: *(\S.*)")


class Happening(NamedTuple):
    """One line of a timeline."""

    at_s: float
    until_s: float
    """Infinite: it stays, or it happens once."""
    what: str


def happenings(timeline: str) -> list[Happening]:
    """The lines whose times are in seconds."""
    found = (_LINE.fullmatch(line.strip()) for line in timeline.splitlines())
    return [
        Happening(float(each[1]), float(each[1]) + float(each[2] or "inf"), each[3])
        for each in found
        if each is not None
    ]


def split(timeline: str) -> tuple[str, list[Happening]]:
    """The simulator's part of a timeline, and when the companion is killed."""
    rest, ours = list[str](), list[str]()
    for line in timeline.splitlines():
        (ours if line.rpartition(":")[2].strip() == KILLED else rest).append(line)
    return "\n".join(rest), sorted(happenings("\n".join(ours)))


# --- what is drawn

ROWS: Final = {
    "gps_off": "gps_off for 0.5..25.0 s",
    "gps_glitch": "gps_glitch 3..90 m {side} for 1.0..30.0 s",
    "gps_drift": "gps_drift 0.3..4.0 m/s {side} for 5.0..30.0 s",
    "gps_jam": "gps_jam for 1.0..15.0 s",
    "gps_noise": "gps_noise 0.3..3.0 m for 10..60 s",
    "gps_delay": "gps_delay 100..600 ms for 10..60 s",
    "gps_satellites": "gps_satellites 0..8 for 1.0..25.0 s",
    "wind": "wind 3.0..{gale} m/s from 0..360 deg turbulence 0.0..1.5 m/s rising -5..5 deg",
    "turbulence": "turbulence 0.5..2.5 m/s",
    "battery": "battery 3..40 %",
    "battery_voltage": "battery_voltage 9.5..12.0 V",
    "link_off": "link_off{way} for 0.2..25.0 s",
    "link_loss": "link_loss 3..60 %{way} for 10..60 s",
    "link_delay": "link_delay 20..700 ms jitter 0..200 ms{way} for 5.0..60.0 s",
    "link_duplication": "link_duplication 5..80 %",
    "frames overtake": "link_delay 0 ms jitter 5..60 ms",
    "link_loss for good": "link_loss 1..40 %{way}",
    "radar_off": "radar_off for 2.0..40.0 s",
    "radar_blind": "radar_blind for 2.0..40.0 s",
    "radar_drop": "radar_drop 2..50 %",
    "radar_loss": "radar_loss 2..70 %",
    "radar_noise": "radar_noise 0.5..8.0 m[| either_way]",
    "radar_delay": "radar_delay 50..1500 ms for 5.0..60.0 s",
    "radar_rate": "radar_rate 0.5..8.0 Hz for 5.0..60.0 s",
    "setpoints_ignored": "setpoints_ignored for 0.5..15.0 s",
    "estimator_reset": "estimator_reset 1..50 m {side}",
    "origin_move": "origin_move 2..60 m {side} 1..15 m [up|down]",
    "pilot": "pilot",
    "reboot": "reboot",
    "few satellites": "gps_satellites 3..8 for 2.0..25.0 s",
    "nothing": "",
    "pilot, and back": "pilot; after 2.0..6.0 s: [{go_on}|{guided}]",
    "station selects return": "{returns}",
    "told to return": "ground_command 20",
    "told to land": "ground_command 21",
    "new fence ahead": "ground_fence 15..35L m 60..180L m ahead",
    "new fence around it": "ground_fence 15..35L m 0..15L m ahead",
    # a person leaves it to the companion again
    "stopped by its own fence, and back": "ground_command 207 1 to_autopilot; after 0.1..0.2 s: "
    "ground_fence 15..35L m 0..15L m ahead; after 8.0..30.0 s: {go_on}",
    "pause and continue": "ground_command 193 0; after 1.0..15.0 s: {go_on}",
    "new target": "ground_target 30..200L m [north|south] 30..200L m [east|west]",
    "change of speed": "ground_command 178 1 0.4..1.3V",
    "link lost for long": "link_off for 30.0..60.0 s",
    "companion killed, restarted": f"{KILLED} for 0.3..8.0 s",
}
"""What may go wrong, in lines of the simulator's, from some moment on or for so long.

`3..90`: a number between, with as many decimals; L: times the size of the vehicle, V: its speed.
`[a|b]`: one of them.  `after`: so long after the first line.
"""
_RANGE: Final = re.compile(r"(-?[\d.]+)\.\.([\d.]+)([LV]?)")
_CHOICE: Final = re.compile(r"\[([^]]*)\]")


def drawn(script: FaultScript, subject: Subject) -> tuple[str, str]:
    """What it is called, and its timeline."""
    names = [name for name in ROWS if _applies(name, subject.vehicle)]
    rng = np.random.default_rng((FAMILIES.index(script.family), script.seed, script.index))
    chosen = [names[script.index % len(names)]]
    if script.family == "combined":
        chosen = list(rng.choice(names, int(rng.integers(2, 4)), replace=False))
    lines = [line for name in chosen for line in _lines(ROWS[name], subject, rng)]
    return " + ".join(chosen), "\n".join(lines)


def _applies(name: str, vehicle: str) -> bool:
    """Where it cannot happen: PX4 has no such fault; ArduCopter's fence is a cylinder as well."""
    if name == "battery_voltage":
        return vehicle.startswith("ardupilot")
    return name != "stopped by its own fence, and back" or vehicle != "ardupilot-copter"


def _lines(row: str, subject: Subject, rng: np.random.Generator) -> list[str]:
    autopilot, kind = subject.vehicle.split("-")
    strategy, go_on = named(autopilot, kind), "ground_command 193 1"
    returns, guided = (
        f"ground_command 176 1 {' '.join(map(str, strategy.modes.asked[mode]))} to_autopilot"
        for mode in (Mode.RETURN, Mode.GUIDED)
    )
    row = row.format(
        side="[north|east|south|west]",
        way="[| to_vehicle| from_vehicle]",
        gale="9.0" if kind == "copter" else "7.0",
        go_on=go_on,
        returns=returns,
        guided=go_on if strategy.traits.needs_setpoints_before_offboard else guided,
    )
    scales = {"": 1.0, "L": 1.0 if kind == "copter" else _PLANES_SIZE, "V": subject.speed_m_s}

    def number(found: re.Match[str]) -> str:
        low, high, scale = found.groups()
        value = scales[scale] * rng.uniform(float(low), float(high))
        return f"{value:.{len(high.partition('.')[2])}f}"

    at_s, lines = rng.uniform(_FROM_S, _UNTIL_S[kind]), list[str]()
    row = _CHOICE.sub(lambda found: str(rng.choice(found[1].split("|"))), row)
    for line in filter(None, _RANGE.sub(number, row).split("; ")):
        after, _, what = line.rpartition(": ")
        what, lasts, length = what.partition(" for ")
        later_s = float(after.split()[1]) if after else 0.0
        lines.append(f"at {at_s + later_s:.1f} s{lasts}{length}: {what}")
    return lines
