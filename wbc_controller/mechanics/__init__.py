"""Equations S1 to S11 of Nathan Ratliff's note "Analytical Dynamics and Contact Analysis".

The functions take Pinocchio models and arrays, return new arrays, and do not depend on the controller. Numbers in
parentheses are equations of the note (docs/mechanics.md). Common arguments:

- ``model``: `pinocchio.Model`; ``data``: workspace, by default a new one.
- ``q`` (nq,), ``v`` (nv,), ``v_dot`` (nv,): configuration, generalized velocity and acceleration; ``t``: time, s.
- ``M`` (nv, nv): mass matrix; ``h`` (nv,): bias force, N and N·m; ``force`` (nv,): generalized force, N and N·m.
- ``A`` (k, nv), ``b`` (k,): constraints A v̇ = b in m/s² and rad/s², of any rank; k may be 0.
- ``v_dot_u`` (nv,): unconstrained acceleration, m/s² and rad/s².
- ``constraints``: bilateral, possibly redundant; ``kinematics``: their state.
- ``wrenches``: contacts and other external wrenches; ``before``, ``after``: consecutive states.
- ``perturbation``: δq (nv,) as a function of q; ``joint``: a joint with one degree of freedom.
- ``system``: particles with positions ``x`` and velocities ``x_dot``, (n, 3) in m and m/s, and ``forces`` besides
  gravity, (n, 3) in N; ``structure`` and ``contact``: rows A_s (k, 3n), b_s (k,) and A_c (m, 3n), b_c (m,) of (33).
- ``acceleration``: v̇(q, v, t), (nv,); ``step``: integration step, s; ``steps``: number of steps.

`ConfigurationError`: unknown frame or joint, invalid parameter. `InputRefused`: wrong shape, NaN, order of states.
"""

from wbc_controller.mechanics.constraints import (
    Constraint,
    ConstraintEquation,
    ConstraintTerms,
    JointCoupling,
    Kinematics,
    Motion,
    PinnedFrames,
    PlaneContact,
    PointContact,
    Rolling,
    SurfaceContact,
    WeldedFrames,
    constraint_equation,
    ground,
    oscillating_support,
)
from wbc_controller.mechanics.contact_dynamics import constrained_dynamics, contact_dynamics_equations
from wbc_controller.mechanics.coordinate_change import CoordinateChange, change_coordinates
from wbc_controller.mechanics.energy import (
    EnergyBalance,
    energy_residual,
    hamiltonian,
    hamiltonian_rate,
    kinetic_energy,
    lagrangian,
    potential_energy,
    power,
)
from wbc_controller.mechanics.equations_of_motion import (
    actuation_matrix,
    bias_force,
    equations_of_motion_residual,
    forward_dynamics,
    generalized_gravity,
    inverse_dynamics,
    mass_matrix,
    runge_kutta_step,
    simulate,
)
from wbc_controller.mechanics.external import ExternalWrench, generalized_force, world_wrench
from wbc_controller.mechanics.gauss import (
    ConstrainedMotion,
    admissible_directions,
    gauss,
    gauss_functional,
    gauss_unilateral,
    udwadia_kalaba,
)
from wbc_controller.mechanics.momentum import (
    MomentumBalance,
    centroidal_momentum,
    centroidal_momentum_rate,
    centroidal_wrench,
    generalized_momentum,
    momentum_residual,
)
from wbc_controller.mechanics.particles import (
    ParticleSystem,
    ReducedProblem,
    Rod,
    particle_mass_matrix,
    reduce_structure,
    rod_constraints,
    solve_in_one_stage,
    solve_in_two_stages,
)
from wbc_controller.mechanics.symmetry import (
    SymmetryReport,
    check_symmetry,
    conserved_quantity,
    joint_shift,
    lagrangian_variation,
    rotation,
    translation,
)

__all__ = [
    "ConstrainedMotion", "Constraint", "ConstraintEquation", "ConstraintTerms", "CoordinateChange", "EnergyBalance",
    "ExternalWrench", "JointCoupling", "Kinematics", "MomentumBalance", "Motion", "ParticleSystem", "PinnedFrames",
    "PlaneContact", "PointContact", "ReducedProblem", "Rod", "Rolling", "SurfaceContact", "SymmetryReport",
    "WeldedFrames", "actuation_matrix", "admissible_directions", "bias_force", "centroidal_momentum",
    "centroidal_momentum_rate", "centroidal_wrench", "change_coordinates", "check_symmetry", "conserved_quantity",
    "constrained_dynamics", "constraint_equation", "contact_dynamics_equations", "energy_residual",
    "equations_of_motion_residual", "forward_dynamics", "gauss", "gauss_functional", "gauss_unilateral",
    "generalized_force", "generalized_gravity", "generalized_momentum", "ground", "hamiltonian", "hamiltonian_rate",
    "inverse_dynamics", "joint_shift", "kinetic_energy", "lagrangian", "lagrangian_variation", "mass_matrix",
    "momentum_residual", "oscillating_support", "particle_mass_matrix", "potential_energy", "power", "reduce_structure",
    "rod_constraints", "rotation", "runge_kutta_step", "simulate", "solve_in_one_stage", "solve_in_two_stages",
    "translation", "udwadia_kalaba", "world_wrench",
]  # fmt: skip
