"""Service of the page, on topics or a recording."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import click

from wbc_controller.apps.page.meshes import build_meshes
from wbc_controller.apps.page.page import Page
from wbc_controller.apps.page.playback import Playback, TimeLine
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.server import Gate, address, open_server
from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.apps.page.topic_source import TopicSource
from wbc_controller.apps.terminal.session import Session
from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import MOCK_NODE
from wbc_controller.recording.recording_file import Recording
from wbc_controller.settings import Settings

_NODE = "wbc_page"
#: Topics of requests: node and key of the topic.
_REQUESTS = {
    *(
        ("controller", key)
        for key in ("command", "cmd_vel", "update", "setpoint", "weight", "task_enable", "contact_enable")
    ),
    *(("mock", key) for key in ("hold", "push", "fault")),
}
_PERIOD = 1.0  # wall time, s


def serve(
    settings: Settings,
    stop: threading.Event,
    *,
    host: str,
    port: int,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
    commands: bool = False,
    ready: Callable[[str], None] = lambda address: None,
) -> None:
    """Serve the page until the event is set; `ready` receives its address.

    Raises:
        ConfigurationError: if the robot cannot be drawn, or `host` is not an address of this computer.
        NoAnswer: if the configuration names no URDF and no node publishes one.
    """
    _use_batch_scheduling()
    with contextlib.ExitStack() as closing:
        session = closing.enter_context(Session(settings, namespace=namespace, remappings=remappings, node=_NODE))
        urdf = None if settings.robot.urdf else str(session.wait_for_message("mock", "robot_description").data)
        robot = Robot(settings, urdf)
        page, found = closing.enter_context(_page(robot, TopicSource(session, robot), host, port, commands=commands))
        if commands:
            sender = RequestSender(settings, session.send, page.report)
            for place in session.topics:
                if place[:2] in _REQUESTS:
                    session.open(*place)  # opened here so that the first request need not wait for discovery
            page.enable_commands(sender, _MockDetector(session))
            sender.start()
            closing.callback(sender.close)
        page.add_view_options()
        click.echo(f"page: {found}" + ("" if commands else "  (read-only; --command permits requests)"))
        ready(found)
        page.run(stop)


def serve_recording(path: Path, stop: threading.Event, *, host: str, port: int) -> None:
    """Serve a recording; arguments and errors as for `serve`."""
    recorded = Recording(path)
    robot = Robot(recorded.config.settings, recorded.config.urdf)
    click.echo(f"{path}: {recorded.count} cycles of {recorded.about['robot']}")
    playback = Playback(recorded, robot)
    with _page(robot, playback, host, port) as (page, found):
        page.time_line = TimeLine(page.server, playback)
        page.add_view_options()
        click.echo(f"page: {found}")
        page.run(stop)


@contextlib.contextmanager
def _page(
    robot: Robot, source: TopicSource | Playback, host: str, port: int, *, commands: bool = False
) -> Iterator[tuple[Page, str]]:
    meshes, gate = build_meshes(robot.model), Gate(host)
    server = open_server(host, port, gate, commands=commands)
    try:
        yield Page(server, robot, meshes, source), address(gate, host)
    finally:
        server.stop()


def _use_batch_scheduling() -> None:
    """Use Linux's batch scheduling for this thread and its children: control loops have priority."""
    if hasattr(os, "SCHED_BATCH"):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


class _MockDetector:
    def __init__(self, session: Session) -> None:
        self._session, self._due, self._is_mock = session, 0.0, False

    def __call__(self) -> bool:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + _PERIOD
            try:
                names = self._session.publishers(self._session.topics["mock", "joint_states", ""])
            except TransportError:
                return self._is_mock
            self._is_mock = any(name.rpartition("/")[2] == MOCK_NODE for name in names)
        return self._is_mock
