"""Estimation of the base state from an IMU, joint states and active contacts."""
