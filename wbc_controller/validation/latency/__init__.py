"""Measurements of the controller as it runs: `wbc bench`."""

#: DDS domain of the measurements where none is asked for: not ROS 2's default of 0, where a real robot may be.
DOMAIN = 92
