"""Faults: SIM_ parameters, the conditions that they make, and the timeline that sets them."""
