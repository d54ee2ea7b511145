"""The quadratic program of one cycle."""
