"""Tests with hostile input: fuzzers of messages and files, floods, killed processes, and long runs."""

DOMAIN = 91  # default DDS domain of live trials, unlike the domain 0 of ROS 2 with possible real robots
