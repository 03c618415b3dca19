"""Online path planner for a drone's companion computer."""
