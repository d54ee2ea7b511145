"""The commands with a page: `wbc view` for a robot that is running, and `wbc play` with a mock robot."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from wbc_controller.apps.terminal.completion import complete_config
from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.topics import parse_remapping
from wbc_controller.nodes.signals import set_by_signals
from wbc_controller.settings.files import find_configuration, load_settings

_PORT = click.option("--port", default=8080, show_default=True, type=click.IntRange(0, 65535),
                     help="Port of the page; where it is taken, the next one that is free.")  # fmt: skip
_HOST = click.option("--host", default="127.0.0.1", show_default=True,
                     help="Address to listen on; beyond the loopback, the address has a token.")  # fmt: skip


@click.command()
@click.argument("config", default="g1", shell_complete=complete_config)
@click.option("--command", "commands", is_flag=True, help="Let the page command the robot; by default it watches.")
@_HOST
@_PORT
@click.option("--namespace", default="/", show_default=True, help="Namespace of the nodes' topics.")
@click.option("--remap", "remaps", multiple=True, metavar="FROM:=TO", help="A renamed topic; may be repeated.")
def view(config: str, commands: bool, host: str, port: int, namespace: str, remaps: tuple[str, ...]) -> None:
    """Show a running robot in the browser, over its topics alone, or a recording, FILE.mcap: docs/page.md."""
    needs_viser()
    from wbc_controller.apps.page.serving import serve, serve_recording

    stop = threading.Event()
    if config.endswith(".mcap"):
        with set_by_signals(stop):
            serve_recording(Path(config), stop, host=host, port=port)
        return
    settings = load_settings(find_configuration(config))
    with set_by_signals(stop):
        serve(
            settings,
            stop,
            host=host,
            port=port,
            namespace=namespace,
            remappings=dict(parse_remapping(text) for text in remaps),
            commands=commands,
        )


@click.command()
@click.argument("robot", default="g1", shell_complete=complete_config)
@_HOST
@_PORT
@click.option("--domain", type=click.IntRange(0, 232), help="DDS domain; by default one that nobody uses here.")
@click.option("--real-time-factor", "factor", default=1.0, show_default=True, type=click.FloatRange(0.0, min_open=True),
              help="Simulated seconds per second: slow motion, or a computer that is slow.")  # fmt: skip
def play(robot: str, host: str, port: int, domain: int | None, factor: float) -> None:
    """Play with a robot in the browser: a mock robot, its controller, and a page that commands them.

    ROBOT is as CONFIG elsewhere. Ctrl-C ends all of it.
    """
    needs_viser()
    from wbc_controller.apps.page.playing import play as run

    stop = threading.Event()
    with set_by_signals(stop):
        run(robot, stop, host=host, port=port, domain=domain, factor=factor)


def needs_viser() -> None:
    """Say what to install where the page's server is not there.

    Raises:
        ConfigurationError: where it is not.
    """
    try:
        import fast_simplification  # noqa: F401 - whether it is there
        import trimesh  # noqa: F401
        import viser  # noqa: F401
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"the page needs viser ({error}); install it with: pip install 'wbc_controller[view]'"
        ) from error
