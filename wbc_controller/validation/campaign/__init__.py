"""Fault campaigns: many simulated trials with one fault each, and their outcomes."""
