"""Launch files, started as a user does."""

import subprocess
from pathlib import Path

#: Wall time after which something that should have happened has not, s; at load 8 a process takes 20 s to start.
PATIENCE = 120.0
ROOT = Path(__file__).resolve().parents[2]


def launch(environment, *arguments, file="wbc.launch.py"):
    return subprocess.Popen(
        ["ros2", "launch", "wbc_controller", file, *arguments],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
