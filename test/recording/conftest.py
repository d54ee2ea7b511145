"""Tests of the recorder use a controller whose cycles are recorded."""

from recorded_run import record

__all__ = ["record"]
