"""Hostile input: fuzzers, floods, killed processes, long runs."""

DOMAIN = 91  # DDS domain of live trials
