"""The run of `wbc play`: a mock robot and its controller as processes, and a page that commands them."""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
import threading
import webbrowser
from pathlib import Path

import click

from wbc_controller.apps.page.page_service import serve
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.errors import WbcError
from wbc_controller.nodes.processes import Processes
from wbc_controller.settings import Settings

#: DDS domains to choose from: those of the demo, since both stay on the loopback.
_FIRST_DOMAIN, _DOMAINS = 100, 100
#: Wall time for the nodes to start, s: the first start on a machine compiles the controller's arithmetic.
_PATIENCE = 120.0
#: Period of the check that the processes still run, s.
_LOOK = 0.5
#: Number of log lines shown of a process that has ended.
_LINES = 12


def play(
    robot: str, stop: threading.Event, *, host: str, port: int, domain: int | None = None, factor: float = 1.0
) -> None:
    """Start mock robot and controller, activate, and serve the page until the event is set; then end them.

    Args:
        robot: a robot that is shipped, or the path of a configuration.
        port: port of the page, or the next free one.
        domain: DDS domain; None for a free one of this computer.
        factor: simulated seconds per second.

    Raises:
        WbcError: if a process ends by itself, with the end of its log.
    """
    domain = free_domain() if domain is None else domain
    # The page's own participant, and those of the processes, by the environment as everywhere.
    os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    trouble: list[str] = []
    with (
        tempfile.TemporaryDirectory(prefix="wbc_play_") as folder,
        contextlib.closing(Processes(robot, Path(folder), domain, own_sessions=True)) as processes,
    ):
        # A browser without a GPU may take both processors: simulated time waits then, and the robot does not fall.
        processes.start("mock", "--patient", "--real-time-factor", f"{factor:g}")
        processes.start("controller", "--activate", "--use-sim-time")
        starter = threading.Thread(target=_stand, args=(processes.settings, stop, trouble), name="starter", daemon=True)
        watcher = threading.Thread(target=_watch, args=(processes, stop, trouble), name="watcher", daemon=True)
        starter.start()
        watcher.start()
        click.echo(f"{robot} on DDS domain {domain}, on this computer alone; Ctrl-C ends it")
        click.echo(f"command it from another terminal, too: ROS_DOMAIN_ID={domain} wbc send {robot} com 20mm forward")
        serve(processes.settings, stop, host=host, port=port, commands=True, ready=_opened)
        stop.set()
        watcher.join()
    if trouble:
        raise WbcError("\n".join(trouble))


def free_domain() -> int:
    """Return a DDS domain without a participant on this computer.

    Raises:
        WbcError: if all candidates are in use.
    """
    for i in range(_DOMAINS):
        domain = _FIRST_DOMAIN + (os.getpid() + i) % _DOMAINS
        # RTPS 9.6.1.1: the port of the first participant of a domain.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", 7410 + 250 * domain))
            return domain
    raise WbcError(
        f"the DDS domains {_FIRST_DOMAIN} to {_FIRST_DOMAIN + _DOMAINS - 1} are all in use; name one: --domain"
    )


def _stand(settings: Settings, stop: threading.Event, trouble: list[str]) -> None:
    """Release the hoist after the controller, which activates itself, has ramped its torques in."""
    try:
        with Session(settings, patience=_PATIENCE, node="wbc_play") as session:
            session.listen("controller", "state")
            session.until(
                lambda: stop.is_set() or session.mode().startswith("active"),
                "the controller has not become active; its log may say why",
                _PATIENCE,
            )
            if not stop.wait(settings.safety.activation_ramp):
                session.ask(parse_request(["release"], settings))
    except WbcError as error:
        if not stop.is_set():
            trouble.append(str(error))
            stop.set()


def _watch(processes: Processes, stop: threading.Event, trouble: list[str]) -> None:
    """End everything if a process ends by itself."""
    while not stop.wait(_LOOK):
        for name, process in processes.processes.items():
            if process.poll() is not None:
                last = "\n".join(processes.log(name).splitlines()[-_LINES:])
                trouble.append(f"the {name} has ended with status {process.returncode}:\n{last}")
                stop.set()
                return


def _opened(address: str) -> None:
    """Open the page in a browser if there is a screen."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)
