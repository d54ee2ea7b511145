"""Fault campaigns: simulated trials with one fault each."""
