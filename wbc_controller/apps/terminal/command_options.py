"""Common options: CONFIG, --namespace, --remap."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import click

from wbc_controller.apps.terminal.shell_completion import complete_config
from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.topics import parse_remapping
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

F = TypeVar("F", bound=Callable[..., Any])


def _read_remappings(ctx: click.Context, param: click.Parameter, texts: Sequence[str]) -> dict[str, str]:
    return {} if ctx.resilient_parsing else dict(map(parse_remapping, texts))


config_argument = click.argument("config", shell_complete=complete_config)
namespace_option = click.option(
    "--namespace", default="/", show_default=True, help="Namespace of the nodes and topics."
)
remap_option = click.option("--remap", "remappings", multiple=True, metavar="FROM:=TO", callback=_read_remappings,
                            help="Rename a topic; repeatable.")  # fmt: skip


def with_options(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Combine decorators in the order of the help."""

    def decorate(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def load_named(config: str) -> Settings:
    """Load the settings of a supplied robot or a file; raise `ConfigurationError` if invalid."""
    return load_settings(find_configuration(config))


@contextlib.contextmanager
def naming_file(config: str) -> Iterator[None]:
    """Prefix errors about values with the path of the file."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{find_configuration(config)}: {error}") from error
