"""Construction of objects from settings.

Invalid settings raise `ConfigurationError`.
"""
