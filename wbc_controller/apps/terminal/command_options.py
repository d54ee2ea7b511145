"""Common arguments and options of commands, with their shell completion."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from wbc_controller.apps.terminal.quantity_parser import AXES, HEADINGS, LEANS, TURNS
from wbc_controller.apps.terminal.request_parser import FORMS
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.middleware.topics import parse_remapping
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings, shipped_configurations

F = TypeVar("F", bound=Callable[..., Any])


def complete_config(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete supplied robots or files."""
    robots = [CompletionItem(name) for name in shipped_configurations() if name.startswith(incomplete)]
    return robots or [CompletionItem(incomplete, type="file")]


def complete_words(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete a request."""
    settings = _settings(ctx)
    if settings is None:
        return []
    return [CompletionItem(word) for word in next_words(list(ctx.params.get("words") or ()), settings)
            if word.startswith(incomplete)]  # fmt: skip


def complete_topics(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete topics."""
    settings = _settings(ctx)
    if settings is None:
        return []
    from wbc_controller.nodes.wiring import topics_of

    names = sorted({topic.name for topic in topics_of(settings).values()})
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _settings(ctx: click.Context) -> Settings | None:
    try:
        return load_settings(find_configuration(str(ctx.params.get("config") or "")))
    except WbcError:
        return None


def next_words(words: list[str], settings: Settings) -> list[str]:
    """Return the valid next words of a request."""
    if "then" in words:
        words = words[len(words) - words[::-1].index("then") :]
    if not words:
        return [*FORMS, *settings.tasks]
    first, count = words[0], len(words)
    if first in ("task", "weight"):
        return list(settings.tasks) if count == 1 else ["on", "off"] if first == "task" and count == 2 else []
    if first in ("contact", "grip"):
        return list(settings.contacts) if count == 1 else ["on", "off"] if count == 2 else []
    if first == "push":
        if words[-1] == "at":
            return [*settings.tasks, *settings.contacts]
        return [*HEADINGS, *AXES, "for", "at"]
    if first not in settings.tasks:
        return []
    if settings.tasks[first].type in ("posture", "torque"):
        joints = getattr(settings.tasks[first], "joints", None) or settings.robot.joints
        return list(joints) if count % 3 == 1 else ["by", "to"]
    turning = [*TURNS] if words[1:2] == ["turn"] else [*LEANS] if words[1:2] == ["lean"] else []
    return turning or (["to", "turn", "lean"] if count == 1 else [*HEADINGS, *AXES, "in"])


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
