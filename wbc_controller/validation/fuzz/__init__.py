"""Hostile input: fuzzers, floods, killed processes, long runs."""
