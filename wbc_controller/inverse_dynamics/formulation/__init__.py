"""The quadratic program of one cycle: layout, cost, constraints, unpacking, and the reasons for infeasibility."""
