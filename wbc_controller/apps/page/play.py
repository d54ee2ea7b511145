"""Execution of `wbc play`: processes and a page."""

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

_FIRST_DOMAIN, _DOMAINS = 100, 100  # as for the demo, on the loopback
_START_TIMEOUT = 120.0  # wall time, s; a first start compiles the kernels
_CHECK_PERIOD = 0.5  # s


def play(
    robot: str, stop: threading.Event, *, host: str, port: int, domain: int | None = None, factor: float = 1.0
) -> None:
    """Run mock robot, controller and page until the event is set.

    `domain`: by default an unused DDS domain; `factor`: simulated seconds per second.

    Raises:
        WbcError: if a process ends by itself, with the end of its log.
    """
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
        starter = threading.Thread(
            target=_release_hoist, args=(processes.settings, stop, errors), name="starter", daemon=True
        )
        watcher = threading.Thread(target=_watch, args=(processes, stop, errors), name="watcher", daemon=True)
        starter.start()
        watcher.start()
        click.echo(f"{robot} in DDS domain {domain}, on this computer only; Ctrl-C ends it")
        click.echo(f"commands from another terminal: ROS_DOMAIN_ID={domain} wbc send {robot} com 20mm forward")
        serve(processes.settings, stop, host=host, port=port, commands=True, ready=_open_browser)
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
            session.until(
                lambda: stop.is_set() or session.mode().startswith("active"),
                "the controller did not become active; read its log",
                _START_TIMEOUT,
            )
            if not stop.wait(settings.safety.activation_ramp):
                session.execute(parse_request(["release"], settings))
    except WbcError as error:
        if not stop.is_set():
            errors.append(str(error))
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
