"""PX4 1.17 as measured: multicopter.py, fixed_wing.py, and what they share.

For both: autopilot.py with commands.py, ekf2.py, failsafe.py, mission.py, fence.py.
"""
