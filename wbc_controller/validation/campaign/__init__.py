"""Fault campaigns: many simulated trials, each with one fault, and their outcomes."""
