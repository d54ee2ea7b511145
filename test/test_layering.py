"""Imports follow the table in docs/layers.py."""

import ast
import sys
from fnmatch import fnmatch
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from layers import BASICS, CLOCKS, ENTRY_POINTS, RESERVED, ROOMS

PACKAGE = "wbc_controller"
SOURCES = Path(__file__).resolve().parent.parent / PACKAGE
ORDER = list(ROOMS)


def imports_of(path: Path, module: str) -> set[str]:
    """Return the imported modules of a file; `from a import b` counts as a and a.b."""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
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


@cache
def walk(sources: Path) -> dict[str, set[str]]:
    """Return the imports of all files below a folder, by relative path."""
    found = {}
    for path in sorted(sources.rglob("*.py")):
        relative = path.relative_to(sources)
        module = ".".join([PACKAGE, *relative.with_suffix("").parts]).removesuffix(".__init__")
        found[relative.as_posix()] = imports_of(path, module)
    return found


def room_of(parts: tuple[str, ...]) -> str:
    """Return the room of a module: ``("inverse_dynamics", "robot", "model")`` is in inverse_dynamics/robot."""
    return "/".join(parts[:2]) if parts[0] == "inverse_dynamics" and len(parts) > 1 else parts[0]


def parts_of(file: str) -> tuple[str, ...]:
    parts = Path(file).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts


def is_allowed(other: str, room: str) -> bool:
    allowed = (*ROOMS[room].rooms.split(), *(BASICS if room not in BASICS else ()), room)
    return any(other == name or other.startswith(f"{name}/") for name in allowed)


def violations(found: dict[str, set[str]]) -> list[str]:
    """Return a sentence for each forbidden import."""
    wrong = []
    for file, modules in found.items():
        if file == "inverse_dynamics/__init__.py" and modules <= {"__future__"}:
            continue
        room = room_of(parts_of(file))
        if room not in ROOMS:
            wrong.append(f"{file} imports nothing yet: its room is missing in docs/layers.py")
            continue
        for module in sorted(modules):
            top, *parts = module.split(".")
            if top in RESERVED and not any(fnmatch(file, pattern) for pattern in RESERVED[top]):
                wrong.append(f"{file} imports {module}: only {', '.join(RESERVED[top])} may")
            if file.startswith("inverse_dynamics/") and top in CLOCKS:
                wrong.append(f"{file} imports {module}: inverse_dynamics uses no clocks, threads or logs")
            if top == PACKAGE:
                if parts and parts != ["inverse_dynamics"] and not is_allowed(room_of(tuple(parts)), room):
                    wrong.append(f"{file} imports {module}: {room} may import {ROOMS[room].rooms or 'no other room'}")
            elif top not in sys.stdlib_module_names and top not in ROOMS[room].libraries.split():
                wrong.append(f"{file} imports {module}: {room} may import {ROOMS[room].libraries or 'no library'}")
    return wrong


def test_imports_follow_the_ordered_table():
    assert violations(walk(SOURCES)) == []
    for room, (rooms, _) in ROOMS.items():
        for other in rooms.split():
            above = [name for name in ORDER[: ORDER.index(room)] if name == other or name.startswith(f"{other}/")]
            assert above, f"{room} -> {other}"


def test_folders_of_one_room_import_each_other_one_way():
    """A module at the top of a room counts as a folder."""
    arrows: dict[str, set[str]] = {}
    for file, modules in walk(SOURCES).items():
        own = parts_of(file)[:2]
        for module in modules:
            top, *parts = module.split(".")[:3]
            if top == PACKAGE and len(parts) > 1 and parts[0] == own[0] and (SOURCES / parts[0]).is_dir():
                arrows.setdefault("/".join(own), set()).add("/".join(parts))
    sorter = TopologicalSorter({folder: others - {folder} for folder, others in arrows.items()})
    assert len(list(sorter.static_order())) > 50  # imports in a circle raise a CycleError, which names them


def test_table_has_no_unused_entries():
    used: dict[str, set[str]] = {room: set() for room in ROOMS}
    for file, modules in walk(SOURCES).items():
        room = room_of(parts_of(file))
        for module in modules if room in ROOMS else ():
            top, *parts = module.split(".")
            used[room] |= {room_of(tuple(parts)), parts[0]} if top == PACKAGE and parts else {top}
    for room, (rooms, libraries) in ROOMS.items():
        assert {*rooms.split(), *libraries.split()} <= used[room], room


def test_the_package_is_small_and_walked_completely():
    """A file name occurs at most twice."""
    assert {path.stem for path in SOURCES.glob("*.py")} <= {*BASICS, *ENTRY_POINTS}
    folders = [path for path in SOURCES.iterdir() if path.is_dir() and path.name != "__pycache__"]
    assert len(folders) <= 13
    names = [path.name for path in SOURCES.rglob("*.py") if path.name != "__init__.py"]
    assert {name for name in names if names.count(name) > 2} == set()
    found = walk(SOURCES)
    assert len(found) > 150
    assert "mujoco" in found["simulation/plant.py"]
    assert "cyclonedds.domain" in found["middleware/transports/dds.py"]
    assert any(module.startswith("rclpy") for module in found["middleware/transports/ros2.py"])
    assert "wbc_controller.inverse_dynamics.robot.model.RobotModel" in found["safety/supervisor.py"]
    assert {room_of(parts_of(file)) for file in found} - {"inverse_dynamics"} == set(ROOMS)


ROBOT, TASKS = "inverse_dynamics/robot/planted.py", "inverse_dynamics/tasks/planted.py"


@pytest.mark.parametrize(
    ("file", "line"),
    [
        (ROBOT, "from time import monotonic"),
        (TASKS, "def f():\n    import datetime"),
        (TASKS, "from wbc_controller import settings"),
        (ROBOT, "from ... import nodes"),
        (ROBOT, "from ...safety.supervisor import Supervisor"),
        (TASKS, "import importlib\nimportlib.import_module('mujoco')"),
        (TASKS, "from wbc_controller.inverse_dynamics.formulation.layout import Layout"),
        ("apps/demo/planted.py", "import mujoco as mj"),
        ("middleware/transports/memory.py", "import cyclonedds"),
        ("records.py", "import pinocchio"),
        ("records.py", "from wbc_controller.errors import WbcError"),
        ("__init__.py", "from wbc_controller.nodes.loop import ControlLoop"),
        ("planted.py", "import math"),
        ("inverse_dynamics/planted.py", "import math"),
    ],
)
def test_a_violation_is_found(tmp_path, file, line):
    planted = tmp_path / file
    planted.parent.mkdir(parents=True, exist_ok=True)
    planted.write_text(f'"""Planted."""\n\n{line}\n', encoding="utf-8")
    found = violations(walk(tmp_path))
    assert found
    assert all(sentence.startswith(f"{file} imports ") for sentence in found)
