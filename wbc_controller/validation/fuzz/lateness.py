"""Measurement of the machine's lateness."""

import os
import threading
import time
from collections import deque
from pathlib import Path

from wbc_controller.nodes.processes import waiting_times

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
            now, before, self._waited = time.monotonic(), self._waited, {}
            for process in list(self._processes):
                times = waiting_times(process)
                if not times:
                    self._processes.discard(process)
                for thread, total in times.items():
                    waited = self._waited[thread] = before.get(thread, deque())
                    waited.append((now, total))
                    while now - waited[0][0] > self._WINDOW and len(waited) > 2:
                        waited.popleft()
                    self._record(total - waited[0][1])

    def _record(self, late: float) -> None:
        with self._lock:
            self.worst = max(self.worst, late)
