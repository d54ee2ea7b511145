"""Faults of the mock robot: in its sensors, in the delivery of its messages, in its actuators and in its world."""
