"""Command line `wbc`: table of commands."""

import importlib
import sys
from typing import Any

import click

import wbc_controller
from wbc_controller.errors import WbcError
from wbc_controller.extras import optional_libraries
from wbc_controller.pinocchio_libraries import two_installations

#: Module of each command.
COMMANDS = {
    "accuracy": "validation.accuracy.accuracy_commands",
    "bench": "validation.latency.latency_commands",
    "check": "apps.terminal.configuration_commands",
    "demo": "apps.page.page_commands",
    "drive": "apps.terminal.terminal_commands",
    "echo": "apps.terminal.terminal_commands",
    "estimate": "apps.terminal.node_commands",
    "faults": "validation.campaign.faults_command",
    "fuzz": "validation.fuzz.fuzz_commands",
    "guard": "apps.terminal.node_commands",
    "identify": "apps.terminal.configuration_commands",
    "mock": "apps.terminal.node_commands",
    "new": "apps.terminal.configuration_commands",
    "play": "apps.page.page_commands",
    "replay": "recording.replay.replay_commands",
    "report": "recording.replay.replay_commands",
    "run": "apps.terminal.node_commands",
    "security-policy": "apps.terminal.configuration_commands",
    "send": "apps.terminal.terminal_commands",
    "status": "apps.terminal.terminal_commands",
    "topics": "apps.terminal.terminal_commands",
    "view": "apps.page.page_commands",
}


class _Commands(click.Group):
    """Group that imports commands when used, and prints a `WbcError` as one message with exit status 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module = importlib.import_module(f"wbc_controller.{COMMANDS[name]}")
        command: click.Command = getattr(module, name.replace("-", "_"))
        return command

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with optional_libraries():
                return super().invoke(ctx)
        except WbcError as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(2)
        except ImportError as error:
            warning = two_installations()
            if not warning:
                raise
            click.echo(f"error: {error}\n{warning}", err=True)
            sys.exit(2)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(wbc_controller.__version__, prog_name="wbc")
def main() -> None:
    """Whole-body control by one quadratic program per cycle.

    CONFIG is the name of a shipped robot (g1, talos, go2) or the path of a .yaml file.
    """
