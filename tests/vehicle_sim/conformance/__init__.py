"""How like the real autopilots the simulated ones are: recorded flights played again, compared.

A recorded flight (.tlog) holds both directions.  The client's half is played into a simulation in
vehicle time, and what comes back is compared with the autopilot's half, row by row, each with a
tolerance that is stated.

flights.py   the recording, what it does not say of itself, and its client flown again
rows.py      the rows; track.py and lidar.py those of the flight and of a lidar; compare.py all
"""
