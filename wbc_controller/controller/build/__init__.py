"""Construction of a robot's objects from its settings.

Invalid settings raise `ConfigurationError` with key, value and valid values.
"""
