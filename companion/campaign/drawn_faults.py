"""Fault scripts drawn at random: what goes wrong, when, how badly and for how long.

A script is a function of (family, seed, index) and of the vehicle.  It is a timeline of the
simulator's (docs/reference/faults.md), with lines that the simulator does not know (`split`):
`companion_off` kills the companion, which is started again afterwards.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from companion.mavlink.autopilots import named
from companion.mission.events import Mode

Rng = np.random.Generator

FAMILIES: Final = ("single", "combined")
"""One thing after the other from a list; two or three of them."""
KILLED: Final = "companion_off"
_FROM_S: Final = 35.0
"""About when vehicles are in the air."""
_UNTIL_S: Final = {"copter": 110.0, "plane": 140.0}
_CONTINUE: Final = "ground_command 193 1"
_LINE: Final = re.compile(r"at ([\d.]+) s(?: for ([\d.]+) s)?: *(\S.*)")


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

    @property
    def size(self) -> float:
        """Of fences and distances: planes need more room."""
        return 3.5 if self.vehicle.endswith("plane") else 1.0


Draw = Callable[[Rng, Subject, float], list[str]]
"""Lines for something that begins at a time."""


class Happening(NamedTuple):
    """One line of a timeline."""

    at_s: float
    until_s: float
    """Infinite: it stays, or it happens once."""
    what: str


def happenings(timeline: str) -> list[Happening]:
    """The lines whose times are in seconds."""
    found = [_LINE.fullmatch(line.strip()) for line in timeline.splitlines()]
    return [
        Happening(
            at_s=float(match[1]),
            until_s=float(match[1]) + float(match[2]) if match[2] else float("inf"),
            what=match[3],
        )
        for match in found
        if match is not None
    ]


def split(timeline: str) -> tuple[str, list[Happening]]:
    """The simulator's part of a timeline, and when the companion is killed."""
    lines = timeline.splitlines()
    ours = [line for line in lines if line.rpartition(":")[2].strip() == KILLED]
    rest = "\n".join(line for line in lines if line not in ours)
    return rest, sorted(happenings("\n".join(ours)), key=lambda each: each.at_s)


def drawn(script: FaultScript, subject: Subject) -> tuple[str, str]:
    """What it is called, and its timeline."""
    rows = {name: draw for name, draw in ROWS.items() if _applies(name, subject.vehicle)}
    names = list(rows)
    rng = np.random.default_rng((FAMILIES.index(script.family), script.seed, script.index))
    chosen = [names[script.index % len(names)]]
    if script.family == "combined":
        chosen = list(rng.choice(names, int(rng.integers(2, 4)), replace=False))
    until_s = _UNTIL_S[subject.vehicle.partition("-")[2]]
    lines = [
        line
        for name in chosen
        for line in rows[name](rng, subject, round(rng.uniform(_FROM_S, until_s), 1))
    ]
    return " + ".join(chosen), "\n".join(lines)


def _applies(name: str, vehicle: str) -> bool:
    """Where it cannot happen: PX4 has no such fault; ArduCopter's fence is a cylinder as well."""
    if name == "battery_voltage":
        return vehicle.startswith("ardupilot")
    return name != "stopped by its own fence, and back" or vehicle != "ardupilot-copter"


_DRAWN: Final = re.compile(r"\{(?:([\d.-]+)\.\.([\d.-]+)(?::([^}]*))?|(\w+))\}")
_WORDS: Final = {
    "side": ("north", "east", "south", "west"),
    "way": ("", " to_vehicle", " from_vehicle"),
    "both": ("", " either_way"),
}


def _filled(form: str, rng: Rng) -> str:
    """A line with what is drawn in it, from left to right.

    `{3..90:.0f}`: a number between two, as it is written; `{0..9}`: a whole one, the last not; and
    `{side}`: one of `_WORDS`.
    """

    def draw(found: re.Match[str]) -> str:
        low, high, written, words = found.groups()
        if words is not None:
            return str(rng.choice(_WORDS[words]))
        if written is None:
            return str(rng.integers(int(low), int(high)))
        return format(rng.uniform(float(low), float(high)), written)

    return _DRAWN.sub(draw, form)


def _fault(
    form: str | Callable[[Rng, Subject], str], lasts_s: tuple[float, float] | None = None
) -> Draw:
    """One of the simulator's, for so long; None: for good, or once."""

    def draw(rng: Rng, subject: Subject, at_s: float) -> list[str]:
        what = _filled(form, rng) if isinstance(form, str) else form(rng, subject)
        lasts = "" if lasts_s is None else f" for {rng.uniform(*lasts_s):.2f} s"
        return [f"at {at_s} s{lasts}: {what}"]

    return draw


def _wind(rng: Rng, subject: Subject) -> str:
    fastest = 9 if subject.size == 1.0 else 7
    form = f"wind {{3..{fastest}:.1f}} m/s from {{0..360:.0f}} deg "
    return _filled(form + "turbulence {0..1.5:.1f} m/s rising {-5..5:.0f} deg", rng)


def _mode(subject: Subject, mode: Mode) -> str:
    numbers = named(*subject.vehicle.split("-")).modes.asked[mode]
    return f"ground_command 176 1 {' '.join(map(str, numbers))} to_autopilot"


def _pilot_and_back(rng: Rng, subject: Subject, at_s: float) -> list[str]:
    traits = named(*subject.vehicle.split("-")).traits
    by_mode = not traits.needs_setpoints_before_offboard and rng.random() < 0.5
    back = _mode(subject, Mode.GUIDED) if by_mode else _CONTINUE
    return [f"at {at_s} s: pilot", f"at {at_s + rng.uniform(2.0, 6.0):.1f} s: {back}"]


def _fence(rng: Rng, subject: Subject) -> str:
    radius_m = subject.size * rng.uniform(15.0, 35.0)
    return f"ground_fence {radius_m:.1f} m {rng.uniform(0.0, 0.7) * radius_m:.1f} m ahead"


def _fence_ahead(rng: Rng, subject: Subject) -> str:
    radius_m, ahead_m = (subject.size * rng.uniform(*ends) for ends in ((15, 35), (60, 180)))
    return f"ground_fence {radius_m:.1f} m {ahead_m:.1f} m ahead"


def _own_fence_and_back(rng: Rng, subject: Subject, at_s: float) -> list[str]:
    """The autopilot itself stops at the new fence; a person leaves it to the companion again."""
    enables = [f"at {at_s} s: ground_command 207 1 to_autopilot"]
    return [
        *(enables if subject.vehicle.startswith("ardupilot") else []),
        f"at {at_s} s: {_fence(rng, subject)}",
        f"at {at_s + rng.uniform(8.0, 30.0):.1f} s: {_CONTINUE}",
    ]


def _new_target(rng: Rng, subject: Subject) -> str:
    north_m, east_m = subject.size * rng.uniform(30.0, 200.0, 2)
    sides = str(rng.choice(("north", "south"))), str(rng.choice(("east", "west")))
    return f"ground_target {north_m:.1f} m {sides[0]} {east_m:.1f} m {sides[1]}"


def _moves_origin(rng: Rng, _: Subject) -> str:
    way = rng.choice(("up", "down"))
    return _filled(f"origin_move {{2..60:.0f}} m {{side}} {{1..15:.0f}} m {way}", rng)


ROWS: Final[dict[str, Draw]] = {
    "gps_off": _fault("gps_off", (0.5, 25.0)),
    "gps_glitch": _fault("gps_glitch {3..90:.0f} m {side}", (1.0, 30.0)),
    "gps_drift": _fault("gps_drift {0.3..4:.1f} m/s {side}", (5.0, 30.0)),
    "gps_jam": _fault("gps_jam", (1.0, 15.0)),
    "gps_noise": _fault("gps_noise {0.3..3:.1f} m", (10.0, 60.0)),
    "gps_delay": _fault("gps_delay {100..600:.0f} ms", (10.0, 60.0)),
    "gps_satellites": _fault("gps_satellites {0..9}", (1.0, 25.0)),
    "wind": _fault(_wind),
    "turbulence": _fault("turbulence {0.5..2.5:.1f} m/s"),
    "battery": _fault("battery {3..40:.0f} %"),
    "battery_voltage": _fault("battery_voltage {9.5..12:.1f} V"),
    "link_off": _fault("link_off{way}", (0.2, 25.0)),
    "link_loss": _fault("link_loss {3..60:.0f} %{way}", (10.0, 60.0)),
    "link_delay": _fault("link_delay {20..700:.0f} ms jitter {0..200:.0f} ms{way}", (5.0, 60.0)),
    "link_duplication": _fault("link_duplication {5..80:.0f} %"),
    "frames overtake": _fault("link_delay 0 ms jitter {5..60:.0f} ms"),
    "link_loss for good": _fault("link_loss {1..40:.0f} %{way}"),
    "radar_off": _fault("radar_off", (2.0, 40.0)),
    "radar_blind": _fault("radar_blind", (2.0, 40.0)),
    "radar_drop": _fault("radar_drop {2..50:.0f} %"),
    "radar_loss": _fault("radar_loss {2..70:.0f} %"),
    "radar_noise": _fault("radar_noise {0.5..8:.1f} m{both}"),
    "radar_delay": _fault("radar_delay {50..1500:.0f} ms", (5.0, 60.0)),
    "radar_rate": _fault("radar_rate {0.5..8:.1f} Hz", (5.0, 60.0)),
    "setpoints_ignored": _fault("setpoints_ignored", (0.5, 15.0)),
    "estimator_reset": _fault("estimator_reset {1..50:.0f} m {side}"),
    "origin_move": _fault(_moves_origin),
    "pilot": _fault("pilot"),
    "reboot": _fault("reboot"),
    "few satellites": _fault("gps_satellites {3..9}", (2.0, 25.0)),
    "nothing": lambda *_: [],
    "pilot, and back": _pilot_and_back,
    "station selects return": _fault(lambda _, s: _mode(s, Mode.RETURN)),
    "told to return": _fault("ground_command 20"),
    "told to land": _fault("ground_command 21"),
    "new fence ahead": _fault(_fence_ahead),
    "new fence around it": _fault(_fence),
    "stopped by its own fence, and back": _own_fence_and_back,
    "pause and continue": lambda rng, _, at_s: [
        f"at {at_s} s: ground_command 193 0",
        f"at {at_s + rng.uniform(1.0, 15.0):.1f} s: {_CONTINUE}",
    ],
    "new target": _fault(_new_target),
    "change of speed": _fault(
        lambda r, s: f"ground_command 178 1 {r.uniform(0.4, 1.3) * s.speed_m_s:.1f}"
    ),
    "link lost for long": _fault("link_off", (30.0, 60.0)),
    "companion killed, restarted": _fault(KILLED, (0.3, 8.0)),
}
