"""Measurement of the machine's lateness."""

import os
import threading
import time
from collections import deque
from pathlib import Path

MACHINE = 0.5  # smallest lateness that counts as a fault's cause, as a share of its time limit


class Lateness:
    """Lateness of sleeps and of watched processes; `worst` is the largest since `reset`, s."""

    _NAP, _LOOK, _WINDOW = 0.001, 0.01, 0.05

    def __init__(self) -> None:
        self.worst = 0.0
        self._lock = threading.Lock()
        self._processes = {os.getpid()}
        self._waited: dict[Path, deque[tuple[float, float]]] = {}
        self._ended = False
        naps = [threading.Thread(target=self._nap, args=(cpu,), daemon=True) for cpu in os.sched_getaffinity(0)]
        self._threads = [*naps, threading.Thread(target=self._check_processes, name="lateness", daemon=True)]
        for thread in self._threads:
            thread.start()

    def watch(self, process: int) -> None:
        """Also measure the threads of a process."""
        self._processes.add(process)

    def reset(self) -> None:
        """Reset the largest lateness."""
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
            self._record(time.monotonic() - began - self._NAP)

    def _check_processes(self) -> None:
        while not self._ended:
            time.sleep(self._LOOK)
            now = time.monotonic()
            for process in list(self._processes):
                try:
                    tasks = list(Path(f"/proc/{process}/task").glob("*/schedstat"))
                except FileNotFoundError:  # the process has ended
                    tasks = []
                if not tasks:
                    self._processes.discard(process)
                for task in tasks:
                    self._check_thread(task, now)

    def _check_thread(self, task: Path, now: float) -> None:
        try:  # time on the processor and waiting time, ns
            total = 1.0e-9 * int(task.read_text().split()[1])
        except (OSError, IndexError):  # the thread has ended
            self._waited.pop(task, None)
            return
        waited = self._waited.setdefault(task, deque())
        waited.append((now, total))
        while now - waited[0][0] > self._WINDOW and len(waited) > 2:
            waited.popleft()
        self._record(total - waited[0][1])

    def _record(self, late: float) -> None:
        with self._lock:
            self.worst = max(self.worst, late)
