"""Measures the lateness of this machine: of naps on each processor, and of the threads of processes."""

import os
import threading
import time
from collections import deque
from pathlib import Path

#: A fault of time counts as the machine's if the machine was late by this share of the fault's time.
MACHINE = 0.5


class Lateness:
    """The lateness of naps on each processor, and the time for which watched processes wait for a processor.

    Attributes:
        worst: largest lateness since `forget`, s: of a nap, or of a thread of this process or of a watched one within
            `_WINDOW`.
    """

    _NAP, _LOOK, _WINDOW = 0.001, 0.01, 0.05

    def __init__(self) -> None:
        self.worst = 0.0
        self._lock = threading.Lock()
        self._processes = {os.getpid()}
        self._waited: dict[Path, deque[tuple[float, float]]] = {}
        self._ended = False
        # A nap on each processor: on a virtual machine one of them may stand still alone.
        naps = [threading.Thread(target=self._nap, args=(cpu,), daemon=True) for cpu in os.sched_getaffinity(0)]
        self._threads = [*naps, threading.Thread(target=self._look, name="lateness", daemon=True)]
        for thread in self._threads:
            thread.start()

    def watch(self, process: int) -> None:
        """OutputMonitor the threads of a process, too."""
        self._processes.add(process)

    def forget(self) -> None:
        """Begin anew."""
        self.worst = 0.0

    def end(self) -> None:
        """End the threads."""
        self._ended = True
        for thread in self._threads:
            thread.join()

    def _nap(self, cpu: int) -> None:
        os.sched_setaffinity(0, {cpu})  # of this thread
        while not self._ended:
            began = time.monotonic()
            time.sleep(self._NAP)
            self._note(time.monotonic() - began - self._NAP)

    def _look(self) -> None:
        while not self._ended:
            time.sleep(self._LOOK)
            now = time.monotonic()
            for process in list(self._processes):
                try:
                    tasks = list(Path(f"/proc/{process}/task").glob("*/schedstat"))
                except FileNotFoundError:  # it ended while it was looked at
                    tasks = []
                if not tasks:
                    self._processes.discard(process)
                for task in tasks:
                    self._look_at(task, now)

    def _look_at(self, task: Path, now: float) -> None:
        try:  # time on the processor, time of waiting for one, ns
            total = 1.0e-9 * int(task.read_text().split()[1])
        except (OSError, IndexError):  # it has ended
            self._waited.pop(task, None)
            return
        waited = self._waited.setdefault(task, deque())
        waited.append((now, total))
        while now - waited[0][0] > self._WINDOW and len(waited) > 2:
            waited.popleft()
        self._note(total - waited[0][1])

    def _note(self, late: float) -> None:
        with self._lock:
            self.worst = max(self.worst, late)
