"""Measurements of the running controller: `wbc bench`."""

DOMAIN = 92  # DDS domain of the measurements
