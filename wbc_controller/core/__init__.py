"""The controller proper: model, dynamics, tasks, contacts, limits, the quadratic program.

It knows no ROS, no DDS, no simulator, no YAML and no clock.
"""
