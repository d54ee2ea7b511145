"""The two caches of the fast path: the structure of the problem, and the parameters written into it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from wbc_controller.inverse_dynamics.formulation.cost import LevelCost
from wbc_controller.inverse_dynamics.formulation.formulation_kernels import Program
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, TorqueLimit


@dataclass(slots=True)
class Structure:
    """The arrays of the problem for one set of active contacts and tasks; their sizes depend on nothing else."""

    version: int  # number of structures that the controller has used before this one
    layout: Layout  # rows and columns of the problem
    costs: list[LevelCost]  # the cost of each priority level, highest priority first
    program: Program = field(init=False)  # the same arrays for the kernel, with the parameters of the limits


@dataclass(slots=True)
class Parameters:
    """The numbers in the problem that may change between two cycles, beside state and references."""

    weights: Mapping[str, float]  # of the tasks, by name
    activations: Mapping[str, float]  # of the contacts, by name
    motion_limit: JointMotionLimit  # bounds of the joint accelerations
    torque_limit: TorqueLimit  # bounds of the torques
    changes: int  # number of changes of attributes of tasks, contacts and limits, such as gains (`Tunable.version`)
    version: int  # number of parameters that the controller has used before these
