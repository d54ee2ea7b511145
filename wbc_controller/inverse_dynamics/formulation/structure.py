"""The two caches of the fast path: the structure of the problem, and the parameters written into it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from wbc_controller.inverse_dynamics.formulation.cost import LevelCost
from wbc_controller.inverse_dynamics.formulation.formulation_kernels import Program
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, TorqueLimit


@dataclass(slots=True)
class Structure:
    """The arrays of the problem for one set of active contacts and tasks; their sizes depend on nothing else.

    Attributes:
        version: number of structures that the controller has used before this one.
        layout: rows and columns of the problem.
        costs: the cost of each priority level, highest priority first.
        program: the same arrays for the kernel, with the parameters of the limits.
    """

    version: int
    layout: Layout
    costs: list[LevelCost]
    program: Program = field(init=False)


@dataclass(slots=True)
class Parameters:
    """The numbers in the problem that may change between two cycles, beside state and references.

    Attributes:
        weights: of the tasks, by name.
        activations: of the contacts, by name.
        motion_limit: bounds of the joint accelerations.
        torque_limit: bounds of the torques.
        changes: number of changes of attributes of tasks, contacts and limits, such as gains (`Tunable.version`).
        version: number of parameters that the controller has used before these.
    """

    weights: Mapping[str, float]
    activations: Mapping[str, float]
    motion_limit: JointMotionLimit
    torque_limit: TorqueLimit
    changes: int
    version: int
