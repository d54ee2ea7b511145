"""The quadratic program of one cycle: layout, cost, constraints, unpacking and infeasibility."""
