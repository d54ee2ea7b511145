"""Inverse dynamics: model, tasks, contacts, limits and the quadratic program; without ROS, simulator and clock."""
