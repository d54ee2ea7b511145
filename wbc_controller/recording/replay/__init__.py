"""Recordings that are looked at and solved again: `wbc replay` and `wbc report`."""
