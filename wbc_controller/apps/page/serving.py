"""Serves the page of a running robot, from its topics."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import click

from wbc_controller.apps.page.listening import Listener
from wbc_controller.apps.page.meshes import build_meshes
from wbc_controller.apps.page.moment import Robot
from wbc_controller.apps.page.page import Commands, Page
from wbc_controller.apps.page.playback import Playback, TimeLine
from wbc_controller.apps.page.sending import Sender
from wbc_controller.apps.page.server import Gate, address, open_server
from wbc_controller.apps.terminal.session import Session
from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import MOCK_NODE
from wbc_controller.recording.recording_file import Recording
from wbc_controller.settings import Settings

#: Name of the page's own node.
_NODE = "wbc_page"
#: What the page sends on: node, and row of its table.
_SENT = {
    *(("controller", key) for key in ("command", "update", "setpoint", "weight", "task_enable", "contact_enable")),
    *(("mock", key) for key in ("hold", "push", "fault")),
}
#: Wall time between two looks at who publishes the joint states, s.
_LOOK = 1.0


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
    """Serve the page until the event is set.

    Args:
        settings: of the robot.
        stop: event that ends it.
        host: address to listen on.
        port: port to listen on, or the next one that is free.
        namespace: namespace of the robot's nodes.
        remappings: of their topics.
        commands: whether the page may command.
        ready: called with the page's address when it can be opened.

    Raises:
        ConfigurationError: if the robot cannot be drawn, or the address is none of this computer.
        NoAnswer: where the configuration names no URDF, and nobody publishes it.
    """
    _wait_for_the_loop()
    with Session(settings, namespace=namespace, remappings=remappings, node=_NODE) as session:
        urdf = None if settings.robot.urdf else str(session.hear("mock", "robot_description").data)
        robot = Robot(settings, urdf)
        meshes = build_meshes(robot.model)
        gate = Gate(host)
        server = open_server(host, port, gate, commands=commands)
        try:
            page = Page(server, robot, meshes, Listener(session, robot))
            sender = None
            if commands:
                sender = Sender(settings, session.send, page.told)
                _open_lines(session)
                page.command(Commands(sender, _MockWatch(session)))
                sender.start()
            page.view_options()
            found = address(gate, host)
            click.echo(f"page: {found}" + ("" if commands else "  (it watches; --command lets it command)"))
            ready(found)
            try:
                page.run(stop)
            finally:
                if sender is not None:
                    sender.close()
        finally:
            server.stop()


def serve_recording(path: Path, stop: threading.Event, *, host: str, port: int) -> None:
    """Serve the page of a recording until the event is set; arguments and errors as for `serve`."""
    recorded = Recording(path)
    robot = Robot(recorded.config.settings, recorded.config.urdf)
    click.echo(f"{path}: {recorded.count} cycles of {recorded.about['robot']}")
    playback = Playback(recorded, robot)
    meshes = build_meshes(robot.model)
    gate = Gate(host)
    server = open_server(host, port, gate)
    try:
        page = Page(server, robot, meshes, playback)
        page.play(TimeLine(server, playback))
        page.view_options()
        click.echo(f"page: {address(gate, host)}")
        page.run(stop)
    finally:
        server.stop()


def _wait_for_the_loop() -> None:
    """Never take a processor from what runs on it, such as the control loop: wait until it is free, or for a tick.

    For this thread, and all that it starts from now on. Linux alone has such a scheduling class.
    """
    if hasattr(os, "SCHED_BATCH"):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _open_lines(session: Session) -> None:
    """Open now what the page sends on: the first request must not wait until its topic has been found."""
    for place in session.topics:
        if place[:2] in _SENT:
            session.open(*place)


class _MockWatch:
    """Whether the robot is a mock robot: its node publishes the joint states."""

    def __init__(self, session: Session) -> None:
        self._session, self._due, self._is = session, 0.0, False

    def __call__(self) -> bool:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + _LOOK
            try:
                names = self._session.publishers(self._session.topics["mock", "joint_states", ""])
            except TransportError:
                return self._is  # the page is closing
            self._is = any(name.rpartition("/")[2] == MOCK_NODE for name in names)
        return self._is
