"""Inverse dynamics: model, dynamics, tasks, contacts, limits and the quadratic program.

This package does not depend on ROS, DDS, a simulator, YAML or a clock.
"""
