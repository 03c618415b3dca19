"""What the vehicle is told of itself and of the ground, with the errors of real sensors."""
