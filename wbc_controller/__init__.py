"""Whole-body control of legged and other floating-base robots by one quadratic program per cycle."""
