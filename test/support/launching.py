"""Launch files and nodes, started as a user does."""

import os
import subprocess
from pathlib import Path

from wbc_controller.settings.config import load

#: Wall time after which something that should have happened has not, s, on a computer without other work.
PATIENCE = 60.0
ROOT = Path(__file__).resolve().parents[2]
#: What stops a robot where it is late, for a machine that is busy.
_PATIENT = {"safety.state_timeout": 1.0, "mock.command_timeout": 10.0}


def patient(robot, folder):
    """The path of a robot's configuration that is not stopped where the machine is late."""
    path = folder / f"{Path(robot).stem}_patient.yaml"
    path.write_text(load(str(robot)).replace(_PATIENT).to_yaml(), encoding="utf-8")
    return path


def launch(environment, *arguments, file="wbc.launch.py"):
    return subprocess.Popen(
        ["ros2", "launch", "wbc_controller", file, *arguments],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def start_node(environment, executable, *parameters, **options):
    """Start an executable of the installation, without ros2 run or launch, which the wheels of PyPI do not have."""
    prefix = environment["AMENT_PREFIX_PATH"].split(os.pathsep)[0]
    given = [word for parameter in parameters for word in ("-p", parameter)]
    command = [f"{prefix}/lib/wbc_controller/{executable}", "--ros-args", *given]
    return subprocess.Popen(command, env=environment, **options)
