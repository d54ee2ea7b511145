"""Estimation of the base state from IMU, joint states and contacts."""
