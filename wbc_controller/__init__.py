"""Whole-body control of legged and other floating-base robots by one quadratic program per cycle.

::

    import wbc_controller as wbc

    controller = wbc.Controller(wbc.load("g1"))
    controller.reset(q, v)
    result = controller.step(q, v, t)         # result.tau: the torques

docs/python.md is the guide. Everything in `__all__` is public; all else may change.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wbc_controller.assembly.finding import Finding
    from wbc_controller.assembly.preflight import check
    from wbc_controller.bridges.joints import state_from_joints
    from wbc_controller.bridges.mujoco import MujocoInterface
    from wbc_controller.control.controller import Controller
    from wbc_controller.control.result import CycleResult, plot
    from wbc_controller.core.contacts import AnchoredContact, Contact, UnilateralContact
    from wbc_controller.core.limits import RowLimit
    from wbc_controller.core.robot.dynamics import Dynamics
    from wbc_controller.core.robot.model import RobotModel
    from wbc_controller.core.tasks import EffortTask, MotionTask, RateTask, Task
    from wbc_controller.errors import ConfigurationError, InputRefused, NoSolution, WbcError
    from wbc_controller.mock.simulation import Simulation
    from wbc_controller.records import Fault, JointCommand, Mode, Reference, Solution
    from wbc_controller.settings.config import Config, load

#: Where each public name is defined. They are imported when they are first used: the command line starts without them,
#: and `Simulation` needs MuJoCo, an extra.
_PUBLIC = {
    "AnchoredContact": "core.contacts",
    "Config": "settings.config",
    "ConfigurationError": "errors",
    "Contact": "core.contacts",
    "Controller": "control.controller",
    "CycleResult": "control.result",
    "Dynamics": "core.robot.dynamics",
    "EffortTask": "core.tasks",
    "Fault": "records",
    "Finding": "assembly.finding",
    "InputRefused": "errors",
    "JointCommand": "records",
    "Mode": "records",
    "MotionTask": "core.tasks",
    "MujocoInterface": "bridges.mujoco",
    "NoSolution": "errors",
    "RateTask": "core.tasks",
    "Reference": "records",
    "RobotModel": "core.robot.model",
    "RowLimit": "core.limits",
    "Simulation": "mock.simulation",
    "Solution": "records",
    "Task": "core.tasks",
    "UnilateralContact": "core.contacts",
    "WbcError": "errors",
    "check": "assembly.preflight",
    "load": "settings.config",
    "plot": "control.result",
    "state_from_joints": "bridges.joints",
}

__all__ = [
    "AnchoredContact",
    "Config",
    "ConfigurationError",
    "Contact",
    "Controller",
    "CycleResult",
    "Dynamics",
    "EffortTask",
    "Fault",
    "Finding",
    "InputRefused",
    "JointCommand",
    "Mode",
    "MotionTask",
    "MujocoInterface",
    "NoSolution",
    "RateTask",
    "Reference",
    "RobotModel",
    "RowLimit",
    "Simulation",
    "Solution",
    "Task",
    "UnilateralContact",
    "WbcError",
    "check",
    "load",
    "plot",
    "state_from_joints",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
