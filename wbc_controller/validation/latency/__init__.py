"""Measurements of the running controller: `wbc bench`."""

DOMAIN = 92  # default DDS domain of the measurements, unlike the domain 0 of ROS 2 with possible real robots
