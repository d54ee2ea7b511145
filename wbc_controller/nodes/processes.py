"""Processes of a robot's nodes (Linux)."""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from wbc_controller.errors import WbcError
from wbc_controller.settings.config import Config, load

_C, _PR_SET_PDEATHSIG = ctypes.CDLL(None), 1  # C library, and request of <sys/prctl.h>
TIMEOUT = 60.0  # of awaited events in wall time, s
_LOG_LINES = 12  # in the sentence on an ended process


class Processes:
    """Processes of one robot with one configuration, connected on the loopback."""

    def __init__(
        self,
        robot: str | Config,
        folder: Path,
        domain: int,
        changes: Mapping[str, Any] | None = None,
        *,
        own_sessions: bool = False,
    ) -> None:
        """Write the configuration, with `changes` by dotted key, into a folder for logs; start no process yet.

        With `own_sessions` each process has its own session, against Ctrl-C and a busy browser.
        """
        config = load(robot).replace(changes or {})
        self.settings = config.settings
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._own_sessions = folder, own_sessions
        self.configuration = folder / "robot.yaml"
        self.configuration.write_text(config.to_yaml(), encoding="utf-8")
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.details: Callable[[], str] = lambda: ""  # end of the error of `until`

    def close(self) -> None:
        """Stop all processes, the last one first."""
        for name in reversed(list(self.processes)):
            self.stop(name)

    def start(self, name: str, *options: str) -> subprocess.Popen[bytes]:
        """Start ``mock``, ``controller`` or ``guard`` as `wbc mock`, `run` or `guard` with options."""
        words = ["run" if name == "controller" else name, str(self.configuration), *options]
        return self.launch(name, [sys.executable, "-m", "wbc_controller", *words])

    def launch(self, name: str, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a command with output in ``<name>.log`` and the default action of SIGHUP."""
        handler = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        try:
            with (self._folder / f"{name}.log").open("ab") as log:
                process = subprocess.Popen(  # noqa: S603 - our own
                    command,
                    env=self._environment,
                    stdout=log,
                    stderr=log,
                    start_new_session=self._own_sessions,
                    preexec_fn=end_with_parent,
                )
        finally:
            signal.signal(signal.SIGHUP, handler)
        self.processes[name] = process
        return process

    def stop(self, name: str, number: signal.Signals = signal.SIGINT) -> int:
        """Stop a process by a signal, and return its exit status."""
        process = self.processes.pop(name)
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.send_signal(number)
        try:
            return process.wait(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def early_end(self) -> str:
        """Return a sentence on a process that has ended, with the end of its log; empty without one."""
        for name, process in self.processes.items():
            if process.poll() is not None:
                last = "\n".join(self.log(name).splitlines()[-_LOG_LINES:])
                return f"the {name} ended with exit status {process.returncode}:\n{last}"
        return ""

    def check(self) -> None:
        """Raise `WbcError` if a process has ended."""
        error = self.early_end()
        if error:
            raise WbcError(error)

    def until(
        self,
        condition: Callable[[], Any],
        what: str,
        retry: Callable[[], Any] = lambda: None,
        patience: float = TIMEOUT,
    ) -> None:
        """Wait for a condition; four times per second, `check` and `retry`. Raise `WbcError` after `patience`, s."""
        deadline, due = time.monotonic() + patience, 0.0
        while not condition():
            now = time.monotonic()
            if now >= due:
                self.check()
                retry()
                due = now + 0.25
            if now >= deadline:
                raise WbcError(f"timeout of {patience:g} s while waiting for {what}{self.details()}")
            time.sleep(0.002)

    def until_active(self, mode: Callable[[], str], send: Callable[[str], None]) -> None:
        """Send commands until the controller's mode is active, also after a fault; errors as of `until`."""

        def ask() -> None:
            for word in ("activate",) if mode().startswith("inactive") else ("reset", "activate"):
                send(word)

        self.until(lambda: mode() == "active", "the activation", ask)

    def log(self, name: str) -> str:
        """Return the output of a process."""
        path = self._folder / f"{name}.log"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def end_with_parent() -> None:
    """Kill this process, also a stopped one, when its parent ends."""
    if sys.platform == "linux":
        _C.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def memory(process: int) -> int:
    """Return the resident memory of a process, kB."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") // 1024


def processor_time(process: int) -> float:
    """Return the user and kernel time of a process, s, in steps of 10 ms."""
    # The process name, in parentheses, may contain spaces.
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def waiting_times(process: int) -> dict[Path, float]:
    """Return the time that each ready thread waited for a processor, s; empty after the end of the process."""
    times = {}
    with contextlib.suppress(FileNotFoundError):  # the process has ended
        for schedstat in Path(f"/proc/{process}/task").glob("*/schedstat"):
            with contextlib.suppress(OSError, IndexError):  # the thread has ended
                times[schedstat] = 1.0e-9 * int(schedstat.read_text().split()[1])
    return times
