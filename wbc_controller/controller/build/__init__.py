"""Builds the objects of a robot from its settings, and checks the configuration before the robot moves."""
