"""Commands with a page: `wbc view`, `wbc play`."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path

import click

from wbc_controller.apps.terminal.command_options import load_named, namespace_option, remap_option
from wbc_controller.apps.terminal.shell_completion import complete_config
from wbc_controller.extras import require_libraries
from wbc_controller.nodes.signals import set_by_signals

#: Libraries of the page.
_LIBRARIES = ("viser", "msgspec", "websockets", "trimesh", "fast_simplification")
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
    if config.endswith(".mcap"):
        with set_by_signals(stop):
            serve_recording(Path(config), stop, host=host, port=port)
        return
    settings = load_named(config)
    with set_by_signals(stop):
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
    from wbc_controller.apps.page.play import play as run

    stop = threading.Event()
    with set_by_signals(stop):
        run(robot, stop, host=host, port=port, domain=domain, factor=factor)
