"""What ardupilot.md and px4.md say of the real autopilots, and is so here; and the law `ideal`.

Missions are in test_firmwares.py, tracking in test_tracking.py, how setpoints are read in
test_setpoints.py, recorded flights in conformance/.  PX4's conditions: SIH_KDV 0.25 and
COM_OBL_RC_ACT 5 unless stated.  Tolerances are what the document gives as a range; otherwise twice
the noise of the estimate, 10 % of speeds, and as stated.
"""

import cmath
import math
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter, methodcaller
from typing import Any
from unittest.mock import ANY

import pytest
from harness import (
    COPTER_HOME,
    GCS,
    KINDS,
    NAN,
    PLANE_HOME,
    ZERO,
    Rig,
    Vector,
    circling,
    copied,
    cruising,
    heartbeat,
    hover,
    hovering,
    item,
)
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.guards import Fence
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem, PlanKind

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
TAKE_OFF, YAW, SPEED, HOME, PLACE = 22, 115, 178, 179, 192
AIR_SPEED, COURSE = 43000, 43002
"""Commands; the last two of a plane in GUIDED."""
GROUND_M = COPTER_HOME[2]
NOWHERE = (NAN, NAN, NAN)
STATION = heartbeat(mavlink.MAV_TYPE_GCS)
approx = pytest.approx


def about(value: Any, within: float) -> Any:
    return approx(value, abs=within)


# --- where flights begin --------------------------------------------------------------------------

low, high, high_px4 = partial(hovering, 5.0), partial(hover, 30.0), partial(hover, 40.0, seed=1)


def hurrying() -> Rig:
    """At 15 m/s."""
    it = hovering(60.0)
    it.vehicle.velocity_m_s = 15.0 + 0j
    return it


@copied
def ready(autopilot: str = "ardupilot", kind: Any = "copter") -> Rig:
    """Armed on the ground, an ArduPilot in GUIDED, a PX4 in Hold."""
    it = Rig(autopilot, kind).armable()
    assert autopilot == "px4" or it.set_mode("GUIDED") == ACCEPTED
    assert it.arm() == ACCEPTED
    return it.run(4.0)


_, new_plane, new_px4, new_px4_plane = (partial(Rig, *kind) for kind in KINDS)
rolling, px4_ready = partial(ready, kind="plane"), partial(ready, "px4")


def lost(action: float) -> Rig:
    """PX4's copter at 5 m/s, whose stream has just ended."""
    return hover(COM_OBL_RC_ACT=action).stream(7.0, None, (5.0, 0.0, 0.0))


def offboard(**told: float) -> Rig:
    """PX4's plane in OFFBOARD, on its way to a point far north that has been sent for a second."""
    rig = cruising(**told).stream(1.0, (5000.0, 0.0, -70.0))
    assert (rig.set_mode("Offboard"), rig.mode) == (ACCEPTED, "Offboard")
    return rig


slow, blind_plane = partial(offboard, FW_AIRSPD_TRIM=12.0), partial(offboard, NAV_GPSF_LT=10.0)
left = partial(cruising, NAV_LOITER_RAD=-60.0)


def raised_home() -> Rig:
    """PX4's copter about to be in OFFBOARD: home 5 m above the origin at 488 m, ground at 480 m."""
    rig = Rig("px4").run(4.0)
    pilot = rig.autopilot
    origin = pilot.estimate.origin = pilot.estimate.place.at(488.0)
    pilot.frame = pilot.firmware.frame(origin)
    pilot.home, pilot.ground_m = origin.at(493.0), 480.0
    rig.command(176, 1.0, 6.0)
    return rig


def circle(north_m: float, radius_m: float, command: int = 5004) -> PlanItem:
    """To keep out of, or by this command in."""
    return item(COPTER_HOME, command, north_m, 0.0, 0.0, radius_m, frame=0)


def polygon(*corners: complex) -> list[PlanItem]:
    """To stay in: north + east j."""
    count = float(len(corners))
    return [item(COPTER_HOME, 5001, at.real, at.imag, 0.0, count, frame=0) for at in corners]


def fenced(*items: PlanItem, kinds: float = 4.0, **parameters: float) -> Rig:
    """An ArduCopter with a fence of polygons and circles."""
    it = hovering(FENCE_ENABLE=1.0, FENCE_TYPE=kinds, **parameters)
    it.plan(PlanKind.FENCE, *items)
    return it


floored = partial(fenced, kinds=8.0, FENCE_ALT_MIN=15.0)
ringed = partial(circling, FENCE_ENABLE=1.0, FENCE_TYPE=2.0, FENCE_RADIUS=400.0)


def px4_fenced(action: float = 3.0, **parameters: float) -> Rig:
    """PX4's copter with an exclusion of 20 m, 60 m to the north; by this action it returns."""
    rig = hover(GF_ACTION=action, **parameters)
    rig.send(STATION, source=GCS)
    rig.simulation.plans[PlanKind.FENCE] = (item(rig.home, 5004, 60.0, 0.0, 0.0, 20.0, frame=6),)
    return rig


# --- what they are told, and what is looked at then -----------------------------------------------

Begin, Order, Look = Callable[[], Rig], Callable[[Rig], object], Callable[[Rig], Any]
mode, command, aim, stream, reposition, fault, run = (
    partial(methodcaller, name)
    for name in ("set_mode", "command", "aim", "stream", "reposition", "fault", "run")
)
"""Orders to a Rig, of these names."""
arm, boot = methodcaller("arm"), methodcaller("armable")
height, climb, speed, velocity, place = map(
    attrgetter,
    ("height_m", "vehicle.velocity_up_m_s", "speed_m_s", "vehicle.velocity_neu_m_s", "ned_m"),
)
airspeed, mode_of, aimed_at, truly = map(
    attrgetter,
    ("vehicle.airspeed_m_s", "mode", "autopilot.target.position", "simulation.contact.local_m"),
)
mode_height, mode_roll = attrgetter("mode", "height_m"), attrgetter("mode", "vehicle.roll_rad")
mode_climb = attrgetter("mode", "vehicle.velocity_up_m_s")
mode_roll_climb = attrgetter("mode", "vehicle.roll_rad", "vehicle.velocity_up_m_s")


def northing_m(it: Rig) -> float:
    return it.ned_m[0]


def away_m(it: Rig) -> float:
    """From home."""
    return math.hypot(*it.ne_m)


def heading_deg(it: Rig) -> float:
    return math.degrees(it.vehicle.heading_rad)


def echo(it: Rig) -> Any:
    """Where it says that it is told to go: north, east, down."""
    return it.autopilot.target_echo().position


def seconds_to(reached: Callable[[Rig], bool]) -> Look:
    """How long it takes until this is so."""
    return lambda it: it.until(lambda: reached(it), 60.0)


def set_mode(base: int, custom: int) -> Order:
    return methodcaller("send", mavlink.MAVLink_set_mode_message(1, base, custom))


def most(of: Look) -> Look:
    """The most that is seen in half a minute."""

    def look(it: Rig) -> Any:
        seen = list[Any]()
        it.run(30.0, lambda: seen.append(of(it)))
        return max(seen)

    return look


def aims_m(height_m: float, frame: int) -> Order:
    """At where the origin is."""
    return lambda it: it.aim((*it.autopilot.home[:2], height_m), frame=frame, is_global=True)


def tells(what: str) -> Look:
    """How often it told of a fence, in texts that begin so."""
    return lambda it: sum(text.startswith(what) and "ence" in text for text in it.texts())


def accuracy_m(it: Rig) -> tuple[float, float]:
    """As it says, and how far it is from where it believes to be."""
    off_m = math.dist(it.ne_m, it.simulation.contact.local_m)
    return it.autopilot.estimate.horizontal_accuracy_m, off_m


def circle_m(it: Rig) -> float:
    """Mean distance from home in 15 s; negative if counter-clockwise."""
    places = list[complex]()
    it.run(15.0, lambda: places.append(complex(*it.ne_m)))
    return math.copysign(sum(map(abs, places)) / len(places), (places[100] / places[0]).imag)


LIVES = stream(1.0, None, ZERO)
northwards = partial(stream, position=(5000.0, 0.0, -70.0))
"""So long, of PX4's plane."""
GLIDES, LOITERS_LEVEL = mode("FBWA"), ("LOITER", about(0, 0.01))
BANKS_AND_SINKS = ("Descend", about(math.radians(15.0), 0.01), about(-0.5, 0.05))
AHEAD: Vector = (300.0, 0.0, -30.0)
THERE = (PLANE_HOME[0] + 0.003, PLANE_HOME[1], 90.0)
NORTH_EAST = (aim((20, 10, -30)), run(14))
"""Where it points then, and a way ahead and to the right of it in that frame."""
TURNED = complex(20, 10) + complex(12, 4) * cmath.rect(1.0, math.atan2(10, 20))
ASIDE = (TURNED.real, TURNED.imag, -33.0)
SCALE_M = 0.011131884502145034e7
"""Of a degree on ArduPilot's flat earth: its Location.cpp."""
GLOBAL = (0.5 * SCALE_M, 0.6 * SCALE_M * math.cos(math.radians(47.25)), -40.0)
PUSHES = stream(3.0, None, None, (1, 0, 0))
TURNS = (command(YAW, 120, 0, 1, 0), run(5))
HIGHER = command(PLACE, -1, 1, 0, *NOWHERE, 508.0, frame=5)
MOVED_HOME = command(HOME, 0, 0, 0, 0, 47.001, 8.0, GROUND_M + 20.0, frame=0)
ABOVE_HOME = aim((47, 8, 30), frame=6, is_global=True)
SLOWLY = command(SPEED, 1, 2.0, -1.0)
GOES_UP = command(TAKE_OFF, *[0.0] * 6, 30.0)
UP = seconds_to(lambda it: it.height_m > 29.7)
TAKES_OFF = command(TAKE_OFF, 0, 0, 0, NAN, *NOWHERE)
GOES_TO_500_M = command(TAKE_OFF, 0, 0, 0, *NOWHERE, 500.0, frame=0)

Rows = list[tuple[Begin, Sequence[Order], float, Look, Any]]
"""Where it begins, what it is told, how many seconds it flies on, what is looked at and seen."""
COPTER: Rows = [
    # 2: a take-off is over a second after it has come to its height, and ended by a setpoint
    (ready, [GOES_UP, UP], 0, seconds_to(lambda it: it.status.landed_state == 2), about(1.0, 0.5)),
    (ready, [GOES_UP, run(5), aim((20, 0, -5))], 15, place, about((20, 0, -5), 0.5)),
    # LOITER without a pilot sinks; BRAKE stops, and setpoints are ignored
    (hovering, [mode("LOITER")], 8, climb, about(-2.5, 0.05)),
    (hurrying, [mode("BRAKE"), aim((5e3, 0, -60), (10, 0, 0))], 9, place, about((15, 0, -60), 3)),
    (hovering, [set_mode(1, 9)], 1, mode_of, "LAND"),  # SET_MODE means DO_SET_MODE
    # a return goes up to 15 m first, comes home tail first, and takes 1.55 s for either at least
    (low, [aim((0, 111, -5)), run(30), mode("RTL")], 0, most(height), about(15, 0.5)),
    (low, [aim((0, 111, -5)), run(30), mode("RTL")], 3, place, about((0, 111, -10), 3)),
    (low, [aim((0, 111, -5)), run(30), mode("RTL")], 40, heading_deg, about(90, 6)),
    # 3: places are about the origin, or from where it is and turned with it; above home or the sea
    (hovering, [*NORTH_EAST, aim((12, 4, -3))], 0, echo, about((12, 4, -3), 0.3)),
    (hovering, [*NORTH_EAST, aim((12, 4, -3), frame=8)], 0, echo, about(ASIDE, 0.5)),
    (hovering, [aim((47.5, 8.6, 540.0), frame=5, is_global=True)], 0, echo, about(GLOBAL, 1)),
    (hovering, [MOVED_HOME, aim((5, 0, -30))], 0, echo, about((5, 0, -30), 0.1)),
    (hovering, [MOVED_HOME, ABOVE_HOME], 0, echo, about((0, 0, -50), 1)),
    # no jump is refused: at most WPNAV_SPEED and 2.5 m/s up, overshooting by less than a metre
    (hovering, [aim((200, 0, -30))], 15, speed, about(10.4, 0.4)),
    (hovering, [aim((200, 0, -30))], 28, place, about((200, 0, -30), 1.2)),
    (hovering, [aim((0, 0, -50), ZERO, ZERO)], 11, height, about(50, 1)),
    # a change of speed limits a place alone, and is forgotten with the submode; up and down
    (hovering, [aim(AHEAD), command(SPEED, 1, 3)], 9, speed, about(3.06, 0.1)),
    (hovering, [command(SPEED, 1, 3), stream(8, None, (6, 0, 0))], 0, speed, about(6.0, 0.2)),
    (hovering, [command(SPEED, 1, 3), aim(AHEAD)], 12, speed, about(10, 0.6)),
    (hovering, [aim((0, 0, -80)), command(SPEED, 2, 1.0)], 6, climb, about(1.0, 0.1)),
    (hovering, [aim((0, 0, -10)), command(SPEED, 3, 0.7)], 6, climb, about(-0.7, 0.1)),
    # an acceleration alone is flown until the time-out
    (hovering, [PUSHES], 0, speed, about(2.6, 0.4)),
    (hovering, [PUSHES], 12, speed, about(0.0, 0.1)),
    # a yaw is turned to, also by so much to the left, and reset by a setpoint that ignores it
    (hovering, [*TURNS, command(YAW, 50, 0, -1, 1)], 5, heading_deg, about(70, 1)),
    (hovering, [*TURNS, stream(8, None, (0, 5, 0))], 0, heading_deg, about(90, 3)),
]
PLANE: Rows = [
    # 7: circles are wider than asked, and p4 turns them round
    (circling, [reposition(0, 0, 80, 80.0, 1.0)], 40, circle_m, about(-97, 3)),
    # speeds are of the air, and forgotten with GUIDED
    (circling, [command(AIR_SPEED, 0, 25)], 30, speed, about(27.7, 0.3)),
    (circling, [command(AIR_SPEED, 0, 18), mode("LOITER")], 30, speed, about(23.45, 0.3)),
    # of setpoints only heights are taken, and increments add up; a place is no take-off
    (circling, [aim((9, 9, 90.0), frame=6, is_global=True)], 40, height, about(90, 1)),
    (circling, [aim((0, 0, -1.0), frame=7)] * 5, 30, height, about(85, 1)),
    (circling, [aim((3e3, 0, -150))], 30, height, about(80, 1)),
    (circling, [aim((9, 9, 50), frame=7, is_global=True)], 30, height, about(80, 1)),
    (rolling, [reposition(500, 0, 50)], 10, speed, 0.0),
    # 5: without GPS it levels its wings, also after a mode that does without
    (circling, [fault("gps_off")], 20, mode_roll, ("GUIDED", about(0, 0.01))),
    (circling, [fault("gps_off")], 20, height, about(80, 4)),
    (circling, [fault("gps_off"), GLIDES, run(9), mode("LOITER")], 20, mode_roll, LOITERS_LEVEL),
]
PX4: Rows = [
    # 3: a take-off ends in Hold at its usual height, and leads nowhere down
    (px4_ready, [TAKES_OFF], 12, mode_height, ("Hold", about(2.5, 0.3))),
    (high, [GOES_TO_500_M], 20, mode_height, ("Hold", about(30, 1))),
    # a place is flown to in Hold, nose ahead, and a height alone is one
    (hover, [reposition(-30, 0, 20), stream(20, None, ZERO)], 0, place, about((-30, 0, -20), 1)),
    (hover, [reposition(0, -30, 20)], 10, heading_deg, about(-90, 6)),
    (hover, [reposition(-60, 0, 15), run(3), HIGHER], 12, mode_height, ("Hold", about(20, 1))),
    (hover, [mode("Hold"), LIVES, set_mode(209, 6 << 16)], 0.1, mode_of, "Offboard"),
    # in AUTO modes a change of speed counts, and in OFFBOARD it does not
    (hover, [mode("Hold"), SLOWLY, reposition(-60, 0, 15)], 8, speed, about(2.0, 0.3)),
    (high, [SLOWLY, stream(7, None, (3, 1, -1))], 0, velocity, about((3, 1, 1), 0.4)),
    # 4: axes may be mixed; half a place brakes; limits
    (hover, [stream(15, (10, 5, 0), (0, 0, -0.3), mask=0xDDC)], 0, place, about((10, 5, -19.5), 1)),
    (high, [stream(7, (0, 0, -30), (3, 0, 0), mask=0xDE3)], 0, velocity, about((3, 0, 0), 0.4)),
    (high, [stream(7, (9, 0, -30), mask=0xDFE)], 0, velocity, about(ZERO, 0.4)),
    (high, [stream(7, None, (15, 0, 0))], 0, velocity, about((11.9, 0, 0), 0.4)),
    (high, [stream(7, None, (0, 0, -6))], 0, velocity, about((0, 0, 2.8), 0.4)),
    (high, [stream(7, None, (0, 0, 6))], 0, velocity, about((0, 0, -1.6), 0.4)),
    # frames of GLOBAL_INT; above home with the wrong sign of home's height (1, item 6): 493 m
    (raised_home, [aims_m(498.0, frame=5)], 0, aimed_at, about((0, 0, -10.0), 0.01)),
    (raised_home, [aims_m(498.0, frame=6)], 0, aimed_at, about((0, 0, -493.0), 0.01)),
    (raised_home, [aims_m(498.0, frame=11)], 0, aimed_at, about((0, 0, -490.0), 0.01)),
    # a return climbs no higher than the cone of 45 degrees, to 30 m
    (hover, [stream(20, (20, 0, -15)), mode("Return")], 0, most(height), about(20, 1)),
    (hover, [stream(20, (60, 0, -15)), mode("Return")], 0, most(height), about(30, 1)),
    # 6: what COM_OBL_RC_ACT says when the stream is lost
    (lambda: lost(0), [], 5, mode_climb, ("Position", about(-0.65, 0.15))),
    (lambda: lost(1), [], 5, mode_climb, ("Altitude", about(-0.65, 0.15))),
    (lambda: lost(3), [], 12, mode_height, ("Return", about(30, 1))),
    (lambda: lost(4), [], 5, mode_climb, ("Land", about(-1.4, 0.14))),
    # 8: without a position Hold is a descent
    (hover, [mode("Hold"), fault("gps_off")], 6, mode_of, "Descend"),
    # 10: a plane's speed is FW_AIRSPD_TRIM, here at 550 m, whatever is commanded
    (slow, [command(SPEED, 0, 20, -1), stream(20, (5e3, 0, -70))], 0, airspeed, about(12.3, 0.1)),
    # without GPS it flies a bank for NAV_GPSF_LT and then descends
    (blind_plane, [fault("gps_off"), northwards(4)], 0, mode_of, "Offboard"),
    (blind_plane, [fault("gps_off"), northwards(9)], 0, mode_climb, ("Descend", about(0.0, 0.1))),
    (blind_plane, [fault("gps_off"), northwards(22)], 0, mode_roll_climb, BANKS_AND_SINKS),
    # its circles are NAV_LOITER_RAD wide, whatever is asked, and to the left where that is negative
    (left, [reposition(0, 0, 70, 200.0)], 60, circle_m, about(-60, 0.7)),
]
ANOTHER = methodcaller("send", STATION, source=(254, 77))
IS_HEARD = methodcaller("send", STATION, source=GCS)
IDLES = seconds_to(lambda it: not it.simulation.armed)
RTLS, LANDS = seconds_to(lambda it: it.mode == "RTL"), seconds_to(lambda it: it.mode == "Land")
WEAK = {"BATT_LOW_VOLT": 10.5, "BATT_FS_LOW_ACT": 2}
BATTERY_LOW = (fault("battery_voltage 10 V"), run(12), mode("GUIDED"))
watched, watched_plane = partial(hovering, FS_GCS_ENABLE=1), partial(circling, FS_GCS_ENABL=1)
FAILSAFES: Rows = [
    # 2, 3: it is armed once its estimator flies
    *((Rig, [mode("GUIDED")], 30, arm, FAILED), (Rig, [mode("GUIDED")], 42, arm, ACCEPTED)),
    *((new_plane, [], 20.5, arm, FAILED), (new_plane, [], 23.1, arm, ACCEPTED)),
    *((new_px4, [], 1, arm, REJECTED), (new_px4, [], 7, arm, ACCEPTED)),
    *((new_px4_plane, [], 1, arm, REJECTED), (new_px4_plane, [], 7, arm, ACCEPTED)),
    # and disarmed again if it only idles: DISARM_DELAY, COM_DISARM_PRFLT; planes are not
    (ready, [], 0, IDLES, about(10.0 - 4.0, 0.6)),
    (px4_ready, [], 0, IDLES, about(10.5 - 4.0, 0.6)),
    (rolling, [], 20, attrgetter("simulation.armed"), True),
    # 5, 3: a ground station is missed that was heard, for 4.9 s, for 10 s; whoever else is heard
    (watched, [IS_HEARD, run(3), ANOTHER], 0, RTLS, about(1.9, 0.2)),
    (watched_plane, [IS_HEARD, run(3), ANOTHER], 0, RTLS, about(1.9, 0.2)),
    (partial(hover, NAV_DLL_ACT=3), [mode("Hold"), IS_HEARD], 0, LANDS, about(10.0, 0.3)),
    (watched, [ANOTHER], 6, mode_of, "GUIDED"),
    (watched, [IS_HEARD, run(6), IS_HEARD], 1, mode_of, "RTL"),
    # a low battery is acted on, and whoever commands another mode has it
    (partial(hovering, **WEAK), [fault("battery_voltage 10 V")], 0, RTLS, about(9.9, 0.5)),
    (partial(hovering, **WEAK), BATTERY_LOW, 1, mode_of, "GUIDED"),
    (hover, [mode("Hold"), fault("battery 6.5 %")], 0.6, mode_of, "Return"),
    (hover, [mode("Hold"), fault("battery 4 %")], 0.6, mode_of, "Land"),
    (hover, [fault("battery 4 %"), run(1), mode("Hold")], 1, mode_of, "Hold"),
]

INSIDE = polygon(50.0, 90.0, 90.0 + 40.0j)
outside, excluded = partial(fenced, *INSIDE), partial(fenced, circle(80.0, 15.0))
mode_fence, RISES = attrgetter("mode", "status.fence"), stream(8, None, (0, 0, -1.5))
FENCES: Rows = [
    # ardupilot.md 4: outside of an inclusion the action is a parameter; GUIDED can be had again;
    # a breach is told and counted once each time that it begins
    *((outside, [], 1, mode_of, "RTL"), (outside, [], 1, tells("Polygon"), 1)),
    (partial(fenced, *INSIDE, FENCE_ACTION=0), [], 1, mode_of, "GUIDED"),
    (partial(fenced, *INSIDE, FENCE_ACTION=2), [], 1, mode_of, "LAND"),
    (outside, [run(1), mode("GUIDED")], 1, mode_fence, ("GUIDED", (1, 1))),
    (outside, [run(1), command(207, 0)], 1, mode_fence, ("RTL", (0, 1))),
    (outside, [run(1), command(207, 0), run(1), command(207, 1)], 1, mode_fence, ("RTL", (1, 2))),
    # a target in an exclusion is dropped without a word
    (excluded, [aim((40, 0, -30)), aim((80, 0, -30))], 0, echo, about((40, 0, -30), 0.1)),
    # a floor comes with the height, is breached from above, and goes with the landing
    (floored, [stream(11, None, (0, 0, 1.5))], 0, tells("Min Alt"), 1),
    (floored, [stream(9, None, (0, 0, 1.5))], 0, tells("Min Alt"), 0),
    (floored, [mode("LAND"), run(50), methodcaller("take_off", 12.0)], 0, tells("Min Alt"), 0),
    # 7: a plane is led back from its circle
    (ringed, [command(COURSE, 0, 0.0, 3.0), RTLS], 0, away_m, about(400, 5)),
    # px4.md 7: beyond the cylinder about home it does what GF_ACTION says
    (partial(px4_fenced, GF_MAX_HOR_DIST=20.0), [RISES], 0, mode_of, "Offboard"),
    (partial(px4_fenced, GF_MAX_HOR_DIST=20.0), [stream(8, None, (3, 0, 0))], 0, mode_of, "Return"),
    (partial(px4_fenced, GF_MAX_VER_DIST=20.0), [RISES], 0, mode_of, "Return"),
]

HOLDS, held = aim((0, 0, -30)), partial(stream, position=(0.0, 0.0, -40.0))
"""A copter where it is; PX4's for so many seconds."""
GLITCH, OUTAGE = fault("gps_glitch 50 m north"), fault("for 10 s: gps_off")
BLIND, SHORTLY = fault("for 30 s: gps_off"), fault("for 4 s: gps_off")
ARMABLE, flags = attrgetter("simulation.armable"), attrgetter("autopilot.estimate.flags")
glitches = lambda it: [text for text in it.texts() if "litch" in text]  # noqa: E731
ESTIMATORS: Rows = [
    # ardupilot.md 5: a jump of GPS is told of when it begins and when it is over
    (hovering, [HOLDS, GLITCH], 23, glitches, ["GPS Glitch or Compass error", "Glitch cleared"]),
    # an outage between 7 s, "timed out", and 15 s, "stopped aiding", leaves it armable again
    *((Rig, [boot, OUTAGE], s, ARMABLE, so) for s, so in ((9.9, False), (15, True))),
    # px4.md 8: the accuracy grows from 0.3 m to 29 m in 30 s, and the estimate drifts by 31 m, with
    # another accelerometer's error by others, and jumps back
    (high_px4, [BLIND, held(29.9)], 0, accuracy_m, (about(29.0, 4.0), about(31.0, 12.0))),
    (high_px4, [BLIND, held(34)], 0, accuracy_m, (about(0.3, 0.1), about(0.0, 2.0))),
    # a short loss is not noticed, and a jump believed after reset_timeout_max, 7 s
    (high_px4, [SHORTLY, held(8)], 0, flags, 0x37F),
    (high_px4, [GLITCH, held(6)], 0, truly, about((0, 0), 3)),
    (high_px4, [GLITCH, held(21)], 0, truly, about((-50, 0), 3)),
]


@pytest.mark.parametrize(
    ("begins", "told", "seconds", "look", "seen"),
    COPTER + PLANE + PX4 + FAILSAFES + FENCES + ESTIMATORS,
)
def test_a_statement_of_the_pages_is_so(
    begins: Begin, told: Sequence[Order], seconds: float, look: Look, seen: Any
) -> None:
    it = begins()
    for order in told:
        order(it)
    assert look(it.run(seconds)) == seen


# --- what is answered -----------------------------------------------------------------------------

Answers = Sequence[tuple[Order, Any]]
FRESH: Answers = [  # ArduCopter that has just started: there is no home yet
    *((command(176, 1, 0), ACCEPTED), (command(176, 0, 4), DENIED), (command(176, 1, 99), FAILED)),
    *((command(176, 1, NAN), FAILED), (command(176, NAN, 4), DENIED)),
    *((command(400, 7), UNSUPPORTED), (command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 30), FAILED)),
    *((command(520, 1), ACCEPTED), (command(410), FAILED), (command(HOME, 1), FAILED)),
    *((command(207, 1), ACCEPTED), (command(207, 7), FAILED), (command(224, NAN), FAILED)),
    (command(20), ACCEPTED),  # a mode change, which is not checked while disarmed
    *((command(300), FAILED), (command(SPEED, 1, 0), FAILED), (command(31000), UNSUPPORTED)),
    *((command(PLACE), UNSUPPORTED), (command(246, 0), UNSUPPORTED), (command(246, 1), ACCEPTED)),
]
READY: Answers = [
    *((command(TAKE_OFF, *[0] * 6, up_m), FAILED) for up_m in (NAN, math.inf, 0, -5)),
    *((command(TAKE_OFF, *[0] * 6, 30, frame=frame), DENIED) for frame in (0, 5, 6)),
    (command(TAKE_OFF, *[0] * 6, 30, frame=3), ACCEPTED),
]
CIRCLING: Answers = [  # ArduPlane in GUIDED
    (command(PLACE, -1, 1, 0, 0, *THERE), UNSUPPORTED),  # no COMMAND_INT
    *((command(PLACE, 5, 0, 0, 0, *THERE, frame=f), ACCEPTED) for f in (0, 3, 5, 6, 10, 11)),
    (command(PLACE, 5, 0, 0, 0, *THERE, frame=1), DENIED),
    *(
        (command(PLACE, -1, 1, 0, 0, *nowhere, frame=3), DENIED)
        for nowhere in ((95, 0, 90), (0, 190, 90), (0, 0, 90), (*THERE[:2], NAN))
    ),
    (lambda it: it.texts()[-1][:4], "SIM:"),  # what the real one does not survive
    *((command(AIR_SPEED, *to), DENIED) for to in ((1, 20), (0, 9), (0, 31), (0, NAN))),
    *((command(COURSE, *to, 3), DENIED) for to in ((0, 360), (3, 90), (0, NAN))),
    *((mode(of_quadplanes), FAILED) for of_quadplanes in (17, 19, 21)),
    (mode("LOITER"), ACCEPTED),
    *((command(number, 0, 20, 3), FAILED) for number in (AIR_SPEED, SPEED, COURSE)),
    (command(PLACE, -1, 0, 0, 0, *THERE, frame=3), FAILED),
    (command(PLACE, -1, 1, 0, 0, *THERE, frame=3), ACCEPTED),
    (mode_of, "GUIDED"),
]
PX4_READY: Answers = [
    (command(HOME), REJECTED),  # 0, 0 is no place
    *((command(HOME, 0, 0, 0, 0, 47.4, 8.55, up_m, frame=0), REJECTED) for up_m in (NAN, 3.4e38)),
    (command(HOME, 0, 0, 0, 0, 47.4, 8.55, 500, frame=0), ACCEPTED),
    (attrgetter("autopilot.home.altitude_amsl_m"), 500.0),
    *((command(246, 1), REJECTED), (command(400, 0), ACCEPTED), (command(246, 1), ACCEPTED)),
]

last_text = lambda it: it.texts()[-1]  # noqa: E731
UNARMABLE: Answers = [
    *((mode("RTL"), ACCEPTED), (arm, FAILED), (last_text, "Arm: RTL mode not armable")),
    *((methodcaller("plan", PlanKind.FENCE, circle(0.0, 50.0)), None), (mode("GUIDED"), ACCEPTED)),
    *((arm, FAILED), (last_text, "Arm: Vehicle breaching Polygon")),
    *((command(207, 0), ACCEPTED), (arm, ACCEPTED)),  # the fence is off
]


OFFBOARD: Answers = [  # it takes a setpoint, and what came before it is a sign of life only
    *((mode("Hold"), ACCEPTED), (run(3), ANY), (mode("Offboard"), REJECTED)),
    *((aim((300, 0, -12)), None), (run(0.2), ANY), (mode("Offboard"), ACCEPTED)),
    *((run(0.6), ANY), (attrgetter("mode", "autopilot.target"), ("Offboard", None))),
    (speed, about(0.0, 0.6)),
]
NO_MODE: Answers = [  # PX4 answers twice; without its flag it is no custom mode
    *((command(176, flag, 6.0), ACCEPTED) for flag in (0.0, NAN)),
    (lambda it: it.run(0.01).last("COMMAND_ACK").result, REJECTED),
]


BREACHES: Answers = [  # it stops beyond the edge, whatever is sent, until OFFBOARD is had again
    *((stream(20, None, (4, 0, 0)), ANY), (mode_of, "Hold"), (tells("Geofence"), 1)),
    *((northing_m, about(45.0, 1.5)), (mode("Offboard"), ACCEPTED)),
    *((stream(3, None, (8, 0, 0)), ANY), (northing_m, about(61.0, 8.0))),
]
off_circle_m = most(lambda it: abs(away_m(it) - 80.0))
RETURNS: Answers = [  # at its height it circles over home
    *((command(20), ACCEPTED), (run(45), ANY), (lambda it: it.height_m > 80.0, True)),
    *((run(60), ANY), (off_circle_m, about(0.0, 0.6)), (mode_height, ("Return", about(57.8, 1.0)))),
]


def disarmed(named: str, *, armable: bool) -> Answers:
    """A PX4 on the ground has every mode and can be armed in some."""
    is_so = ((3, True), ACCEPTED) if armable else ((0, False), REJECTED)
    status = attrgetter("status.system_status", "status.prearm_ok")
    return [
        *((command(400, 0), ACCEPTED), (mode(named), ACCEPTED), (mode_of, named)),
        *((run(0.2), ANY), (status, is_so[0]), (arm, is_so[1])),
    ]


@pytest.mark.parametrize(
    ("begins", "answers"),
    [
        *((Rig, FRESH), (ready, READY), (circling, CIRCLING)),
        (hovering, [(command(HOME, 0, 0, 0, 0, NAN, 8.0, 0, frame=0), FAILED)]),
        (hovering, [(command(TAKE_OFF, *[0] * 6, 60), FAILED)]),
        *((rolling, [(command(TAKE_OFF, *[0] * 6, 30), FAILED)]), (px4_ready, PX4_READY)),
        (lambda: Rig("px4").run(1.0), [(command(400, 1, 21196), ACCEPTED)]),  # by force
        (lambda: Rig(FENCE_ENABLE=1.0, FENCE_TYPE=4.0).armable(), UNARMABLE),
        (ringed, [(reposition(900, 0, 80), DENIED)]),
        *((px4_fenced, [(reposition(60, 0, 15), DENIED)]), (partial(px4_fenced, 2.0), BREACHES)),
        (partial(cruising, 600.0, -200.0, RTL_RETURN_ALT=90.0, RTL_DESCEND_ALT=60.0), RETURNS),
        *((hover, OFFBOARD), (px4_ready, NO_MODE)),
        # as MAVSDK 4 sends them, in the same moment
        (px4_ready, [(aim((0, 0, -9)), None), (mode("Offboard"), ACCEPTED), (mode_of, "Offboard")]),
        *((px4_ready, disarmed(m, armable=True)) for m in ("Takeoff", "Hold", "Return", "Land")),
        # no stream, no pilot, no mission
        *((px4_ready, disarmed(m, armable=False)) for m in ("Offboard", "Position", "Altitude")),
        (px4_ready, disarmed("Mission", armable=False)),
    ],
)
def test_every_command_is_answered_as_on_the_real_one(begins: Begin, answers: Answers) -> None:
    it = begins()
    for k, (order, answer) in enumerate(answers):
        assert order(it) == answer, k


# --- what takes more than a row -------------------------------------------------------------------

EARTH = FlatEarth(Place(*COPTER_HOME))
STAR = polygon(*(cmath.rect(20.0, 0.8 * math.pi * k) for k in range(5)))
"""It crosses itself: its middle is a hole."""
TWO, ONE = (circle(0.0, 10.0, 5003), circle(50.0, 10.0, 5003)), (circle(100.0, 10.0),)


@pytest.mark.parametrize(
    ("kinds", "items", "options", "found"),
    [  # by metres north and up
        *((1, ONE, 0, {(0, 99): 0, (0, 101): 1}), (2, ONE, 0, {(149, 0): 0, (151, 0): 2})),
        *((7, ONE, 0, {(151, 101): 3}), (4, ONE, 0, {(100, 0): 4, (110.5, 0): 0})),
        # of two inclusions it stays in both, or by an option in either
        *((4, TWO, 0, {(50, 9): 4}), (4, TWO, 2, {(50, 9): 0, (25, 9): 4})),
        (4, STAR, 0, {(0, 9): 4, (14, 9): 0, (-19, 9): 4}),
    ],
)
def test_fences_are_where_parameters_say(kinds: int, items: Any, options: int, found: Any) -> None:
    it = Rig(FENCE_ENABLE=1.0, FENCE_TYPE=float(kinds), FENCE_OPTIONS=float(options))
    it.simulation.plans[PlanKind.FENCE] = tuple(items)
    fence, home = Fence(it.autopilot.parameters, it.autopilot.plans), Place(*COPTER_HOME)
    for north_m, up_m in found:
        there = EARTH.place(north_m, 0.0, -up_m)
        assert fence.outside(there, home, EARTH) == found[north_m, up_m]


def test_ideal_follows_a_turn_of_9_m_s2_at_150_m_s_without_overshoot() -> None:
    """A circle of 2.5 km, told ten times a second."""
    able = {"speed_max_m_s": 170.0, "acceleration_max_m_s2": 10.0}
    able |= {"speed_vertical_max_m_s": 25.0, "acceleration_vertical_max_m_s2": 5.0}
    it, speed_m_s, radius_m, off_m = Rig("ideal", **able).take_off(1000.0), 150.0, 2500.0, []
    it.vehicle.velocity_m_s = speed_m_s + 0j
    for k in range(4000):
        way = cmath.rect(1.0, speed_m_s * k * 0.01 / radius_m)  # north + east j
        at_m, moves = -radius_m * 1j * (way - 1.0), speed_m_s * way
        if k % 10 == 0:
            it.aim((at_m.real, at_m.imag, -1000.0), (moves.real, moves.imag, 0.0))
        it.step()
        off_m.append(abs(complex(*it.ne_m) - at_m))
    assert 5.0 < max(off_m[2000:]) <= 15.0
    assert abs(it.vehicle.acceleration_m_s2) == approx(9.0, rel=0.05)


def test_a_plane_without_a_position_to_go_to_keeps_its_last_commands() -> None:
    rig, banks_rad = offboard(), list[float]()
    rig.stream(1.0, (0.0, 5000.0, -70.0))
    for k in range(100):
        rig.aim((0.0, 0.0, -70.0), (14.0, 0.0, 0.0), (0.1, 0.1, 0.0), mask=(0xDC7, 0xC3F)[k % 2])
        banks_rad.append(rig.run(0.1).vehicle.roll_rad)
    assert banks_rad[10:] == about([banks_rad[10]] * 90, 0.03)
    assert banks_rad[10] > 0.5
    assert mode_height(rig) == ("Offboard", about(68.0, 3.0))
