"""Who may import whom. The layers are those of the package's design; a new import that crosses them fails here."""

import ast
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

PACKAGE = "wbc_controller"
ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / PACKAGE

#: Module that few may import: the files, relative to the package, that may.
RESERVED = {
    "mujoco": ("mock/*",),
    "cyclonedds": ("transports/dds*.py",),
    "rclpy": ("transports/ros2*.py", "ros2/*"),
}
#: For the files of a layer: what of the outside they may import besides the standard library, and what of the package.
LAYERS = {
    "errors.py": ((), ()),
    "records.py": (("numpy",), ()),
    "mechanics/*": (("numpy", "scipy", "pinocchio"), ("mechanics", "records", "errors")),
    "core/*": (
        ("numpy", "scipy", "pinocchio", "coal", "qpsolvers", "daqp", "osqp", "proxsuite"),
        ("core", "mechanics", "records", "errors"),
    ),
    # Of core the supervisor needs the robot's limits, and ramps; never the controller whose answers it checks.
    "safety/*": (("numpy",), ("safety", "core.model", "core.limits.torque", "core.trajectories", "records", "errors")),
    "settings/*": (("pydantic",), ("settings",)),
    "configuration.py": (("pydantic", "yaml"), ("configuration", "settings", "resources", "errors")),
    "interface.py": ((), ("interface", "records", "errors")),
}
#: Files that may import the mock robot: itself, and those that start it.
MOCK = ("mock/*", "demo/*", "service.py", "cli.py")
#: A back end of the quadratic program is the only part that knows its solver.
SOLVERS = ("qpsolvers", "daqp", "osqp", "proxsuite")
#: Modules of the standard library that are clocks, or sources of anything else that cannot be replayed.
CLOCKS = ("time", "datetime", "random", "threading", "asyncio", "socket", "subprocess", "logging")


def imports_of(path: Path, module: str) -> set[str]:
    """Every module that a file imports, anywhere in it, by full name; `from a import b` counts as a and as a.b."""
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            start = ".".join([*above, *([node.module] if node.module else [])])
            found |= {start} | {f"{start}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in ("import_module", "__import__") and node.args and isinstance(node.args[0], ast.Constant):
                found.add(str(node.args[0].value))
    return found


def walk(sources: Path) -> dict[str, set[str]]:
    """The imports of every file below a package's folder, by path relative to it."""
    found = {}
    for path in sorted(sources.rglob("*.py")):
        relative = path.relative_to(sources)
        module = ".".join([PACKAGE, *relative.with_suffix("").parts]).removesuffix(".__init__")
        found[relative.as_posix()] = imports_of(path, module)
    return found


def matches(file: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatch(file, pattern) for pattern in patterns)


def own(module: str) -> str | None:
    """The part of the package that is imported, or None where the module is not of this package."""
    return module.removeprefix(PACKAGE).lstrip(".") if module.split(".")[0] == PACKAGE else None


def within(module: str, allowed: tuple[str, ...]) -> bool:
    """Whether a module is one of these, or inside of one; the package's own empty root may always be named."""
    return module == "" or any(module == name or module.startswith(name + ".") for name in allowed)


def violations(found: dict[str, set[str]]) -> list[str]:
    """A sentence for every import that crosses the layers."""
    wrong = []
    for file, modules in found.items():
        for module in sorted(modules):
            top, inner = module.split(".")[0], own(module)
            if top in RESERVED and not matches(file, RESERVED[top]):
                wrong.append(f"{file} imports {module}: only {', '.join(RESERVED[top])} may")
            if file.startswith("core/") and top in CLOCKS:
                wrong.append(f"{file} imports {module}: core knows no clock, no thread and no log")
            if file.startswith("core/") and top in SOLVERS and not file.startswith("core/solvers/"):
                wrong.append(f"{file} imports {module}: only core/solvers may")
            if inner and within(inner, ("mock",)) and not matches(file, MOCK):
                wrong.append(f"{file} imports {module}: only {', '.join(MOCK)} may")
            for pattern, (outside, inside) in LAYERS.items():
                if not fnmatch(file, pattern):
                    continue
                if inner is None and top not in sys.stdlib_module_names and top not in outside:
                    wrong.append(f"{file} imports {module}: of the outside {pattern} may import {outside}")
                # `from wbc_controller.core import model` also names wbc_controller.core: judged by what it leads to.
                leads_inside = inner is not None and any(within(name, (inner,)) for name in inside)
                if inner is not None and not within(inner, inside) and not leads_inside:
                    wrong.append(f"{file} imports {module}: of this package {pattern} may import {inside}")
    return wrong


def test_the_layers_hold():
    assert violations(walk(SOURCES)) == []


def test_the_walk_sees_the_whole_package():
    found = walk(SOURCES)
    assert len(found) > 40
    assert "mujoco" in found["mock/plant.py"]
    assert "cyclonedds.domain" in found["transports/dds.py"]
    assert any(module.startswith("rclpy") for module in found["transports/ros2.py"])
    assert "wbc_controller.core.model.RobotModel" in found["safety/supervisor.py"]
    for pattern in LAYERS:
        assert any(fnmatch(file, pattern) for file in found) or pattern == "mechanics/*"


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("core/planted.py", "import time"),
        ("core/planted.py", "from time import monotonic"),
        ("core/planted.py", "def f():\n    import datetime"),
        ("core/planted.py", "import logging"),
        ("core/planted.py", "import yaml"),
        ("core/planted.py", "import pydantic"),
        ("core/planted.py", "from rosbags.typesys import Stores"),
        ("core/planted.py", "import osqp"),
        ("core/planted.py", "from wbc_controller import settings"),
        ("core/planted.py", "from wbc_controller.settings import Settings"),
        ("core/planted.py", "from .. import loop"),
        ("core/planted.py", "from ..safety.supervisor import Supervisor"),
        ("core/tasks/planted.py", "from ... import inputs"),
        ("core/tasks/planted.py", "import importlib\nimportlib.import_module('mujoco')"),
        ("core/planted.py", "import wbc_controller.transports.memory"),
        ("core/planted.py", "if True:\n    from wbc_controller import outputs"),
        ("core/planted.py", "import wbc_controller.service"),
        ("core/planted.py", "from wbc_controller.build import make_model"),
        ("build.py", "import mujoco"),
        ("demo/planted.py", "import mujoco as mj"),
        ("loop.py", "from wbc_controller.mock.plant import Plant"),
        ("transports/memory.py", "import cyclonedds"),
        ("transports/ros2.py", "import cyclonedds.domain"),
        ("transports/dds.py", "import rclpy"),
        ("node.py", "import rclpy"),
        ("outputs.py", "from rclpy.node import Node"),
        ("records.py", "import pinocchio"),
        ("records.py", "from wbc_controller.errors import WbcError"),
        ("mechanics/planted.py", "from wbc_controller.core.dynamics import Dynamics"),
        ("mechanics/planted.py", "import qpsolvers"),
        ("safety/planted.py", "from wbc_controller.core.controller import Controller"),
        ("safety/planted.py", "from wbc_controller.core import controller"),
        ("safety/planted.py", "from wbc_controller.outputs import Outputs"),
        ("safety/planted.py", "import yaml"),
    ],
)
def test_a_planted_violation_is_seen(tmp_path, file, line):
    planted = tmp_path / file
    planted.parent.mkdir(parents=True, exist_ok=True)
    planted.write_text(f'"""Planted."""\n\n{line}\n', encoding="utf-8")
    found = violations(walk(tmp_path))
    assert found
    assert all(sentence.startswith(f"{file} imports ") for sentence in found)


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("mock/planted.py", "import mujoco"),
        ("transports/dds_planted.py", "from cyclonedds.domain import Domain"),
        ("transports/ros2.py", "import rclpy.qos"),
        ("ros2/planted.py", "import rclpy"),
        (
            "core/planted.py",
            "from wbc_controller.core.model import RobotModel\nfrom wbc_controller.records import Array",
        ),
        ("core/planted.py", "from . import model\nimport math"),
        ("core/solvers/planted.py", "import daqp"),
        ("safety/planted.py", "from wbc_controller.core.model import RobotModel"),
        ("safety/planted.py", "from wbc_controller.core import model"),
        ("records.py", "import numpy.typing as npt\nfrom dataclasses import dataclass"),
        ("demo/planted.py", "from wbc_controller.mock.plant import Plant\nimport time"),
    ],
)
def test_what_is_allowed_is_not_called_a_violation(tmp_path, file, line):
    planted = tmp_path / file
    planted.parent.mkdir(parents=True, exist_ok=True)
    planted.write_text(f"{line}\n", encoding="utf-8")
    assert violations(walk(tmp_path)) == []
