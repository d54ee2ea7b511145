"""The command `wbc demo`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import get_args

import click

from wbc_controller.apps.terminal.shell_completion import complete_config
from wbc_controller.extras import require_libraries
from wbc_controller.settings.service import SensorQuality


@click.command()
@click.argument("robot", default="g1", shell_complete=complete_config)
@click.option("--report", "folder", type=click.Path(path_type=Path), default=Path("report"), show_default=True,
              help="Folder of the recording and the report.")  # fmt: skip
@click.option("--lockstep", is_flag=True, help="Run in one process without real time: reproducible.")
@click.option("--real-time-factor", default=1.0, show_default=True, help="Simulated seconds per second.")
@click.option("--sensors", type=click.Choice(get_args(SensorQuality)),
              help="Estimate the base from sensors of this quality instead of odometry.")  # fmt: skip
def demo(robot: str, folder: Path, lockstep: bool, real_time_factor: float, sensors: str | None) -> None:
    """Run the demo of a robot on the mock robot.

    ROBOT is a CONFIG as in other commands, or `walk`: G1 walks forward, turns, steps to the left, walks a curve and
    stops.
    """
    require_libraries("mujoco", "plotly")
    from wbc_controller.apps.demo.run import run_demo

    done = run_demo(robot, folder, lockstep=lockstep, real_time_factor=real_time_factor, sensors=sensors)
    sys.exit(0 if done else 1)
