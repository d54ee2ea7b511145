"""Walking: from commands to contacts and references.

Positions and velocities on the ground are complex numbers, x + i y: multiplying by e^{iψ} turns them by the angle ψ.
"""
