"""Inverse dynamics by a quadratic program, without ROS, simulator and clock."""
