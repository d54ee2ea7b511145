"""Tests by hostile input: fuzzers of messages and files, floods, killed processes, and long runs."""

#: DDS domain of the live trials where none is asked for: not ROS 2's default of 0, where a real robot may be.
DOMAIN = 91
