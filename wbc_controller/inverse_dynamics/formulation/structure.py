"""Caches of the fast formulation."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from wbc_controller.inverse_dynamics.formulation.cost import LevelCost
from wbc_controller.inverse_dynamics.formulation.formulation_kernels import Program
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.problem import Level
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, TorqueLimit


class Parameters(NamedTuple):
    """Numbers of the problem that may change between cycles, other than state and references."""

    weights: Mapping[str, float]  # of tasks
    activations: Mapping[str, float]  # of contacts
    motion_limit: JointMotionLimit
    torque_limit: TorqueLimit
    changes: int  # number of attribute changes (`Tunable.version`)


@dataclass(slots=True)
class Structure:
    """Arrays of the problem for one set of active contacts and tasks."""

    layout: Layout  # also of the structures with other tasks
    costs: list[LevelCost]  # of each priority level, highest first
    levels: list[Level]  # of the costs
    parameters: Parameters | None = None  # in the arrays; None for those of another structure
    program: Program = field(init=False)  # for the kernel
