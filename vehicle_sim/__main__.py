"""python -m vehicle_sim: the same as vehicle-sim."""

from vehicle_sim.cli import main

main()
