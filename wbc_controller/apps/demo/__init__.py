"""Demonstration on the mock robot, with a report."""
