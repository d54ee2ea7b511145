"""Identification of friction, masses and armature: `wbc identify`."""
