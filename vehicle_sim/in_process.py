"""A simulated vehicle for whoever flies one without sockets, and what may go wrong with it.

Campaigns find this module by the name of an entry point in the group `companion.vehicles`; another
simulator joins by another name there.
"""

from pathlib import Path

from vehicle_sim.faults import COMPANION_OFF, entries, ways
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

__all__ = ["entries", "vehicle", "ways"]


def vehicle(world: Path, *, seed: int, faults: str) -> Simulation:
    """The vehicle of a world.toml, with a timeline of faults; whoever flies it kills companions."""
    lines = faults.splitlines()
    own = ("" if COMPANION_OFF in line.partition("#")[0].lower() else line for line in lines)
    return Simulation(read_world(world), seed=seed, faults="\n".join(own))
