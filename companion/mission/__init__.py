"""What to do next: the mission machine, a pure function of (state, event)."""
