"""Construction of a robot's objects from its settings.

Invalid settings raise `ConfigurationError`.
"""
