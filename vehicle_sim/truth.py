"""The truth file: where the vehicle really was, one JSON object a line."""

import json

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.dynamics.contact import Crash
from vehicle_sim.world import World

INTERVAL_US = 100_000


def header(world: World, seed: int) -> str:
    """The first line: what the others are, and where their frame lies."""
    return json.dumps(
        {
            "schema": 1,
            "kind": "vehicle_sim truth",
            "world": world.name,
            "seed": seed,
            "origin_latitude_deg": world.origin.latitude_deg,
            "origin_longitude_deg": world.origin.longitude_deg,
            "interval_s": INTERVAL_US / 1e6,
            "velocities": "true north, true east, up",
        }
    )


def line(
    now_us: int,
    local_m: tuple[float, float],
    vehicle: Vehicle,
    state: tuple[str, bool, bool],
    near_m: float | None,
    believed_nea_m: tuple[float, float, float] | None,
    crash: Crash | None,
) -> str:
    """One moment; state: mode, whether it is armed, whether it stands on the ground.

    near_m: least distance to any near thing since the moment before, None: no things.
    believed_nea_m: where its autopilot believes to be, None: it has no position to fly by.
    crash: the first of the flight, as soon as there was one.

    Written by hand: json.dumps would take longer than the flying.
    """
    (north_m, east_m), (mode, armed, landed) = local_m, state
    rest = "" if near_m is None else f', "near_m": {near_m:.3f}'
    if believed_nea_m is not None:
        place = '"north_m": {:.4f}, "east_m": {:.4f}, "altitude_amsl_m": {:.4f}'
        rest += f', "believed": {{{place.format(*believed_nea_m)}}}'
    if crash is not None:
        rounded = [round(v, 4) if isinstance(v, float) else v for v in crash]
        rest += f', "crash": {json.dumps(dict(zip(crash._fields, rounded, strict=True)))}'
    return (
        f'{{"t_s": {now_us * 1e-6:.2f}, "north_m": {north_m:.4f}, "east_m": {east_m:.4f}, '
        f'"altitude_amsl_m": {vehicle.altitude_amsl_m:.4f}, '
        f'"lat_deg": {vehicle.latitude_deg:.10f}, "lon_deg": {vehicle.longitude_deg:.10f}, '
        f'"velocity_north_m_s": {vehicle.velocity_m_s.real:.4f}, '
        f'"velocity_east_m_s": {vehicle.velocity_m_s.imag:.4f}, '
        f'"velocity_up_m_s": {vehicle.velocity_up_m_s:.4f}, '
        f'"mode": "{mode}", "armed": {str(armed).lower()}, "landed": {str(landed).lower()}{rest}}}'
    )
