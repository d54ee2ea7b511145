"""Terminal commands: run nodes, check configurations, send requests to running nodes, and show their status."""

#: Wall time after which an undiscovered node counts as absent, s. Fast DDS needs 1.1 s to introduce its writers and
#: readers to a new participant, and repeats a lost announcement after 3 s.
DISCOVERY_PATIENCE = 5.0
