"""Walking: from a velocity command to contacts and references, step by step.

Positions and velocities on the ground are complex numbers, x + i y: multiplying by e^{iψ} turns them by the angle ψ.
"""
