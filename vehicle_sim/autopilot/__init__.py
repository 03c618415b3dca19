"""The simulated autopilots: one engine, a value for each firmware and a class for each way to fly.

`core` is what every autopilot does; `ardupilot` and `px4` are what their two vehicles share: what
they answer, and what brings them down; `arducopter`, `px4copter` and the others are a table
of modes and a class that flies them.  Vehicle time is in seconds since boot; places in the plane
are complex numbers, north + east j.
"""
