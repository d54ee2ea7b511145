"""Estimation of the base state."""
