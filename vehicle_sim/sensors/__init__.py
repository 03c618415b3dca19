"""Sensor models, with the errors of real sensors."""
