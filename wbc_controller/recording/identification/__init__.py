"""Identification of dynamic parameters: `wbc identify`."""
