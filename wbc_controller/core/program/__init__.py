"""The quadratic program of one cycle: its layout, its terms, its answer, and why there may be none."""
