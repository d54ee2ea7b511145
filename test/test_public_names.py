"""Public names of the package. `test_interface.py` finds the removal of a name."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest
from interface import MODULES

import wbc_controller as wbc
from wbc_controller import errors


def test_the_front_door_exports_documented_names_of_the_same_places():
    assert set(wbc.__all__) == set(wbc._PUBLIC)
    assert list(wbc.__all__) == sorted(wbc.__all__)
    for name in wbc.__all__:
        assert getattr(wbc, name).__name__ == name
        assert getattr(wbc, name).__doc__
    assert set(wbc.__all__) <= set(dir(wbc))
    with pytest.raises(AttributeError, match="has no attribute 'make_model'"):
        wbc.make_model  # noqa: B018  # the attribute is what is tested
    tree = ast.parse(Path(wbc.__file__).read_text(encoding="utf-8"))
    (checking,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {alias.name: node.module for node in checking.body for alias in node.names}
    assert seen == {name: f"wbc_controller.{module}" for name, module in wbc._PUBLIC.items()}


def test_public_names_are_imported_lazily():
    code = "import sys, wbc_controller; print({'numpy', 'pinocchio', 'mujoco'} & {*sys.modules})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


@pytest.mark.parametrize("module", MODULES)
def test_a_package_exports_its_own_names(module):
    package = importlib.import_module(f"wbc_controller.{module}")
    assert list(package.__all__) == sorted(package.__all__)
    for name in package.__all__:
        assert getattr(package, name).__module__.startswith(package.__name__)


def test_the_errors_are_one_tree():
    own = {name: kind for name, kind in vars(errors).items() if getattr(kind, "__module__", "") == errors.__name__}
    own = {name: kind for name, kind in own.items() if isinstance(kind, type)}
    assert set(own) == {
        "WbcError", "ConfigurationError", "MethodError", "InputRefused", "NoSolution", "TransportError",
    }  # fmt: skip
    assert all(issubclass(kind, errors.WbcError) for kind in own.values())
    assert all(name in errors.__doc__ for name in own)
