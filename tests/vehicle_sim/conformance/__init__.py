"""How like the real autopilots the simulated ones are: recorded flights played again, compared.

A recorded flight (.tlog) holds both directions.  The client's half is played into a simulation in
vehicle time, and what comes back is compared with the autopilot's half, row by row, each with a
tolerance that is stated.

log.py       the recording: who said what, at which vehicle time
flights.py   what a recording does not say of itself, which differences are known and why; the
             simulation that it asks for, and the client's half played into that
rows.py      what a row is, and how events of two flights are paired
answers.py, states.py, streams.py, track.py, lidar.py    the rows; compare.py all of them
report.py    the table
"""
