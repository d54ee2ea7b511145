"""Inverse dynamics by a quadratic program."""
