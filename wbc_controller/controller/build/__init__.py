"""Construction of objects from settings; invalid settings raise `ConfigurationError`."""
