"""The warning of two Pinocchio installations, as in a shell with a sourced ROS 2."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import pinocchio
import pytest

from wbc_controller import pinocchio_libraries
from wbc_controller.pinocchio_libraries import two_installations, warn_of_two_installations

#: Error of apt's Pinocchio, compiled against NumPy 1, with the NumPy 2 of the wheel.
INCOMPATIBLE = "numpy.core.multiarray failed to import"


@pytest.fixture
def ros(tmp_path):
    """Files of apt's Pinocchio, of which no variable of the shell knows."""
    module = tmp_path / "opt/ros/jazzy/lib/python3.12/site-packages/pinocchio/__init__.py"
    module.parent.mkdir(parents=True)
    module.write_text(f"raise ImportError({INCOMPATIBLE!r})")
    (tmp_path / "opt/ros/jazzy/lib/libpinocchio_default.so").touch()
    return tmp_path / "opt/ros/jazzy"


def test_second_modules_and_libraries_are_named(monkeypatch, ros):
    monkeypatch.delenv("LD_LIBRARY_PATH", raising=False)
    assert two_installations() == ""
    (own,) = pinocchio_libraries._prefixes([Path(pinocchio.__file__)])
    modules = str(ros / "lib/python3.12/site-packages")
    monkeypatch.setattr(sys, "path", [*sys.path, modules])
    assert f"two Pinocchio installations: in {own} and {ros}; the first is used" in two_installations()
    monkeypatch.setattr(sys, "path", [modules, *sys.path])  # as PYTHONPATH does
    assert f"two Pinocchio installations: in {ros} and {own}; the first is used" in two_installations()
    monkeypatch.undo()
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{ros / 'nothing'}:{ros / 'lib'}")
    assert f" and {ros}; the first is used" in two_installations()
    assert "ros-<distribution>-pinocchio" in two_installations()


@pytest.mark.parametrize("library", ["libpinocchio_default.so.4.1.0", "libcoal.so", "libeigenpy.so"])
def test_libraries_that_are_loaded_from_two_places_are_named(library, tmp_path, monkeypatch, caplog):
    wheel = "/venv/lib/python3.12/site-packages/cmeel.prefix/lib"
    maps = tmp_path / "maps"
    monkeypatch.setattr(pinocchio_libraries, "_MAPPED", maps)
    ends = (f"{wheel}/python3.12/site-packages/pinocchio/pinocchio_pywrap_default.cpython-312-x86_64-linux-gnu.so",
            f"{wheel}/libcoal.so", "", "[heap]")  # fmt: skip
    lines = [f"7f45a0000000-7f45a0001000 r-xp 00000000 fe:00 1234      {end}" for end in ends]
    maps.write_text("\n".join(lines))
    assert two_installations() == ""
    second = f"7f45a0000000-7f45a0001000 r-xp 00000000 fe:00 9  /opt/ros/jazzy/lib/{library}"
    maps.write_text("\n".join([*lines, second]))
    warn_of_two_installations.cache_clear()
    caplog.set_level(logging.WARNING, "wbc_controller")
    for _ in range(2):
        warn_of_two_installations()
    warn_of_two_installations.cache_clear()
    (warning,) = caplog.messages
    assert "libraries of two Pinocchio installations are loaded: from " in warning
    assert "cmeel.prefix and /opt/ros/jazzy. " in warning


@pytest.mark.parametrize(
    "command", [["-m", "wbc_controller", "check", "go2"], ["-c", "from wbc_controller.node import main; main()"]]
)
def test_a_failed_import_is_reported_with_both_places(command, ros):
    paths = [str(ros / "lib/python3.12/site-packages"), *filter(None, sys.path)]
    ended = subprocess.run(
        [sys.executable, *command], env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith(f"error: {INCOMPATIBLE}\nthere are two Pinocchio installations: in {ros} and ")
