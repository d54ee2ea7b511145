"""Faults of the mock robot."""
