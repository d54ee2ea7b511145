"""Recordings that are summarized and solved again: `wbc replay`."""
