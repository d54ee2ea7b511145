"""Real-time scheduling, processors and locked memory of the controller's process, by `control.realtime` (Linux).

All threads of the process get the scheduling class and the processors, those that it starts later too: the loop waits
for the thread that brings a state, and for whichever thread holds the interpreter's lock. Were one of these an ordinary
thread, another program could keep it, and with it the loop, from a processor.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

from wbc_controller.errors import ConfigurationError
from wbc_controller.settings import RealtimeSettings

_KEY = "control.realtime"
_HELP = "see docs/real_time.md"
#: Scheduling classes, by the names of the settings and of Linux.
_CLASSES = {"other": "SCHED_OTHER", "fifo": "SCHED_FIFO", "rr": "SCHED_RR"}
#: Of mlockall(2): what is mapped now, and what will be.
_MCL_CURRENT, _MCL_FUTURE = 1, 2
#: Bit of capabilities(7) by which no limit holds for locked memory.
_CAP_IPC_LOCK = 14
#: Processors that Linux can number.
_NUMBERS = range(1024)
#: Where Linux is told how long processors may take to wake; what is asked holds while the file is open.
_WAKING = Path("/dev/cpu_dma_latency")
_waking: list[int] = []  # that file: the system closes it when the process ends, however it ends


def apply(settings: RealtimeSettings) -> None:
    """Apply the settings to this process, until it ends.

    A refusal of the system is an error, not a warning: these settings are off by default, so a user who sets them needs
    them, and their absence would show only on a busy machine.

    Raises:
        ConfigurationError: if the system refuses, with the remedy.
    """
    if settings != RealtimeSettings() and not hasattr(os, "sched_setscheduler"):
        raise ConfigurationError(f"{_KEY}: {sys.platform} has none of it, Linux does; {_HELP}")
    if settings.affinity:
        _use_processors(sorted(set(settings.affinity)))
    if settings.cpu_dma_latency is not None:
        _stay_awake(settings.cpu_dma_latency)
    if settings.lock_memory:
        _lock_memory()
    if settings.scheduling != "other":
        _schedule(settings.scheduling, settings.priority)


def step_back() -> None:
    """Lower the real-time priority of the calling thread, if it has one, below all other threads of its process.

    A computing thread of that class would keep a processor from others of its priority, such as receiving threads.
    """
    if hasattr(os, "sched_getscheduler"):
        number, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
        if number in (os.SCHED_FIFO, os.SCHED_RR) and priority > 1:
            os.sched_setscheduler(0, number, os.sched_param(priority - 1))


def processors() -> set[int]:
    """Return the numbers of the processors that this process may use; empty if unknown."""
    return set(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else set()


def in_force(process: int = 0) -> str:
    """Describe the scheduling of a process: ``fifo 50 on processors 2, 3, memory locked, cpu_dma_latency held``.

    The process is given by its number, for its main thread, or by 0 for the calling thread. Empty if unknown.
    """
    if not hasattr(os, "sched_getscheduler"):
        return ""
    number = os.sched_getscheduler(process)
    words = next((name for name, linux in _CLASSES.items() if getattr(os, linux) == number), f"class {number}")
    if number in (os.SCHED_FIFO, os.SCHED_RR):
        words += f" {os.sched_getparam(process).sched_priority}"
    processors = sorted(os.sched_getaffinity(process))
    words += f" on processor{'s' if len(processors) > 1 else ''} {_listed(processors)}"
    if int(_status("VmLck", process or "self").split()[0]):
        words += ", memory locked"
    return words + (", cpu_dma_latency held" if _stays_awake(process or "self") else "")


def _use_processors(processors: list[int]) -> None:
    key = f"{_KEY}.affinity = [{_listed(processors)}]"
    before = os.sched_getaffinity(0)
    with contextlib.suppress(OSError):  # none of them is there: what is in force says so
        os.sched_setaffinity(0, processors)
    if os.sched_getaffinity(0) != set(processors):  # Linux takes those that are there, and says nothing of the others
        os.sched_setaffinity(0, _NUMBERS)
        there = os.sched_getaffinity(0)
        os.sched_setaffinity(0, before)
        missing = [number for number in processors if number not in there]
        raise ConfigurationError(
            f"{key}: this process has no processor {_listed(missing)}. Valid: {_listed(sorted(there))}; {_HELP}"
        )
    for thread in _threads():
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            os.sched_setaffinity(thread, processors)


def _schedule(name: str, priority: int) -> None:
    key = f"{_KEY}.scheduling = {name}, priority = {priority}"
    for thread in _threads():
        try:
            os.sched_setscheduler(thread, getattr(os, _CLASSES[name]), os.sched_param(priority))
        except ProcessLookupError:  # as above
            continue
        except PermissionError as error:
            raise ConfigurationError(
                f"{key}: the system refuses it ({error.strerror}). Allow the user `rtprio {priority}` in "
                f"/etc/security/limits.d and log in anew (for a systemd unit LimitRTPRIO={priority}, for a container "
                f"--ulimit rtprio={priority}), or give the process CAP_SYS_NICE; {_HELP}"
            ) from error


def _stay_awake(latency: int) -> None:
    """Limit the wake-up time of processors to `latency`, µs, until the process ends."""
    key = f"{_KEY}.cpu_dma_latency = {latency}"
    try:
        if not _waking:
            _waking.append(os.open(_WAKING, os.O_WRONLY))  # a process that is started does not inherit it
        os.write(_waking[0], struct.pack("=i", latency))
    except OSError as error:
        raise ConfigurationError(
            f"{key}: the system refuses it ({error.strerror}: {_WAKING}). Allow it by the line "
            f'KERNEL=="{_WAKING.name}", GROUP="realtime", MODE="0660" in /etc/udev/rules.d/99-realtime.rules, with the '
            f"user in that group (for a container --device {_WAKING}); {_HELP}"
        ) from error


def _stays_awake(process: int | str) -> bool:
    """Return True if a process limits the wake-up time of processors; False also if that cannot be read."""
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{process}/fd").iterdir():
            with contextlib.suppress(OSError):  # it has been closed meanwhile
                if file.readlink() == _WAKING:
                    return True
    return False


def _lock_memory() -> None:
    key = f"{_KEY}.lock_memory = true"
    allow = (
        "Allow the user `memlock unlimited` in /etc/security/limits.d and log in anew (for a systemd unit "
        f"LimitMEMLOCK=infinity, for a container --ulimit memlock=-1), or give the process CAP_IPC_LOCK; {_HELP}"
    )
    limit = _locked_memory_limit()
    if limit is not None:  # below it mlockall could succeed, and a later allocation fail while the robot stands
        raise ConfigurationError(f"{key}: the process may lock {limit / 1024:.0f} kB alone. {allow}")
    number = _mlockall(_MCL_CURRENT | _MCL_FUTURE)
    if number:
        what = "there is not enough memory" if number == errno.ENOMEM else os.strerror(number)
        raise ConfigurationError(f"{key}: the system refuses it ({what}). {allow}")


def _locked_memory_limit() -> int | None:
    """Return the largest memory that the process may lock, bytes; None without a limit."""
    import resource  # Windows has none

    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    free = soft == resource.RLIM_INFINITY or int(_status("CapEff"), 16) >> _CAP_IPC_LOCK & 1
    return None if free else soft


def _mlockall(flags: int) -> int:
    """Call mlockall(2); return 0, or the number of the error."""
    libc = ctypes.CDLL(None, use_errno=True)
    return ctypes.get_errno() if libc.mlockall(flags) else 0


def _threads() -> list[int]:
    """Return the numbers of the threads of this process."""
    return [int(path.name) for path in Path("/proc/self/task").iterdir()]


def _status(field: str, process: int | str = "self") -> str:
    """Return a field of /proc/<process>/status."""
    lines = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace").splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(f"{field}:")), "0")


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
