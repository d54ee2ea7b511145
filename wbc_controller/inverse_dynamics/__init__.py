"""The controller itself: model, dynamics, tasks, contacts, limits and the quadratic program.

It depends on no ROS, no DDS, no simulator, no YAML and no clock.
"""
