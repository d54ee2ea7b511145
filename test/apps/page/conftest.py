"""Recordings for the tests of the page."""

from recorded_run import record

__all__ = ["record"]
