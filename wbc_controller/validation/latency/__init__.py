"""Measurements of the running controller: `wbc bench`."""

#: Default DDS domain of the measurements, unlike the domain 0 of ROS 2 with possible real robots.
DOMAIN = 92
