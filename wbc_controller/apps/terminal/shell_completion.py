"""Shell completion of robots, requests and topics."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem

from wbc_controller.apps.terminal.quantity_parser import AXES, HEADINGS, LEANS, TURNS
from wbc_controller.apps.terminal.request_parser import FORMS
from wbc_controller.errors import WbcError
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings, shipped_configurations


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
