"""Fault campaigns, fuzzers, accuracy of the estimator, latency."""
