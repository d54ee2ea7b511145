"""Service of the page, on topics or a recording, and execution of `wbc play`."""

import contextlib
import os
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

import click

from wbc_controller.apps.page.meshes import build_meshes
from wbc_controller.apps.page.page import Page
from wbc_controller.apps.page.playback import Playback, TimeLine
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.server import Gate, address, open_server
from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.apps.page.topic_source import TopicSource
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.errors import TransportError, WbcError
from wbc_controller.middleware.topics import MOCK_NODE
from wbc_controller.nodes.processes import Processes
from wbc_controller.recording.recording_file import Recording
from wbc_controller.settings import Settings

_NODE = "wbc_page"
#: Keys of the topics of requests, by node.
_REQUESTS = {
    "controller": ("command", "cmd_vel", "update", "setpoint", "weight", "task_enable", "contact_enable"),
    "mock": ("hold", "push", "fault"),
}


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

    Raises `ConfigurationError` if the robot cannot be drawn, or `host` is not an address of this computer; `NoAnswer`
    if the configuration names no URDF and no node publishes one.
    """
    if hasattr(os, "SCHED_BATCH"):  # also for child threads: control loops have priority
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with contextlib.ExitStack() as closing:
        session = closing.enter_context(Session(settings, namespace=namespace, remappings=remappings, node=_NODE))
        urdf = None if settings.robot.urdf else str(session.wait_for_message("mock", "robot_description").data)
        robot = Robot(settings, urdf)
        page, found = closing.enter_context(_page(robot, TopicSource(session, robot), host, port, commands=commands))
        if commands:
            sender = RequestSender(settings, session.send, page.report)
            for node, key, subject in session.topics:
                if key in _REQUESTS.get(node, ()):
                    session.open(node, key, subject)  # before the first request, which would wait for discovery
            page.enable_commands(sender, partial(_has_mock, session))
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


def _has_mock(session: Session) -> bool:
    """Return True if the mock robot publishes the joint states."""
    try:
        names = session.publishers(session.topics["mock", "joint_states", ""])
    except TransportError:
        return False
    return any(name.rpartition("/")[2] == MOCK_NODE for name in names)


_FIRST_DOMAIN, _DOMAINS = 100, 100  # as for the demo, on the loopback
_START_TIMEOUT = 120.0  # wall time, s; a first start compiles the kernels
_CHECK_PERIOD = 0.5  # s


def play(
    robot: str, stop: threading.Event, *, host: str, port: int, domain: int | None = None, factor: float = 1.0
) -> None:
    """Run mock robot, controller and page until the event is set; raise `WbcError` if a process ends by itself."""
    domain = free_domain() if domain is None else domain
    # The environment also applies to the page's own participant.
    os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    errors: list[str] = []
    with (
        tempfile.TemporaryDirectory(prefix="wbc_play_") as folder,
        contextlib.closing(Processes(robot, Path(folder), domain, own_sessions=True)) as processes,
    ):
        # simulated time waits for a controller delayed by a browser
        processes.start("mock", "--patient", "--real-time-factor", f"{factor:g}")
        processes.start("controller", "--activate", "--use-sim-time")
        settings = processes.settings
        starter = threading.Thread(target=_release_hoist, args=(settings, stop, errors), name="starter", daemon=True)
        watcher = threading.Thread(target=_watch, args=(processes, stop, errors), name="watcher", daemon=True)
        starter.start()
        watcher.start()
        click.echo(f"{robot} in DDS domain {domain}, on this computer only; Ctrl-C ends it")
        click.echo(f"commands from another terminal: ROS_DOMAIN_ID={domain} wbc send {robot} com 20mm forward")
        serve(settings, stop, host=host, port=port, commands=True, ready=_open_browser)
        stop.set()
        watcher.join()
    if errors:
        raise WbcError("\n".join(errors))


def free_domain() -> int:
    """Return a DDS domain without a participant on this computer; raise `WbcError` without any."""
    for i in range(_DOMAINS):
        domain = _FIRST_DOMAIN + (os.getpid() + i) % _DOMAINS
        # RTPS 9.6.1.1: port of the first participant of a domain.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", 7410 + 250 * domain))
            return domain
    raise WbcError(
        f"DDS domains {_FIRST_DOMAIN} to {_FIRST_DOMAIN + _DOMAINS - 1} are all in use; choose another with --domain"
    )


def _release_hoist(settings: Settings, stop: threading.Event, errors: list[str]) -> None:
    try:
        with Session(settings, patience=_START_TIMEOUT, node="wbc_play") as session:
            session.listen("controller", "state")
            error = "the controller did not become active; read its log"
            session.until(lambda: stop.is_set() or session.mode().startswith("active"), error, _START_TIMEOUT)
            if not stop.wait(settings.safety.activation_ramp):
                session.execute(parse_request(["release"], settings))
    except WbcError as failure:
        if not stop.is_set():
            errors.append(str(failure))
            stop.set()


def _watch(processes: Processes, stop: threading.Event, errors: list[str]) -> None:
    while not stop.wait(_CHECK_PERIOD):
        error = processes.early_end()
        if error:
            errors.append(error)
            stop.set()


def _open_browser(address: str) -> None:
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)
