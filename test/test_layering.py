"""Which room may import which. Imports go one way: a new one that runs back up, or crosses a wall, fails here.

A room is a folder of the package (in `core`, a folder or file below it); what lies at the package's top is a room each.
"""

import ast
import re
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

PACKAGE = "wbc_controller"
ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / PACKAGE
MAP = (ROOT / "docs" / "map.md").read_text(encoding="utf-8")

GROUND = ("errors", "records")
CORE = ("core/robot", "core/contacts", "core/limits", "core/tasks", "core/references")
#: From the ground up: each room, what of the package it may import beside the ground, and what of the outside beside
#: the standard library. A room may only import rooms above it in this table.
ROOMS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "errors": ((), ()),
    "records": ((), ("numpy",)),
    "settings": ((), ("pydantic", "yaml")),
    "mechanics": ((), ("numpy", "scipy", "pinocchio")),
    "kernels": ((), ("numpy", "numba", "llvmlite")),  # a part of Numba
    "core/arrays": ((), ("numpy", "scipy")),
    "core/tunable": ((), ()),
    "core/method_calls": (("core/arrays",), ("numpy",)),
    "core/robot": (("core/arrays", "kernels"), ("numpy", "scipy", "pinocchio")),
    "core/contacts": (("core/robot", "core/tunable", "core/method_calls", "kernels"), ("numpy", "scipy", "pinocchio")),
    "core/limits": (("core/robot", "core/tunable", "kernels"), ("numpy", "pinocchio", "coal")),
    "core/tasks": (
        ("core/robot", "core/contacts", "core/arrays", "core/tunable", "core/method_calls", "kernels"),
        ("numpy", "pinocchio"),
    ),
    "core/references": (("core/robot", "core/contacts", "core/tasks"), ("numpy", "pinocchio")),
    "core/program": (
        (*CORE[:4], "core/arrays", "core/tunable", "core/method_calls", "kernels"),
        ("numpy", "scipy"),
    ),
    "core/solvers": (
        ("core/program", "kernels"),
        ("numpy", "scipy", "qpsolvers", "daqp", "osqp", "proxsuite"),
    ),
    "core/whole_body_qp": (("core/robot", "core/contacts", "core/tasks", "core/program", "core/solvers"), ()),
    # Of core the supervisor needs the robot's limits, and ramps; never the program whose answers it checks.
    "safety": (
        ("core/robot", "core/limits", "core/references", "core/arrays", "kernels"),
        ("numpy", "scipy", "pinocchio"),
    ),
    "estimation": (("core/robot", "core/contacts", "core/arrays", "kernels"), ("numpy", "scipy", "pinocchio")),
    "bridges": (("core/robot", "core/tasks"), ("numpy",)),
    "views": (
        ("core/robot", "core/contacts", "core/tasks", "core/method_calls", "settings"),
        ("numpy", "scipy", "pinocchio", "coal", "plotly", "rich"),
    ),
    "assembly": (
        (
            *CORE,
            "core/method_calls",
            "core/program",
            "core/solvers",
            "core/whole_body_qp",
            "safety",
            "estimation",
            "settings",
        ),
        ("numpy", "scipy", "pinocchio", "coal"),
    ),
    "control": (
        (*CORE, "core/whole_body_qp", "safety", "estimation", "settings", "views", "assembly"),
        ("numpy", "pydantic", "pinocchio"),
    ),
    "wire": (("settings", "core/references", "core/tasks", "kernels"), ("numpy", "yaml", "rosbags")),
    "transports": (("wire",), ("cyclonedds", "rclpy", "rosbags", "numpy")),
    "recording": (
        ("core/references", "core/whole_body_qp", "settings", "assembly", "control", "wire", "transports"),
        ("numpy", "yaml", "backports", "compression"),
    ),
    "diagnostics": (
        ("core/robot", "core/contacts", "core/tasks", "core/method_calls", "views", "wire", "kernels"),
        ("numpy",),
    ),
    "service": (
        (
            "core/robot",
            "kernels",
            "core/contacts",
            "core/references",
            "safety",
            "estimation",
            "settings",
            "assembly",
            "control",
            "wire",
            "transports",
            "recording",
            "diagnostics",
        ),
        ("numpy",),
    ),
    "mock": (
        (
            "core/arrays",
            "core/robot",
            "core/contacts",
            "core/limits",
            "core/tasks",
            "settings",
            "assembly",
            "control",
            "wire",
            "transports",
        ),
        ("numpy", "scipy", "pydantic", "pinocchio", "coal", "mujoco"),
    ),
    "ros2": (
        ("core/robot", "settings", "control", "wire", "transports", "recording", "service", "mock"),
        ("pydantic", "rclpy", "rcl_interfaces", "std_srvs"),
    ),
    "demo": (
        (
            "core/robot",
            "core/contacts",
            "core/references",
            "core/whole_body_qp",
            "settings",
            "views",
            "assembly",
            "control",
            "wire",
            "transports",
            "recording",
            "service",
            "mock",
        ),
        ("numpy", "pinocchio", "rich", "plotly"),
    ),
    "replay": (
        ("core/robot", "core/references", "core/tasks", "settings", "control", "views", "recording", "demo"),
        ("numpy", "click"),
    ),
    "campaign": (
        (
            "core/robot",
            "safety",
            "settings",
            "assembly",
            "control",
            "wire",
            "transports",
            "service",
            "mock",
            "recording",
            "replay",
        ),
        ("numpy", "scipy", "pinocchio", "pydantic", "rich", "plotly", "joblib", "distributed", "ray"),
    ),
    "identification": (
        ("core/robot", "core/contacts", "settings", "assembly", "views", "recording"),
        ("numpy", "scipy", "pinocchio", "yaml"),
    ),
    "accuracy": (
        (
            "estimation",
            "settings",
            "assembly",
            "control",
            "service",
            "mock",
            "transports",
            "campaign",
        ),
        ("numpy", "scipy", "pinocchio", "click", "joblib"),
    ),
    "node": (("ros2",), ()),
    "live": (("settings",), ()),
    "bench": (
        ("core/robot", "settings", "assembly", "wire", "transports", "service", "mock", "ros2", "live"),
        ("numpy", "click"),
    ),
    "fuzz": (
        (
            "core/robot",
            "core/references",
            "core/program",
            "core/whole_body_qp",
            "safety",
            "estimation",
            "settings",
            "assembly",
            "control",
            "wire",
            "transports",
            "service",
            "mock",
            "live",
            "recording",
        ),
        ("numpy", "scipy", "pinocchio", "rosbags", "click"),
    ),
    "user": (
        ("settings", "assembly", "wire", "transports", "diagnostics", "service"),
        ("numpy", "click", "rich"),
    ),
    "viewer": (
        (
            "core/robot",
            "core/contacts",
            "core/tasks",
            "settings",
            "views",
            "assembly",
            "wire",
            "diagnostics",
            "recording",
            "service",
            "live",
            "user",
        ),
        ("numpy", "pinocchio", "coal", "click", "viser", "websockets", "msgspec", "trimesh", "fast_simplification"),
    ),
    "cli": (
        (
            "settings",
            "assembly",
            "wire",
            "transports",
            "service",
            "mock",
            "ros2",
            "demo",
            "replay",
            "campaign",
            "bench",
            "fuzz",
            "user",
            "viewer",
            "identification",
            "accuracy",
        ),
        ("click",),
    ),
    "__main__": (("cli",), ()),
}
#: What the front door hands on: `__init__` may name any of these rooms, and defines nothing of its own.
FRONT_DOOR = (*CORE, "settings", "assembly", "control", "bridges", "mock")
#: Modules of the outside that few files may import, relative to the package.
RESERVED = {
    "mujoco": ("mock/*",),
    "cyclonedds": ("transports/dds*.py",),
    "rclpy": ("transports/ros2*.py", "ros2/*"),
    "plotly": ("views/plots.py", "demo/*", "campaign/plots.py"),
    "viser": ("viewer/*",),
}
#: Files that lie at the top of the package: entry points, records, errors and the front door.
TOP = {"__init__.py", "__main__.py", "cli.py", "node.py", "errors.py", "records.py"}
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


def room_of(parts: tuple[str, ...]) -> str:
    """The room of a module, given by its path within the package: ``("core", "robot", "model")`` is in core/robot."""
    return "/".join(parts[:2]) if parts[0] == "core" and len(parts) > 1 else parts[0]


def own_rooms(module: str, sources: Path) -> set[str]:
    """The rooms of this package that the import of a name leads to; none where it is not of this package."""
    top, *parts = module.split(".")
    if top != PACKAGE or not parts:
        return set()
    if parts == ["core"]:
        return {"core"}  # of which nothing may be imported whole
    return {room_of(tuple(parts))}


def violations(found: dict[str, set[str]]) -> list[str]:
    """A sentence for every import that runs back up, crosses a wall, or brings in what others keep."""
    wrong = []
    order = list(ROOMS)
    for file, modules in found.items():
        parts = Path(file).with_suffix("").parts
        if parts in (("__init__",), ("core", "__init__")):
            allowed, outside = (*GROUND, *FRONT_DOOR) if parts == ("__init__",) else (), ()
            room = "__init__"
        else:
            room = room_of(parts)
            if room not in ROOMS:
                wrong.append(f"{file} imports nothing yet: it is in no room of the table")
                continue
            allowed, outside = ROOMS[room]
            allowed = (*allowed, *(GROUND if room != "records" else ()), room)
        for module in sorted(modules):
            top = module.split(".")[0]
            if top in RESERVED and not any(fnmatch(file, pattern) for pattern in RESERVED[top]):
                wrong.append(f"{file} imports {module}: only {', '.join(RESERVED[top])} may")
            if file.startswith("core/") and top in CLOCKS:
                wrong.append(f"{file} imports {module}: core knows no clock, no thread and no log")
            if top == PACKAGE:
                for other in own_rooms(module, SOURCES):
                    if other in allowed or (other == "core" and module == f"{PACKAGE}.core"):
                        continue
                    why = (
                        "runs back up"
                        if other in order and room in order and order.index(other) > order.index(room)
                        else (f"of this package {room} may import {', '.join(allowed)}")
                    )
                    wrong.append(f"{file} imports {module}: {why}")
            elif top not in sys.stdlib_module_names and top not in outside:
                wrong.append(
                    f"{file} imports {module}: of the outside {room} may import {', '.join(outside) or 'nothing'}"
                )
    return wrong


def test_imports_go_one_way():
    assert violations(walk(SOURCES)) == []


def test_the_table_itself_goes_one_way():
    order = list(ROOMS)
    for room, (allowed, _) in ROOMS.items():
        for other in allowed:
            assert order.index(other) < order.index(room), f"{room} -> {other}"


def test_the_table_allows_nothing_that_nobody_imports():
    """A wall that has a door for nobody is a wall that will be crossed unseen."""
    used: dict[str, set[str]] = {room: set() for room in ROOMS}
    for file, modules in walk(SOURCES).items():
        parts = Path(file).with_suffix("").parts
        if room_of(parts) in ROOMS:
            for module in modules:
                used[room_of(parts)] |= own_rooms(module, SOURCES) or {module.split(".")[0]}
    idle = {
        room: sorted({*allowed, *outside} - used[room])
        for room, (allowed, outside) in ROOMS.items()
        if {*allowed, *outside} - used[room]
    }
    assert idle == {}


def test_nothing_lies_loose_at_the_top():
    assert {path.name for path in SOURCES.glob("*.py")} == TOP


def test_the_walk_sees_the_whole_package():
    found = walk(SOURCES)
    assert len(found) > 150
    assert "mujoco" in found["mock/plant.py"]
    assert "cyclonedds.domain" in found["transports/dds.py"]
    assert any(module.startswith("rclpy") for module in found["transports/ros2.py"])
    assert "wbc_controller.core.robot.model.RobotModel" in found["safety/supervisor.py"]
    assert {room_of(Path(file).with_suffix("").parts) for file in found} - {"__init__", "core/__init__"} == set(ROOMS)


def test_the_map_names_every_room_and_every_file_of_it():
    """docs/map.md has a row for each room; it names files that exist, and leaves none out."""
    rows = dict(re.findall(r"^\| `([\w/]+)/` \|(.*)\|$", MAP, flags=re.MULTILINE))
    folders = {room for room in ROOMS if (SOURCES / room).is_dir()}
    assert set(rows) == folders
    for room, text in rows.items():
        named = set(re.findall(r"`([\w/.]+\.py)`", text))
        files = [path for path in (SOURCES / room).rglob("*.py") if path.name != "__init__.py"]
        there = {path.relative_to(SOURCES / room).as_posix() for path in files}
        assert named == there, room
    for name in re.findall(r"\]\(\.\./([\w/.]+)\)", MAP):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("core/robot/planted.py", "import time"),
        ("core/robot/planted.py", "from time import monotonic"),
        ("core/tasks/planted.py", "def f():\n    import datetime"),
        ("core/program/planted.py", "import logging"),
        ("core/robot/planted.py", "import yaml"),
        ("core/robot/planted.py", "import pydantic"),
        ("core/robot/planted.py", "from rosbags.typesys import Stores"),
        ("core/program/planted.py", "import osqp"),
        ("core/robot/planted.py", "from wbc_controller import settings"),
        ("core/robot/planted.py", "from wbc_controller.settings import Settings"),
        ("core/robot/planted.py", "from ... import service"),
        ("core/robot/planted.py", "from ...safety.supervisor import Supervisor"),
        ("core/tasks/planted.py", "from ... import service"),
        ("core/tasks/planted.py", "import importlib\nimportlib.import_module('mujoco')"),
        ("core/tasks/planted.py", "from wbc_controller.core.program.layout import Layout"),
        ("core/robot/planted.py", "from wbc_controller.core.tasks import Task"),
        ("core/program/planted.py", "from wbc_controller.core.solvers import Solver"),
        ("core/robot/planted.py", "import wbc_controller.transports.memory"),
        ("core/robot/planted.py", "if True:\n    from wbc_controller import service"),
        ("core/robot/planted.py", "from wbc_controller.assembly.robot import make_model"),
        ("assembly/planted.py", "import mujoco"),
        ("assembly/planted.py", "from wbc_controller.control.controller import Controller"),
        ("control/planted.py", "from wbc_controller.service.loop import ControlLoop"),
        ("control/planted.py", "from wbc_controller.wire.messages import encode"),
        ("views/planted.py", "from wbc_controller.control.result import CycleResult"),
        ("views/planted.py", "import plotly"),
        ("wire/planted.py", "from wbc_controller.transports.transport import Transport"),
        ("demo/planted.py", "import mujoco as mj"),
        ("service/planted.py", "from wbc_controller.mock.plant import Plant"),
        ("transports/memory.py", "import cyclonedds"),
        ("transports/ros2.py", "import cyclonedds.domain"),
        ("transports/dds.py", "import rclpy"),
        ("node.py", "import rclpy"),
        ("service/planted.py", "from rclpy.node import Node"),
        ("records.py", "import pinocchio"),
        ("records.py", "from wbc_controller.errors import WbcError"),
        ("mechanics/planted.py", "from wbc_controller.core.robot.dynamics import Dynamics"),
        ("mechanics/planted.py", "import qpsolvers"),
        ("safety/planted.py", "from wbc_controller.core.whole_body_qp import WholeBodyQP"),
        ("safety/planted.py", "from wbc_controller.service.outputs import Outputs"),
        ("safety/planted.py", "import yaml"),
        ("bridges/planted.py", "import mujoco"),
        ("__init__.py", "from wbc_controller.service.loop import ControlLoop"),
        ("planted.py", "import math"),
        ("core/planted.py", "import math"),
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
            "core/robot/planted.py",
            "from wbc_controller.core.arrays import as_slice\nfrom wbc_controller.records import Array",
        ),
        ("core/robot/planted.py", "from . import model\nimport math"),
        ("core/solvers/planted.py", "import daqp"),
        ("safety/planted.py", "from wbc_controller.core.robot.model import RobotModel"),
        ("records.py", "import numpy.typing as npt\nfrom dataclasses import dataclass"),
        ("demo/planted.py", "from wbc_controller.mock.plant import Plant\nimport time"),
        ("__init__.py", "from wbc_controller.control.controller import Controller"),
    ],
)
def test_what_is_allowed_is_not_called_a_violation(tmp_path, file, line):
    planted = tmp_path / file
    planted.parent.mkdir(parents=True, exist_ok=True)
    planted.write_text(f"{line}\n", encoding="utf-8")
    assert violations(walk(tmp_path)) == []
