"""What is out there: terrain, threats, what a scan shows of them, and the map known so far."""
