"""Whole-body control of legged robots by one quadratic program per cycle.

::

    import wbc_controller as wbc

    controller = wbc.Controller(wbc.load("g1"))
    controller.reset(q, v)
    result = controller.step(q, v, t)         # result.tau: the torques

See docs/python.md. Names outside `__all__` may change.
"""

import importlib
from typing import TYPE_CHECKING, Any

from wbc_controller.extras import optional_libraries

if TYPE_CHECKING:
    from wbc_controller.controller.check import Finding
    from wbc_controller.controller.check.preflight import check
    from wbc_controller.controller.controller import Controller
    from wbc_controller.controller.result import CycleResult, plot
    from wbc_controller.errors import ConfigurationError, InputRefused, NoSolution, WbcError
    from wbc_controller.inverse_dynamics.contacts import AnchoredContact, Contact, UnilateralContact
    from wbc_controller.inverse_dynamics.limits import RowLimit
    from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
    from wbc_controller.inverse_dynamics.robot.model import RobotModel
    from wbc_controller.inverse_dynamics.tasks import EffortTask, MotionTask, RateTask, Task
    from wbc_controller.records import Fault, JointCommand, Mode, Reference, Solution
    from wbc_controller.settings.config import Config, load
    from wbc_controller.simulation.bridges import MujocoInterface, state_from_joints
    from wbc_controller.simulation.simulation import Simulation

__version__ = "0.1.0"  # version of the package, its wheel and its recordings; package.xml and CITATION.cff repeat it

#: Public names by module, imported on first use: MuJoCo is optional.
_NAMES = {
    "controller.check": "Finding",
    "controller.check.preflight": "check",
    "controller.controller": "Controller",
    "controller.result": "CycleResult plot",
    "errors": "ConfigurationError InputRefused NoSolution WbcError",
    "inverse_dynamics.contacts": "AnchoredContact Contact UnilateralContact",
    "inverse_dynamics.limits": "RowLimit",
    "inverse_dynamics.robot.dynamics": "Dynamics",
    "inverse_dynamics.robot.model": "RobotModel",
    "inverse_dynamics.tasks": "EffortTask MotionTask RateTask Task",
    "records": "Fault JointCommand Mode Reference Solution",
    "settings.config": "Config load",
    "simulation.bridges": "MujocoInterface state_from_joints",
    "simulation.simulation": "Simulation",
}
_PUBLIC = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = [
    "AnchoredContact", "Config", "ConfigurationError", "Contact", "Controller", "CycleResult", "Dynamics", "EffortTask",
    "Fault", "Finding", "InputRefused", "JointCommand", "Mode", "MotionTask", "MujocoInterface", "NoSolution",
    "RateTask", "Reference", "RobotModel", "RowLimit", "Simulation", "Solution", "Task", "UnilateralContact",
    "WbcError", "check", "load", "plot", "state_from_joints",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    with optional_libraries():
        value = getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
