"""Measurements of the running controller: `wbc bench`."""

DOMAIN = 92  # DDS domain of the measurements, unlike ROS 2's default of 0
