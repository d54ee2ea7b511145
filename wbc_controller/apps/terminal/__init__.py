"""A user at the command line: sends requests to running nodes, and shows what they say."""

#: Wall time after which an undiscovered node counts as absent, s. Fast DDS needs 1.1 s to introduce its writers and
#: readers to a new participant, and repeats a lost announcement after 3 s.
DISCOVERY_PATIENCE = 5.0
