"""Pre-flight check of a configuration."""
