"""Faults of the mock robot: sensors, message delivery, stamps, actuators, world."""
