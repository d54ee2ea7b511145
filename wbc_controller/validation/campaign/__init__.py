"""Fault campaigns: many simulated trials, each with one fault, and what the controller made of them."""
