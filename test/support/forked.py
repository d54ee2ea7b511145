"""Processes as forks of one that has imported the package: a start costs 0.5 s of a processor instead of 3 s."""

import contextlib
import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from wbc_controller.nodes.processes import Processes, end_with_parent

_CONTEXT: Any = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(
    [
        "wbc_controller.apps.page.page_service", "wbc_controller.apps.terminal.node_commands",
        "wbc_controller.apps.terminal.terminal_commands", "wbc_controller.middleware.transports.dds",
        "wbc_controller.nodes.controller_service", "wbc_controller.nodes.guard_service",
        "wbc_controller.safety.model_audit", "wbc_controller.simulation.mock_service",
        "wbc_controller.validation.fuzz.floods", "wbc_controller.validation.latency.latency",
    ]
)  # fmt: skip


#: A killed process leaves the graph of the others after 4 s instead of Cyclone's 10.
SHORT_LEASE = {"CYCLONEDDS_URI": "<Discovery><LeaseDuration>4 s</LeaseDuration></Discovery>"}


class Forked:
    """A process that calls a function, with the methods of `subprocess.Popen` that the tests use.

    Args:
        environment: the whole environment of the process.
        output: file to which the output is appended, or a terminal, which becomes the controlling one.
    """

    def __init__(
        self, environment: Mapping[str, str], output: Path | str, function: Callable[..., object], *arguments: Any
    ) -> None:
        self._process = _CONTEXT.Process(target=_call, args=(dict(environment), str(output), function, arguments))
        self._process.start()
        self.pid: int = self._process.pid

    def poll(self) -> int | None:
        status: int | None = self._process.exitcode
        return status

    returncode = property(poll)

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if (status := self.poll()) is None:
            raise subprocess.TimeoutExpired("fork", timeout or 0.0)
        return status

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def fork_wbc(environment: Mapping[str, str], output: Path | str, *words: str) -> Forked:
    """Start `wbc` with some words."""
    return Forked(environment, output, _main, "cli", "main", words)


def fork_node(environment: Mapping[str, str], output: Path, main: str, *parameters: str) -> Forked:
    """Start a function of `wbc_controller.node` with parameters such as ``robot:=go2``."""
    words = [word for parameter in parameters for word in ("-p", parameter)]
    return Forked(environment, output, _main, "node", main, ["--ros-args", *words])


def _main(module: str, name: str, words: Sequence[str]) -> None:
    sys.argv = ["wbc", *words]
    getattr(importlib.import_module(f"wbc_controller.{module}"), name)()


def _execute(code: str, words: Sequence[str]) -> None:
    sys.argv = ["-c", *words]
    exec(code, {})  # noqa: S102 - code of the package, as `python -c`


def _call(environment: Mapping[str, str], output: str, function: Callable[..., object], arguments: Any) -> None:
    end_with_parent()
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs ignore it
    os.environ.clear()
    os.environ.update(environment)
    terminal = Path(output).is_char_device()
    if terminal:  # not always: Linux gives each session an own share of the processors
        os.setsid()
    opened = os.open(output, os.O_RDWR | os.O_CREAT | os.O_APPEND)
    for number in (0, 1, 2) if terminal else (1, 2):
        os.dup2(opened, number)
    os.close(opened)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout.reconfigure(line_buffering=True)
    function(*arguments)


@pytest.fixture
def forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `nodes.processes.Processes` and `multiprocessing` start forks.

    Commands of `Processes` are ``python … -m wbc_controller WORDS`` or ``python -c CODE WORDS``.
    """

    def launch(self: Any, name: str, command: Sequence[str]) -> Any:
        words = command[command.index("-m") + 2 :] if "-m" in command else command[3:]
        function, *given = (_main, "cli", "main") if "-m" in command else (_execute, command[2])
        output = self._folder / f"{name}.log"
        process = self.processes[name] = Forked(self._environment, output, function, *given, words)
        return process

    monkeypatch.setenv("CYCLONEDDS_URI", SHORT_LEASE["CYCLONEDDS_URI"])
    monkeypatch.setattr(Processes, "launch", launch)
    monkeypatch.setattr(multiprocessing, "get_context", lambda kind: _CONTEXT)
