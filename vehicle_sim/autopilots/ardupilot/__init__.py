"""ArduPilot 4.7 as measured: arducopter.py, arduplane.py, and what they share.

For both: autopilot.py, ekf3.py, fence.py.  copter_*.py and plane_*.py fly.
"""
