"""Construction of a robot's objects from its settings."""
