"""Launch files and nodes, started as a user does."""

import subprocess
from pathlib import Path

from wbc_controller.settings.config import load

#: Wall time after which something that should have happened has not, s, on a computer without other work.
PATIENCE = 60.0
ROOT = Path(__file__).resolve().parents[2]
#: What stops a robot where it is late, for a machine that is busy.
_PATIENT = {"safety.state_timeout": 1.0, "mock.command_timeout": 10.0, "guard.patience": 1.0}


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
