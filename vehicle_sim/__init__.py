"""A MAVLink vehicle to test against: point-mass copter, autopilot, GPS and terrain radar."""
