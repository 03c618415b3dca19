# What ArduPlane says by itself after power-up, by the recorded flights: microseconds since boot,
# then a text with its severity, a parameter, or a parameter that changes to this value.
133000 CAM1_TYPE
133000 CAM2_TYPE
133000 INS_GYR_ID
133000 INS_ACC_ID
133000 INS_GYR2_ID
134000 INS_ACC2_ID
134000 BARO_ALT_OFFSET
139000 6 Ground start
139000 1 Skipping INS calibration
139000 6 Calibrating barometer
203000 7 RCInput: decoding UDP (Pulses)
1727000 6 Barometer 1 calibration complete
1727000 6 Barometer 2 calibration complete
1727000 6 Airspeed 1 calibration started
1727000 6 ArduPilot Ready
1727000 6 AHRS: DCM active
1727000 BARO1_GND_PRESS 94501.734375
1727000 BARO2_GND_PRESS 94503.234375
1746000 4 Throttle failsafe off
2745000 EK3_SRC1_POSXY
3408000 6 Airspeed 1 calibrated
3408000 ARSPD_OFFSET 2013.9466552734375
9055000 6 GPS 1: probing for u-blox at 230400 baud
9055000 6 GPS 1: detected u-blox
9506000 6 EKF2 IMU0 MAG0 initial yaw alignment complete
9506000 6 EKF2 IMU1 MAG0 initial yaw alignment complete
10266000 6 EKF3 IMU0 initialised
10266000 6 EKF3 IMU1 initialised
12148000 6 EKF3 IMU0 tilt alignment complete
12148000 6 EKF3 IMU1 tilt alignment complete
12226000 6 EKF3 IMU0 MAG0 initial yaw alignment complete
12226000 6 EKF3 IMU1 MAG0 initial yaw alignment complete
14750000 6 EKF2 IMU0 tilt alignment complete
14750000 6 EKF2 IMU1 tilt alignment complete
15710000 BARO1_GND_PRESS 94504.5625
15710000 BARO2_GND_PRESS 94505.0625
44559000 6 EKF2 IMU0 is using GPS
44559000 6 EKF2 IMU1 is using GPS
