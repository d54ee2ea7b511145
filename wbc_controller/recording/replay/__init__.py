"""Replay and summary of recordings: `wbc replay`."""
