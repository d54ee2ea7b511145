"""Table of permitted imports of the package's folders, checked by `test/test_layering.py`."""

from typing import NamedTuple


class Room(NamedTuple):
    """Permitted imports of a room, besides the standard library, `BASICS` and the room itself.

    Attributes:
        rooms: other rooms of the package, all above it in the table.
        libraries: third-party packages.
    """

    rooms: str = ""
    libraries: str = ""


#: Files at the top of the package that all rooms may import.
BASICS = ("errors", "extras", "records", "arguments", "compilation", "pinocchio_libraries")
#: Other files at the top of the package: entry points and public names.
ENTRY_POINTS = ("cli", "node", "__main__", "__init__")

_QP = "inverse_dynamics/"
#: A room is a folder of the package, or a folder or file of `inverse_dynamics`. Imports go upwards in the table.
ROOMS = {
    "errors": Room(),
    "extras": Room("errors"),
    "records": Room("", "numpy"),
    "arguments": Room("errors records", "numpy"),
    "compilation": Room("", "numpy numba typing_extensions"),
    "pinocchio_libraries": Room(),
    "settings": Room("", "pydantic yaml"),
    "mechanics": Room("", "numpy scipy pinocchio"),
    _QP + "arrays": Room("", "numpy scipy"),
    _QP + "tunable": Room(),
    _QP + "method_calls": Room(_QP + "arrays", "numpy"),
    _QP + "robot": Room(f"settings {_QP}arrays", "numpy scipy pinocchio"),
    _QP + "contacts": Room(f"{_QP}tunable {_QP}method_calls {_QP}robot", "numpy scipy pinocchio"),
    _QP + "limits": Room(f"{_QP}tunable {_QP}robot", "numpy pinocchio coal"),
    _QP + "tasks": Room(f"{_QP}arrays {_QP}tunable {_QP}method_calls {_QP}robot {_QP}contacts", "numpy pinocchio"),
    _QP + "references": Room(f"{_QP}robot {_QP}contacts {_QP}tasks", "numpy pinocchio"),
    _QP + "formulation": Room(
        f"{_QP}arrays {_QP}method_calls {_QP}robot {_QP}contacts {_QP}limits {_QP}tasks", "numpy scipy"
    ),
    _QP + "solvers": Room(_QP + "formulation", "numpy scipy qpsolvers daqp osqp proxsuite"),
    _QP + "whole_body_qp": Room(f"{_QP}formulation {_QP}solvers"),
    "estimation": Room(f"settings {_QP}arrays {_QP}robot {_QP}contacts", "numpy scipy pinocchio"),
    # The supervisor is independent of the quadratic program.
    "safety": Room(f"settings estimation {_QP}arrays {_QP}robot {_QP}limits {_QP}references", "numpy scipy pinocchio"),
    "walking": Room(f"{_QP}robot {_QP}references", "numpy pinocchio"),
    "controller": Room(
        "settings inverse_dynamics estimation safety walking", "numpy scipy pinocchio coal pydantic plotly rich"
    ),
    "middleware": Room(f"settings {_QP}tasks {_QP}references", "numpy yaml rosbags cyclonedds rclpy"),
    "recording": Room(
        "settings inverse_dynamics walking controller middleware",
        "numpy scipy pinocchio yaml click mcap zstandard",
    ),
    "simulation": Room(
        "settings inverse_dynamics safety controller middleware", "numpy scipy pinocchio coal mujoco pydantic"
    ),
    "nodes": Room(
        "settings inverse_dynamics estimation safety walking controller middleware recording simulation",
        "numpy pinocchio pydantic rclpy rcl_interfaces std_srvs",
    ),
    "apps": Room(
        "settings inverse_dynamics controller middleware recording simulation nodes",
        "numpy scipy pinocchio coal yaml click rich viser websockets msgspec trimesh fast_simplification",
    ),
    "validation": Room(
        "settings inverse_dynamics walking estimation safety controller middleware recording simulation nodes apps",
        "numpy scipy pinocchio click rich pydantic rosbags hypothesis joblib distributed ray",
    ),
    "node": Room("nodes"),
    # Imports the modules of commands on use.
    "cli": Room("", "click"),
    "__main__": Room("cli"),
    "__init__": Room("settings inverse_dynamics controller simulation"),
}
#: Libraries reserved to some files of a room, by path pattern.
RESERVED = {
    "mujoco": ("simulation/*",),
    "cyclonedds": ("middleware/transports/dds*.py",),
    "rclpy": ("middleware/transports/ros2*.py", "nodes/ros2/*"),
    "plotly": ("controller/visualization/plots.py",),
    "viser": ("apps/page/*",),
}
#: Modules that make cycles irreproducible; forbidden in `inverse_dynamics`.
CLOCKS = ("time", "datetime", "random", "threading", "asyncio", "socket", "subprocess", "logging")
