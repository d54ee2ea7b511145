"""Starts the nodes of one robot as processes on one DDS domain, and reads their memory and times from /proc (Linux)."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from wbc_controller.errors import WbcError
from wbc_controller.settings.config import load

#: The C library, and the number of the request in <sys/prctl.h>.
_C, _PR_SET_PDEATHSIG = ctypes.CDLL(None), 1
#: Wall time after which an awaited event counts as missing, s.
PATIENCE = 60.0


class Processes:
    """The processes of one robot: they read one configuration, and communicate on the loopback."""

    def __init__(
        self,
        robot: str,
        folder: Path,
        domain: int,
        changes: Mapping[str, Any] | None = None,
        *,
        own_sessions: bool = False,
    ) -> None:
        """Write the configuration. No process is started yet.

        Args:
            robot: a robot that is shipped, or the path of a configuration.
            folder: for the configuration and the logs; it is made.
            domain: DDS domain.
            changes: of settings, by dotted key.
            own_sessions: start each process in a session of its own: Ctrl-C then reaches only this process, and Linux
                divides the processors between sessions, so that a busy browser does not starve the controller. They end
                with this process.

        Raises:
            ConfigurationError: if there is no such robot, or a value is not valid.
        """
        config = load(robot).replace(changes or {})
        self.settings = config.settings
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._own_sessions = folder, own_sessions
        self.configuration = folder / "robot.yaml"  # the file that all processes read
        self.configuration.write_text(config.to_yaml(), encoding="utf-8")
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def close(self) -> None:
        """End all processes."""
        for name in list(self.processes):
            self.stop(name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, name: str, *options: str) -> subprocess.Popen[bytes]:
        """Start ``mock``, ``controller`` or ``guard``, as `wbc mock`, `run` or `guard`, with options of the command."""
        words = ["run" if name == "controller" else name, str(self.configuration), *options]
        return self.launch(name, [sys.executable, "-m", "wbc_controller", *words])

    def launch(self, name: str, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a process by its command line; its output goes to ``<name>.log``.

        It does not ignore SIGHUP, even if this process does, as under nohup.
        """
        ours = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        try:
            with (self._folder / f"{name}.log").open("ab") as log:
                process = subprocess.Popen(  # noqa: S603 - our own
                    command,
                    env=self._environment,
                    stdout=log,
                    stderr=log,
                    start_new_session=self._own_sessions,
                    preexec_fn=_end_with_parent if self._own_sessions else None,
                )
        finally:
            signal.signal(signal.SIGHUP, ours)
        self.processes[name] = process
        return process

    def stop(self, name: str, number: signal.Signals = signal.SIGINT) -> int:
        """End a process by a signal, and wait for it; its exit status."""
        process = self.processes.pop(name)
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.send_signal(number)
        try:
            return process.wait(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def log(self, name: str) -> str:
        """What a process has written."""
        path = self._folder / f"{name}.log"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _end_with_parent() -> None:
    """Let the kernel end this process with the thread that started it."""
    _C.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def until(
    condition: Callable[[], Any],
    what: str,
    again: Callable[[], Any] = lambda: None,
    patience: float = PATIENCE,
    told: Callable[[], str] = lambda: "",
) -> None:
    """Wait for a condition.

    Args:
        condition: returns True when it is met.
        what: the condition in words, for the error.
        again: called four times a second: a node that was just discovered may miss a message.
        patience: longest time, s.
        told: returns a text to add to the error.

    Raises:
        WbcError: if it is not met in time.
    """
    deadline, due = time.monotonic() + patience, 0.0
    while not condition():
        now = time.monotonic()
        if now >= due:
            again()
            due = now + 0.25
        if now >= deadline:
            raise WbcError(f"waited {patience:g} s in vain for {what}{told()}")
        time.sleep(0.002)


def memory(process: int) -> int:
    """Return the memory in use by a process, kB."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") // 1024


def processor_time(process: int) -> float:
    """Return the processor time of a process, its own and the kernel's, s, to 10 ms."""
    # Its name, in parentheses, may hold spaces.
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def waiting_time(process: int) -> float:
    """Return the total time for which the threads of a process were ready and waited for a processor, s."""
    total = 0
    for schedstat in Path(f"/proc/{process}/task").glob("*/schedstat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # the thread has ended
            total += int(schedstat.read_text().split()[1])  # after the time on a processor, in ns
    return 1.0e-9 * total
