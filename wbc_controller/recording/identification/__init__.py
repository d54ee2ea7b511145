"""Frictions, masses and armature of a robot from a recording: `wbc identify`."""
