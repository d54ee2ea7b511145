"""Fault campaigns, fuzzers, accuracy, latency."""
