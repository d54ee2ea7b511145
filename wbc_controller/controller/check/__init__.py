"""The pre-flight check of a configuration."""
