"""Real-time scheduling, processors, locked memory (Linux).

Scheduling class and processors apply to all threads, as the loop waits for the receiving thread and for the holder of
the interpreter's lock.
"""

import contextlib
import ctypes
import errno
import os
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

from wbc_controller.errors import ConfigurationError
from wbc_controller.settings.service import RealtimeSettings

_KEY = "control.realtime"
_HELP = "see docs/real_time.md"
#: Scheduling classes, by the names of the settings and of Linux.
_CLASSES = {"other": "SCHED_OTHER", "fifo": "SCHED_FIFO", "rr": "SCHED_RR"}
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # of mlockall(2)
_CAP_IPC_LOCK = 14  # bit of capabilities(7) without limit of locked memory
_NUMBERS = range(1024)  # processor numbers of Linux
#: PM QoS device: the requested wake-up latency holds while the file is open.
_LATENCY_DEVICE = Path("/dev/cpu_dma_latency")
_latency_file: list[int] = []  # descriptor, open until the process ends


def apply_realtime(settings: RealtimeSettings) -> None:
    """Apply the settings to this process until its end. A refusal by the system raises `ConfigurationError`."""
    if settings != RealtimeSettings() and not hasattr(os, "sched_setscheduler"):
        raise ConfigurationError(f"{_KEY}: not supported on {sys.platform}; requires Linux; {_HELP}")
    if settings.affinity:
        _set_affinity(sorted(set(settings.affinity)))
    if settings.cpu_dma_latency is not None:
        _limit_wakeup_latency(settings.cpu_dma_latency)
    if settings.lock_memory:
        _lock_memory()
    if settings.scheduling != "other":
        _set_scheduling(settings.scheduling, settings.priority)


def lower_thread_priority() -> None:
    """Lower the real-time priority of the calling thread by one, below the receiving threads."""
    if hasattr(os, "sched_getscheduler"):
        number, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
        if number in (os.SCHED_FIFO, os.SCHED_RR) and priority > 1:
            os.sched_setscheduler(0, number, os.sched_param(priority - 1))


def processors() -> set[int]:
    """Return the permitted processors of this process; empty if unknown."""
    return set(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else set()


def describe_scheduling(process: int = 0) -> str:
    """Describe the scheduling of a process's main thread, or of the calling thread (0); empty if unknown.

    Example: ``fifo 50 on processors 2, 3, memory locked, cpu_dma_latency held``.
    """
    if not hasattr(os, "sched_getscheduler"):
        return ""
    number = os.sched_getscheduler(process)
    words = next((name for name, linux in _CLASSES.items() if getattr(os, linux) == number), f"class {number}")
    if number in (os.SCHED_FIFO, os.SCHED_RR):
        words += f" {os.sched_getparam(process).sched_priority}"
    processors = sorted(os.sched_getaffinity(process))
    words += f" on processor{'s' if len(processors) > 1 else ''} {_join_numbers(processors)}"
    if int(_status("VmLck", process or "self").split()[0]):
        words += ", memory locked"
    return words + (", cpu_dma_latency held" if _holds_wakeup_latency(process or "self") else "")


def _set_affinity(processors: list[int]) -> None:
    key = f"{_KEY}.affinity = [{_join_numbers(processors)}]"
    before = os.sched_getaffinity(0)
    with contextlib.suppress(OSError):  # no such processor, checked below
        os.sched_setaffinity(0, processors)
    if os.sched_getaffinity(0) != set(processors):  # Linux ignores missing processors silently
        os.sched_setaffinity(0, _NUMBERS)
        available = os.sched_getaffinity(0)
        os.sched_setaffinity(0, before)
        missing = [number for number in processors if number not in available]
        raise ConfigurationError(
            f"{key}: processor {_join_numbers(missing)} is not available; valid: {_join_numbers(sorted(available))}; "
            f"{_HELP}"
        )
    for thread in _threads():
        with contextlib.suppress(ProcessLookupError):  # the thread has ended
            os.sched_setaffinity(thread, processors)


def _set_scheduling(name: str, priority: int) -> None:
    key = f"{_KEY}.scheduling = {name}, priority = {priority}"
    for thread in _threads():
        try:
            os.sched_setscheduler(thread, getattr(os, _CLASSES[name]), os.sched_param(priority))
        except ProcessLookupError:  # the thread has ended
            continue
        except PermissionError as error:
            raise ConfigurationError(
                f"{key}: refused by the system ({error.strerror}). Allow the user `rtprio {priority}` in "
                f"/etc/security/limits.d and log in again (systemd unit: LimitRTPRIO={priority}; container: "
                f"--ulimit rtprio={priority}), or grant CAP_SYS_NICE; {_HELP}"
            ) from error


def _limit_wakeup_latency(latency: int) -> None:
    key = f"{_KEY}.cpu_dma_latency = {latency}"
    try:
        if not _latency_file:
            _latency_file.append(os.open(_LATENCY_DEVICE, os.O_WRONLY))  # child processes do not inherit it
        os.write(_latency_file[0], struct.pack("=i", latency))
    except OSError as error:
        raise ConfigurationError(
            f"{key}: refused by the system ({error.strerror}: {_LATENCY_DEVICE}). Add the line "
            f'KERNEL=="{_LATENCY_DEVICE.name}", GROUP="realtime", MODE="0660" to /etc/udev/rules.d/99-realtime.rules '
            f"and the user to that group (container: --device {_LATENCY_DEVICE}); {_HELP}"
        ) from error


def _holds_wakeup_latency(process: int | str) -> bool:
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{process}/fd").iterdir():
            with contextlib.suppress(OSError):  # just closed
                if file.readlink() == _LATENCY_DEVICE:
                    return True
    return False


def _lock_memory() -> None:
    key = f"{_KEY}.lock_memory = true"
    allow = (
        "Allow the user `memlock unlimited` in /etc/security/limits.d and log in again (systemd unit: "
        f"LimitMEMLOCK=infinity; container: --ulimit memlock=-1), or grant CAP_IPC_LOCK; {_HELP}"
    )
    limit = _locked_memory_limit()
    if limit is not None:  # mlockall could succeed, and a later allocation fail during operation
        raise ConfigurationError(f"{key}: the process may lock only {limit / 1024:.0f} kB. {allow}")
    number = _mlockall(_MCL_CURRENT | _MCL_FUTURE)
    if number:
        what = "not enough memory" if number == errno.ENOMEM else os.strerror(number)
        raise ConfigurationError(f"{key}: refused by the system ({what}). {allow}")


def _locked_memory_limit() -> int | None:
    import resource  # Windows has none

    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    free = soft == resource.RLIM_INFINITY or int(_status("CapEff"), 16) >> _CAP_IPC_LOCK & 1
    return None if free else soft


def _mlockall(flags: int) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    return ctypes.get_errno() if libc.mlockall(flags) else 0


def _threads() -> list[int]:
    return [int(path.name) for path in Path("/proc/self/task").iterdir()]


def _status(field: str, process: int | str = "self") -> str:
    lines = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace").splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(f"{field}:")), "0")


def _join_numbers(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
