"""Commands `wbc view`, `play` and `demo`."""

import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import click

from wbc_controller.apps.terminal.command_options import complete_config, load_named, namespace_option, remap_option
from wbc_controller.extras import require_libraries
from wbc_controller.nodes.signals import set_by_signals
from wbc_controller.settings.service import SensorQuality

_LIBRARIES = ("viser", "msgspec", "websockets", "trimesh", "fast_simplification")  # libraries of the page
_PORT = click.option("--port", default=8080, show_default=True, type=click.IntRange(0, 65535),
                     help="Port of the page; the next free port if it is in use.")  # fmt: skip
_HOST = click.option("--host", default="127.0.0.1", show_default=True,
                     help="Address of the server; other addresses than the loopback require a token.")  # fmt: skip


@click.command()
@click.argument("config", default="g1", shell_complete=complete_config)
@click.option(
    "--command", "commands", is_flag=True, help="Permit requests from the page; by default the page is read-only."
)
@_HOST
@_PORT
@namespace_option
@remap_option
def view(config: str, commands: bool, host: str, port: int, namespace: str, remappings: Mapping[str, str]) -> None:
    """Show a running robot, over its topics, or a recording, FILE.mcap, in the browser: docs/page.md."""
    require_libraries(*_LIBRARIES)
    from wbc_controller.apps.page.page_service import serve, serve_recording

    stop = threading.Event()
    with set_by_signals(stop):
        if config.endswith(".mcap"):
            serve_recording(Path(config), stop, host=host, port=port)
            return
        settings = load_named(config)
        serve(settings, stop, host=host, port=port, namespace=namespace, remappings=remappings, commands=commands)


@click.command()
@click.argument("robot", default="g1", shell_complete=complete_config)
@_HOST
@_PORT
@click.option("--domain", type=click.IntRange(0, 232), help="DDS domain; by default an unused one.")
@click.option("--real-time-factor", "factor", default=1.0, show_default=True, type=click.FloatRange(0.0, min_open=True),
              help="Simulated seconds per second; smaller values for slow motion or a slow computer.")  # fmt: skip
def play(robot: str, host: str, port: int, domain: int | None, factor: float) -> None:
    """Run a mock robot and its controller, and a page in the browser that commands them.

    ROBOT is a CONFIG as in other commands. Ctrl-C ends all processes.
    """
    require_libraries("mujoco", *_LIBRARIES)
    from wbc_controller.apps.page.page_service import play as run

    stop = threading.Event()
    with set_by_signals(stop):
        run(robot, stop, host=host, port=port, domain=domain, factor=factor)


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
