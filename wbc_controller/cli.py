"""Command line `wbc`: table of commands."""

import importlib
import sys
from typing import Any

import click

import wbc_controller
from wbc_controller.errors import WbcError
from wbc_controller.extras import optional_libraries
from wbc_controller.pinocchio_libraries import two_installations

#: Commands by module.
_MODULES = {
    "apps.page.page_commands": "demo play view",
    "apps.terminal.configuration_commands": "check identify new security-policy",
    "apps.terminal.node_commands": "estimate guard mock run",
    "apps.terminal.terminal_commands": "drive echo send status topics",
    "recording.replay.replay_commands": "replay report",
    "validation.accuracy.accuracy_commands": "accuracy",
    "validation.campaign.faults_command": "faults",
    "validation.fuzz.fuzz_commands": "fuzz",
    "validation.latency.latency_commands": "bench",
}
COMMANDS = dict(sorted((name, module) for module, names in _MODULES.items() for name in names.split()))


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
