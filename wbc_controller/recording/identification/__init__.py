"""Identification of frictions, masses and armature from a recording: `wbc identify`."""
