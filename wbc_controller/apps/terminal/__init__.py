"""Terminal commands."""

#: Time limit for the discovery of a node, wall time, s. Fast DDS needs 1.1 s for a new participant, and repeats a lost
#: announcement after 3 s.
DISCOVERY_PATIENCE = 5.0
