"""Commands on topics: `wbc send`, `drive`, `echo`, `status`, `topics`."""

import contextlib
import math
import sys
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import yaml

from wbc_controller.apps.terminal import DISCOVERY_PATIENCE
from wbc_controller.apps.terminal import command_options as common
from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.middleware.topics import Direction, Endpoint
from wbc_controller.settings import Settings

if TYPE_CHECKING:
    from wbc_controller.apps.terminal.session import Session

REFUSED, NO_ANSWER = 1, 3  # further exit statuses: request refused, and no answer
_REFRESH = 0.5  # s

_session_options = common.with_options(
    common.config_argument,
    common.namespace_option,
    common.remap_option,
    click.option("--wait", "patience", default=DISCOVERY_PATIENCE, show_default=True, type=click.FloatRange(0.1),
                 help="Time limit for the discovery of a node, s."),
)  # fmt: skip


@contextlib.contextmanager
def _connect(settings: Settings, connection: Mapping[str, Any]) -> Iterator["Session"]:
    from wbc_controller.apps.terminal.session import NoAnswer, Session

    try:
        with Session(settings, **connection) as session:
            yield session
    except NoAnswer as error:
        click.echo(str(error), err=True)
        sys.exit(NO_ANSWER)


@click.command(context_settings={"ignore_unknown_options": True})
@_session_options
@click.argument("words", nargs=-1, required=True, shell_complete=common.complete_words)
def send(config: str, words: tuple[str, ...], **connection: Any) -> None:
    """Send a request to the running nodes of a robot, and print its outcome.

    \b
    activate | deactivate | damp | reset | estop     modes of the controller
    release | hold                                   hoist of the mock robot
    com +0.02 forward 0.01 down                      relative setpoint of a task (m, or 20mm, 2cm)
    torso turn 10deg left, torso lean 5deg forward   relative orientation (rad, or deg)
    right_hand to 0.3 -0.2 0.9 [in torso_link]       absolute setpoint, in the world or a frame
    posture left_knee_joint by 0.1 (or: to 0.7)      joints of a posture task (rad)
    weight com 30, task right_hand on                weights, tasks on and off
    contact left_foot off, grip CONTACT on           contacts on and off; grips of the mock robot
    push 60 forward for 0.1 at torso                 push of the mock robot (N; at a task, contact or frame)
    update YAML, fault YAML                          several changes together; docs/faults.md

    forward, back, left, right refer to the robot's heading; x, y, z to the axes of the world. `then` joins
    requests: activate then release.

    Exit status: 0 accepted, 1 refused, 2 invalid, 3 no answer from a node.
    """  # noqa: D301 - click's mark of lines that it must not join
    from wbc_controller.apps.terminal.request_parser import parse_request

    settings = common.load_named(config)
    requests = [parse_request(each, settings) for each in _split_requests(words)]
    for request in requests:
        if request.frame and settings.robot.urdf:
            from wbc_controller.controller.build.robot import make_model

            make_model(settings).frame_id(request.frame, "at")
    with _connect(settings, connection) as session:
        for request in requests:
            answer = session.execute(request)
            click.echo(answer.text, err=not answer.done)
            if not answer.done:
                sys.exit(REFUSED)


@click.command()
@_session_options
@click.option("--speed", default=0.2, show_default=True, type=click.FloatRange(0.0, 5.0, min_open=True),
              help="First speed, m/s.")  # fmt: skip
@click.option("--turn-rate", default=0.3, show_default=True, type=click.FloatRange(0.0, 5.0, min_open=True),
              help="First turning rate, rad/s.")  # fmt: skip
def drive(config: str, speed: float, turn_rate: float, **connection: Any) -> None:
    """Drive a walking robot by keyboard. A velocity stays until the next key.

    The controller limits it to the speeds of the section `walking`. The robot stops when this command ends, at the
    latest after `walking.command_timeout`.
    """
    from wbc_controller.apps.terminal.keyboard import KEYS, Drive, publish_velocities, single_keys
    from wbc_controller.nodes.signals import exit_by_signals

    settings = common.load_named(config)
    if settings.walking is None:
        raise InputRefused(f"{config} cannot walk: its configuration has no section 'walking'")
    if not sys.stdin.isatty():
        raise InputRefused("standard input is not a terminal, from which the keys are read; start this in a terminal")
    exit_by_signals()
    with _connect(settings, connection) as session, contextlib.suppress(KeyboardInterrupt):
        session.wait_for_controller()
        click.echo(KEYS)
        with single_keys(sys.stdin.fileno()):
            publish_velocities(session, Drive(speed, turn_rate), sys.stdin.fileno())


@click.command()
@_session_options
@click.argument("topic", shell_complete=common.complete_topics)
@click.option("--once", is_flag=True, help="Exit after the first message.")
def echo(config: str, topic: str, once: bool, **connection: Any) -> None:
    """Print the messages on a topic: `~/state`, `com/reference`, `joint_states`, … (`wbc topics` lists them)."""
    with _connect(common.load_named(config), connection) as session:
        found = find_topic(topic, session.topics)
        messages = session.follow(found)
        deadline = time.monotonic() + connection["patience"]
        while True:
            for content in messages(0.1):
                click.echo(f"{as_text(content)}---")
                deadline = math.inf
                if once:
                    return
            if time.monotonic() >= deadline:
                deadline = math.inf
                if not session.publishers(found):
                    click.echo(f"no publisher on {found.name} ({found.type.replace('/msg/', '/')})", err=True)
                    sys.exit(NO_ANSWER)
                click.echo(f"no message on {found.name} yet; Ctrl-C to exit", err=True)


@click.command()
@_session_options
@click.option("--once", is_flag=True, help="Print the status once and exit.")
def status(config: str, once: bool, **connection: Any) -> None:
    """Show the state of a robot: mode, rates, ages, tasks, binding constraints, and the audit."""
    from rich.console import Console, RenderableType
    from rich.live import Live

    from wbc_controller.apps.terminal.status_view import StatusListener, status_view

    settings = common.load_named(config)
    console = Console()
    if not console.is_terminal:
        console.width = 140
    with _connect(settings, connection) as session, contextlib.suppress(KeyboardInterrupt):
        session.find_controller()
        listener = StatusListener(session, settings)

        def view() -> RenderableType:
            listener.read_statuses()
            robot = listener.newest()
            return "no status of the controller yet" if robot is None else status_view(settings, robot)

        listener.wait_for_first()
        if once or not console.is_terminal:
            console.print(view())
            return
        with Live(view(), console=console, auto_refresh=False) as live:
            while True:
                time.sleep(_REFRESH)
                live.update(view(), refresh=True)


@click.command()
def topics() -> None:
    """Print the table of all topics as Markdown."""
    from wbc_controller.middleware.topics_table import topics_page

    click.echo(topics_page(), nl=False)


def find_topic(text: str, topics: dict[tuple[str, str, str], Endpoint]) -> Endpoint:
    """Return the topic with this name or end of a name; raise `InputRefused` without one."""
    by_name = {topic.name: topic for topic in topics.values()}
    # Latched messages require the sender's row, with a latched subscription.
    by_name |= {topic.name: topic for topic in topics.values() if topic.direction is Direction.OUT}
    ending = "/" + text.removeprefix("~").strip("/")
    found = by_name.get(text) or next((topic for name, topic in by_name.items() if name.endswith(ending)), None)
    if found is None:
        raise InputRefused(f"unknown topic {text!r}; {valid_choices(text, by_name)}")
    return found


def _split_requests(words: tuple[str, ...]) -> list[list[str]]:
    requests: list[list[str]] = [[]]
    for word in words if words[0] in ("update", "fault") else " ".join(words).split():
        if word == "then":
            requests.append([])
            continue
        requests[-1].append(word)
    return requests


_KEY_VALUE = "diagnostic_msgs/msg/KeyValue"  # type of diagnostic entries, printed in one line


def as_text(content: Any) -> str:
    """Return a message as YAML."""
    return yaml.dump(_plain(content), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=math.inf)


def _plain(value: Any) -> Any:
    """Return a message as dictionaries, lists and scalars, with six digits of each float."""
    if hasattr(value, "__msgtype__"):
        return {name: _plain(part) for name, part in vars(value).items() if name != "__msgtype__"}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list) and value and getattr(value[0], "__msgtype__", "") == _KEY_VALUE:
        return {entry.key: entry.value for entry in value}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


class _Dumper(yaml.SafeDumper):
    """Dumper with scalars of a list, vectors and quaternions in one line, and literal texts of several lines."""

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        nested = any(isinstance(part, dict) for part in sequence)
        return super().represent_sequence(tag, sequence, flow_style=not nested)

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> yaml.MappingNode:
        return super().represent_mapping(tag, mapping, flow_style=set(mapping) <= set("xyzw"))

    def represent_scalar(self, tag: str, value: str, style: str | None = None) -> yaml.ScalarNode:
        return super().represent_scalar(tag, value, "|" if "\n" in value else style)
