"""The commands with which a user talks to running nodes: `wbc send`, `wbc echo` and `wbc status`."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any, TypeVar

import click

from wbc_controller.apps.terminal import DISCOVERY_PATIENCE
from wbc_controller.apps.terminal.completion import complete_config, complete_topics, complete_words
from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.middleware.topics import Direction, Endpoint, parse_remapping
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

F = TypeVar("F", bound=Callable[..., Any])

#: Exit statuses beside 0 and 2: the answer is no, and nobody answers.
REFUSED, NOBODY = 1, 3
#: Time between two pictures of the status, s.
_REFRESH = 0.5


def _talks(function: F) -> F:
    """Options of every command that talks to nodes."""
    options = [
        click.option("--namespace", default="/", show_default=True, help="Namespace of the nodes' topics."),
        click.option("--remap", "remaps", multiple=True, metavar="FROM:=TO", help="A renamed topic; may be repeated."),
        click.option("--wait", "patience", default=DISCOVERY_PATIENCE, show_default=True, type=click.FloatRange(0.1),
                     help="Seconds to wait for the discovery of a node."),
    ]  # fmt: skip
    for option in reversed(options):
        function = option(function)
    return click.argument("config", shell_complete=complete_config)(function)


@click.command(context_settings={"ignore_unknown_options": True})
@_talks
@click.argument("words", nargs=-1, required=True, shell_complete=complete_words)
def send(config: str, words: tuple[str, ...], namespace: str, remaps: tuple[str, ...], patience: float) -> None:
    """Send a request to the running nodes of a robot, and say what came of it.

    \b
    activate | deactivate | damp | reset | estop     the controller's modes
    release | hold                                   the mock robot's hoist
    com +0.02 forward 0.01 down                      a task's reference, moved (m, or 20mm, 2cm)
    torso turn 10deg left, torso lean 5deg forward   turned (rad, or deg)
    right_hand to 0.3 -0.2 0.9 [in torso_link]       to a place in the world or in a frame
    posture left_knee_joint by 0.1 (or: to 0.7)      joints of a posture task (rad)
    weight com 30, task right_hand on                weights, tasks on and off
    contact left_foot off, grip CONTACT on           contacts made and broken; the mock robot's grips
    push 60 forward for 0.1 at torso                 a push of the mock robot (N; a task, contact or frame)
    update YAML, fault YAML                          several changes at once; docs/faults.md

    forward, back, left, right go by the robot's heading, x, y, z along the world's axes. `then` joins sentences:
    activate then release.

    The status is 0 where it was accepted, 1 where it was refused, 2 where it makes no sense, 3 where nobody answers.
    """  # noqa: D301 - click's mark of lines that it must not join
    from wbc_controller.apps.terminal.sentences import read_sentence
    from wbc_controller.apps.terminal.session import NoAnswer, Session

    settings = load_settings(find_configuration(config))
    requests = [read_sentence(sentence, settings) for sentence in _sentences(words)]
    for request in requests:
        if request.frame and settings.robot.urdf:
            _know(settings, request.frame)
    with Session(settings, namespace=namespace, remappings=_remappings(remaps), patience=patience) as session:
        for request in requests:
            try:
                answer = session.ask(request)
            except NoAnswer as silence:
                click.echo(str(silence), err=True)
                sys.exit(NOBODY)
            click.echo(answer.sentence, err=not answer.done)
            if not answer.done:
                sys.exit(REFUSED)


@click.command()
@_talks
@click.argument("topic", shell_complete=complete_topics)
@click.option("--once", is_flag=True, help="End after the first message.")
def echo(config: str, topic: str, once: bool, namespace: str, remaps: tuple[str, ...], patience: float) -> None:
    """Print the messages on a topic: `~/state`, `com/reference`, `joint_states`, … (`wbc topics` lists them)."""
    from wbc_controller.apps.terminal.printing import as_text
    from wbc_controller.apps.terminal.session import Session, topics_of

    settings = load_settings(find_configuration(config))
    remappings = _remappings(remaps)
    found = find_topic(topic, topics_of(settings, namespace, remappings))
    with Session(settings, namespace=namespace, remappings=remappings, patience=patience) as session:
        messages = session.follow(found)
        deadline = time.monotonic() + patience
        while True:
            for content in messages(0.1):
                click.echo(as_text(content))
                click.echo("---")
                deadline = math.inf
                if once:
                    return
            if time.monotonic() >= deadline:
                deadline = math.inf
                if not session.publishers(found):
                    click.echo(f"nobody publishes {found.name} ({found.type.replace('/msg/', '/')})", err=True)
                    sys.exit(NOBODY)
                click.echo(f"nothing has come on {found.name} yet; Ctrl-C ends the wait", err=True)


@click.command()
@_talks
@click.option("--once", is_flag=True, help="Print it once; where the output is no terminal it is so anyway.")
def status(config: str, once: bool, namespace: str, remaps: tuple[str, ...], patience: float) -> None:
    """Show how a robot is: mode, rates, ages, its tasks, what binds, and the audit."""
    from rich.console import Console
    from rich.live import Live

    from wbc_controller.apps.terminal.session import NoAnswer, Session
    from wbc_controller.apps.terminal.watching import Watch

    settings = load_settings(find_configuration(config))
    console = Console()
    if not console.is_terminal:
        console.width = 140
    with Session(settings, namespace=namespace, remappings=_remappings(remaps), patience=patience) as session:
        try:
            session.find_controller()
            watch = Watch(session, settings)
            watch.begin()
            if once or not console.is_terminal:
                console.print(watch.picture())
                return
            with Live(watch.picture(), console=console, auto_refresh=False) as live:
                while True:
                    time.sleep(_REFRESH)
                    live.update(watch.picture(), refresh=True)
        except NoAnswer as silence:
            click.echo(str(silence), err=True)
            sys.exit(NOBODY)
        except KeyboardInterrupt:
            return


def find_topic(text: str, topics: dict[tuple[str, str, str], Endpoint]) -> Endpoint:
    """Find a topic by its name, or by the end of it, such as ``state`` or ``com/reference``.

    Raises:
        InputRefused: where there is no such topic.
    """
    by_name = {topic.name: topic for topic in topics.values()}
    # Where one node sends to another, the sender's row counts: a latched message is only heard as such.
    by_name |= {topic.name: topic for topic in topics.values() if topic.direction is Direction.OUT}
    ending = "/" + text.removeprefix("~").strip("/")
    own = [name for name in by_name if name.endswith(ending)]
    first = by_name.get(text) or next((by_name[name] for name in own), None)
    if first is None:
        raise InputRefused(f"there is no topic {text!r}; {valid_choices(text, by_name)}")
    return first


def _sentences(words: tuple[str, ...]) -> list[list[str]]:
    """Sentences that are joined by ``then``, or end with a comma; one argument may hold several words."""
    sentences: list[list[str]] = [[]]
    for word in words if words[0] in ("update", "fault") else " ".join(words).split():
        if word == "then":
            sentences.append([])
            continue
        sentences[-1].append(word)
    return sentences


def _know(settings: Settings, frame: str) -> None:
    """Refuse a frame that the robot has not: the mock robot would say so in its log alone."""
    from wbc_controller.controller.build.robot import make_model

    make_model(settings).frame_id(frame, "at")


def _remappings(texts: tuple[str, ...]) -> dict[str, str]:
    return dict(parse_remapping(text) for text in texts)
