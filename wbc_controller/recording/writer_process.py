"""The process that writes recordings, as the loop's process starts it and sends it frames."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from wbc_controller.recording.writer import END, frame

_log = logging.getLogger(__name__)

#: Size of the pipe, bytes: the largest that Linux permits ordinary users.
_PIPE = 1 << 20
#: Longest time to close the files at the end, s.
_PATIENCE = 20.0
#: Time between two attempts to send the end, s.
_RETRY = 0.005


class WriterProcess:
    """Starts the process, and sends it frames without waiting for it.

    Attributes:
        dead: True if the process has ended.
        said: number of messages of the process, and the last one.

    Args:
        patient: wait if the pipe is full: for runs in simulated time, which drop nothing.
    """

    def __init__(self, plan: dict[str, Any], *, patient: bool) -> None:
        root = str(Path(__file__).resolve().parents[2])
        paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        their_input, self._pipe = os.pipe()
        our_input, their_output = os.pipe()
        try:
            self._process = subprocess.Popen(  # noqa: S603  # our own
                [sys.executable, "-m", "wbc_controller.recording.writer", json.dumps(plan)],
                stdin=their_input, stdout=their_output, start_new_session=True,
                env={**os.environ, "PYTHONPATH": paths},
            )  # fmt: skip
        finally:
            os.close(their_input)
            os.close(their_output)
        if sys.platform == "linux":
            import fcntl

            with contextlib.suppress(OSError):  # a lower limit of the system: stalls of the process drop cycles sooner
                fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE)
        os.set_blocking(self._pipe, patient)
        self._rest: memoryview | None = None  # of a batch that did not fit
        self.dead = self._closed = False
        self.said = 0, ""
        self._listener = threading.Thread(target=self._listen, args=(our_input,), name="recorder", daemon=True)
        self._listener.start()

    def _listen(self, pipe: int) -> None:
        with os.fdopen(pipe, "rb") as lines:
            for line in lines:
                sentence = line.decode("utf-8", "replace").rstrip()
                self.said = self.said[0] + 1, sentence
                _log.warning("%s", sentence)

    def send(self, batch: bytes) -> bool:
        """Send whole frames. Returns False if they are dropped. Called by one thread at a time."""
        if self.dead:
            return False
        try:
            if self._rest is not None:
                self._rest = self._write(self._rest)
            if self._rest is not None:
                return False
            self._rest = self._write(memoryview(batch))
        except OSError as error:
            self.dead = True
            _log.warning("the recorder has ended (%s): nothing is recorded any more", error.strerror or error)
            return False
        return True

    def _write(self, data: memoryview) -> memoryview | None:
        """Write as much as fits, and return the rest."""
        try:
            while data:
                data = data[os.write(self._pipe, data) :]
        except BlockingIOError:
            return data
        return None

    def close(self) -> None:
        """Let the process write everything, and end. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        ends = time.monotonic() + _PATIENCE
        while not self.dead and not self.send(frame(END, 0, b"")) and time.monotonic() < ends:
            time.sleep(_RETRY)
        while not self.dead and self._rest is not None and time.monotonic() < ends:
            self.send(b"")
            time.sleep(_RETRY)
        os.close(self._pipe)
        self.dead = True
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            _log.warning("the recorder still writes after %g s; it continues in the background", _PATIENCE)
            return
        self._listener.join()
