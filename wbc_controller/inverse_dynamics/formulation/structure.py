"""Caches of the fast formulation: structure of the problem, and parameters written to it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from wbc_controller.inverse_dynamics.formulation.cost import LevelCost
from wbc_controller.inverse_dynamics.formulation.formulation_kernels import Program
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, TorqueLimit


@dataclass(slots=True)
class Structure:
    """Arrays of the problem for one set of active contacts and tasks."""

    version: int  # number of earlier structures
    layout: Layout  # rows and columns of the problem
    costs: list[LevelCost]  # of each priority level, highest first
    program: Program = field(init=False)  # arrays and limit parameters for the kernel


@dataclass(slots=True)
class Parameters:
    """Numbers of the problem that may change between two cycles, other than state and references."""

    weights: Mapping[str, float]  # of the tasks, by name
    activations: Mapping[str, float]  # of the contacts, by name
    motion_limit: JointMotionLimit  # bounds of joint accelerations
    torque_limit: TorqueLimit  # bounds of torques
    changes: int  # changes of attributes of tasks, contacts and limits (`Tunable.version`)
    version: int  # number of earlier parameters
