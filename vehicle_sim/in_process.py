"""A simulated vehicle for whoever flies one without sockets, found by the name of an entry point.

Campaigns look for the group `companion.vehicles`; another simulator joins by another name there.
"""

from pathlib import Path

from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world


def vehicle(world: Path, *, seed: int, faults: str) -> Simulation:
    """The vehicle of a world.toml, with a timeline of faults."""
    return Simulation(read_world(world), seed=seed, faults=faults)
