"""Common arguments and options of commands, with their shell completion."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from wbc_controller.apps.terminal.request_parser import AXES, FORMS, HEADINGS, ROTATIONS
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.middleware.topics import parse_remapping
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings, shipped_configurations

F = TypeVar("F", bound=Callable[..., Any])


def complete_config(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete supplied robots or files."""
    robots = [CompletionItem(name) for name in shipped_configurations() if name.startswith(incomplete)]
    return robots or [CompletionItem(incomplete, type="file")]


def complete_words(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Complete a request."""
    return _matching(ctx, incomplete, lambda settings: next_words(list(ctx.params.get("words") or ()), settings))


def complete_topics(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Complete topics."""
    from wbc_controller.nodes.wiring import topics_of

    return _matching(ctx, incomplete, lambda settings: sorted({topic.name for topic in topics_of(settings).values()}))


def _matching(ctx: click.Context, incomplete: str, choices: Callable[[Settings], Iterable[str]]) -> list[str]:
    try:
        settings = load_named(str(ctx.params.get("config") or ""))
    except WbcError:
        return []
    return [word for word in choices(settings) if word.startswith(incomplete)]


def next_words(words: list[str], settings: Settings) -> list[str]:
    """Return the valid next words of a request."""
    if "then" in words:
        words = words[len(words) - words[::-1].index("then") :]
    if not words:
        return [*FORMS, *settings.tasks]
    first, count = words[0], len(words)
    if first in ("task", "contact", "grip") and count == 2:
        return ["on", "off"]
    if first in ("task", "weight", "contact", "grip"):
        named = settings.tasks if first in ("task", "weight") else settings.contacts
        return list(named) if count == 1 else []
    if first == "push":
        if words[-1] == "at":
            return [*settings.tasks, *settings.contacts]
        return [*HEADINGS, *AXES, "for", "at"]
    if first not in settings.tasks:
        return []
    if settings.tasks[first].type in ("posture", "torque"):
        joints = getattr(settings.tasks[first], "joints", None) or settings.robot.joints
        return list(joints) if count % 3 == 1 else ["by", "to"]
    if count == 1:
        return ["to", *ROTATIONS]
    return list(ROTATIONS.get(words[1], [*HEADINGS, *AXES, "in"]))


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


def jobs_option(what: str) -> Callable[[F], F]:
    """Return the option `--jobs` of a command that runs something in parallel."""
    return click.option("--jobs", default=-1, show_default=True, type=click.IntRange(-1), callback=_nonzero,
                        help=f"Parallel {what}; -1 for one per processor.")  # fmt: skip


def _nonzero(_context: click.Context, _option: click.Parameter, number: int) -> int:
    if number == 0:
        raise click.BadParameter("0 is not in the range; valid: -1, or at least 1.")
    return number


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
