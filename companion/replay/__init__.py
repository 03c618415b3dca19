"""Recorded flights: decided again, looked at, passed on."""
