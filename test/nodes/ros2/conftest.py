"""Fixtures of tests on a real graph: an installation of this checkout, and a node that commands and listens."""

import contextlib
import os
import shutil
import sys

import pytest
from domains import own_domain
from pages import PROJECT, ROOT
from participants import Ros2Participants
from ros2_user import Ros2User


@pytest.fixture
def environment(tmp_path):
    """An installation of this checkout as by colcon, with its own domain."""
    binaries, index = tmp_path / "lib/wbc_controller", tmp_path / "share/ament_index/resource_index/packages"
    share = tmp_path / "share/wbc_controller"
    for folder in (binaries, index, share):
        folder.mkdir(parents=True)
    (index / "wbc_controller").touch()
    for name in ("config", "launch", "layouts"):
        shutil.copytree(ROOT / name, share / name)
    for name, place in PROJECT["scripts"].items():
        module, main = place.split(":")
        (binaries / name).write_text(f"#!{sys.executable}\nfrom {module} import {main}\n{main}()\n")
        (binaries / name).chmod(0o755)
    return os.environ | {
        "AMENT_PREFIX_PATH": f"{tmp_path}:{os.environ.get('AMENT_PREFIX_PATH', '')}",
        "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}",
        "ROS_DOMAIN_ID": str(own_domain()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }


@pytest.fixture
def participants(monkeypatch):
    """Opens a context for nodes on a domain."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.ExitStack() as opened:
        yield lambda domain: opened.enter_context(contextlib.closing(Ros2Participants(domain)))


@pytest.fixture
def user(environment, participants):
    return Ros2User(participants(int(environment["ROS_DOMAIN_ID"])).node("user"))
