"""What the recordings do not say of themselves: parameters, faults and stretches to leave out.

Source: tests/recordings/README.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import final

from vehicle_sim.conformance.log import Place, Recording


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Seconds after the first record that are not compared."""

    begin_s: float
    end_s: float
    why: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """The simulated vehicle is put where the real one was, with its course and speed, once."""

    at_s: float
    """Seconds after the first record."""
    why: str


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Something that was done to the simulator and not by a client's frame."""

    begin_s: float
    """Seconds after the first record, as is the end."""
    end_s: float
    what: str
    """As in a timeline file (faults/timeline.py)."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """The circumstances of one recording."""

    home: Place
    parameters: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    left_out: tuple[Stretch, ...] = ()
    placements: tuple[Placement, ...] = ()


_PX4 = {"COM_OBL_RC_ACT": 5.0}
_PX4_COPTER = {**_PX4, "SIH_KDV": 0.25}
_PARAMETERS: Mapping[str, Mapping[str, float]] = {
    "px4-offboard-8mps.tlog": {**_PX4_COPTER, "SDLOG_MODE": -1.0},  # never names a log file
    "px4-offboard-short.tlog": {**_PX4_COPTER, "SDLOG_MODE": 1.0},  # header of its .ulg
    "px4-gps-loss.tlog": _PX4_COPTER,
    "px4-fixedwing-offboard.tlog": _PX4,
}
_HOMES = {  # latitude, longitude, altitude AMSL, heading
    "arducopter-guided-10mps.tlog": (-35.363262, 149.165237, 584.0, 0.0),
    "arducopter-guided-global-stream-faults.tlog": (47.397742, 8.545594, 488.0, 90.0),
    "arducopter-gps-loss.tlog": (-35.363262, 149.165237, 584.0, 0.0),
    "arduplane-guided-reposition.tlog": (-35.363262, 149.165237, 584.0, 0.0),
    "px4-offboard-8mps.tlog": (47.397742, 8.545594, 488.0, 0.0),
    "px4-offboard-short.tlog": (47.397742, 8.545594, 488.0, 0.0),
    "px4-gps-loss.tlog": (47.397742, 8.545594, 488.0, 0.0),
    "px4-fixedwing-offboard.tlog": (47.397742, 8.545594, 488.0, 0.0),
}
_FAULTS = {
    "px4-gps-loss.tlog": (Fault(begin_s=76.3, end_s=106.6, what="gps_off"),),
}
_PLACEMENTS = {
    "px4-fixedwing-offboard.tlog": (
        Placement(
            at_s=169.0,
            why="after the stretch that is left out: the setpoints that follow are points of the "
            "path beside the real aeroplane",
        ),
    ),
}
_LEFT_OUT = {
    "px4-fixedwing-offboard.tlog": (
        Stretch(
            begin_s=35.0,
            end_s=170.0,
            why="the simulated aeroplane sank to the ground and moved there: an artefact of that "
            "simulator (tests/recordings); until 170 s it was still on its way up again",
        ),
    ),
}


def flight_of(recording: Recording) -> Flight:
    """What is known of this recording; of a strange one, what it says of itself."""
    name, home = recording.name, recording.home
    known = _HOMES.get(name)
    if known is not None:
        home = Place(
            latitude_deg=known[0],
            longitude_deg=known[1],
            altitude_amsl_m=known[2],
            heading_deg=known[3],
        )
    return Flight(
        home=home,
        parameters=_PARAMETERS.get(name, {}),
        faults=_FAULTS.get(name, ()),
        left_out=_LEFT_OUT.get(name, ()),
        placements=_PLACEMENTS.get(name, ()),
    )
