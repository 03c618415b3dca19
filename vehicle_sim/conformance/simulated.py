"""The simulated vehicle that takes the place of the recorded one."""

import dataclasses

from vehicle_sim.conformance.flights import Flight
from vehicle_sim.conformance.log import Recording
from vehicle_sim.conformance.messages import Heard
from vehicle_sim.conformance.player import Player
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import World, flat_world


def play(recording: Recording, flight: Flight, *, seed: int = 0) -> list[Heard]:
    """Everything that the simulated vehicle says while the recorded client flies it."""
    simulation = simulation_of(recording, flight, seed=seed)
    return list(Player(simulation, recording, flight).run())


def simulation_of(recording: Recording, flight: Flight, *, seed: int = 0) -> Simulation:
    """A vehicle of the recorded kind, where it stood, with its parameters and its faults."""
    return Simulation(world_of(recording, flight), seed=seed, faults=timeline(recording, flight))


def world_of(recording: Recording, flight: Flight) -> World:
    """Level ground at home."""
    home = flight.home
    world = flat_world(
        recording.kind,
        recording.firmware,
        latitude_deg=home.latitude_deg,
        longitude_deg=home.longitude_deg,
        altitude_amsl_m=home.altitude_amsl_m,
        heading_deg=home.heading_deg,
        system_id=recording.system,
    )
    vehicle = dataclasses.replace(world.vehicle, parameters=dict(flight.parameters))
    return dataclasses.replace(world, vehicle=vehicle)


def timeline(recording: Recording, flight: Flight) -> str:
    """The flight's faults as lines of a timeline file, in vehicle time."""
    lines = []
    for fault in flight.faults:
        begin_s, end_s = (recording.clock.vehicle_s(t) for t in (fault.begin_s, fault.end_s))
        lines.append(f"at {begin_s:.2f} s for {end_s - begin_s:.2f} s: {fault.what}\n")
    return "".join(lines)
