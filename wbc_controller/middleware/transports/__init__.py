"""Transports of messages: in memory, by DDS, by ROS 2."""
