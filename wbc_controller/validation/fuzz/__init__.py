"""Tests with hostile input: fuzzers of messages and files, floods, killed processes, and long runs."""

DOMAIN = 91  # DDS domain of live trials, unlike ROS 2's default of 0
