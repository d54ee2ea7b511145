"""Fixture of recorder tests: a controller with recorded cycles."""

from recorded_run import record

__all__ = ["record"]
