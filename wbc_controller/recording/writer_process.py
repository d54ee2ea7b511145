"""The loop's end of the pipe to the process that writes recordings."""

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

from wbc_controller.recording.writer import END, FRAME

_log = logging.getLogger(__name__)

#: Size of the pipe, bytes: the most that Linux gives an ordinary user.
_PIPE = 1 << 20
#: Longest time for the files to be closed at the end, s.
_PATIENCE = 20.0
#: Time between two attempts to send the end, s.
_AGAIN = 0.005


def frame(code: int, at: int, payload: bytes) -> bytes:
    """One frame: its code or channel, the time in ns, and what it holds."""
    return FRAME.pack(len(payload), code, at) + payload


class WriterProcess:
    """Starts the process, and sends it frames without ever waiting for it, unless it is asked to.

    Attributes:
        lost: number of batches that could not be sent.
        dead: whether the process has ended.
        said: how many sentences the process has said, and the last one.
    """

    def __init__(self, plan: dict[str, Any], *, patient: bool) -> None:
        """Start the process.

        Args:
            plan: as `writer.Writer` takes it.
            patient: wait where the pipe is full: for runs in simulated time, which lose nothing and need not hurry.
        """
        root = str(Path(__file__).resolve().parents[2])
        paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        theirs, self._pipe = os.pipe()
        heard, said = os.pipe()
        try:
            self._process = subprocess.Popen(  # noqa: S603  # our own
                [sys.executable, "-m", "wbc_controller.recording.writer", json.dumps(plan)],
                stdin=theirs, stdout=said, start_new_session=True, env={**os.environ, "PYTHONPATH": paths},
            )  # fmt: skip
        finally:
            os.close(theirs)
            os.close(said)
        if sys.platform == "linux":
            import fcntl

            with contextlib.suppress(OSError):  # the system's limit is lower: so is what a stall of the other end costs
                fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE)
        os.set_blocking(self._pipe, patient)
        self._rest: memoryview | None = None  # of a batch that did not fit
        self.dead = self._closed = False
        self.lost = 0
        self.said = 0, ""
        self._listener = threading.Thread(target=self._listen, args=(heard,), name="recorder", daemon=True)
        self._listener.start()

    def _listen(self, heard: int) -> None:
        with os.fdopen(heard, "rb") as lines:
            for line in lines:
                sentence = line.decode("utf-8", "replace").rstrip()
                self.said = self.said[0] + 1, sentence
                _log.warning("%s", sentence)

    def send(self, batch: bytes) -> bool:
        """Send whole frames; says whether they went out, or will. Called by one thread at a time."""
        if self.dead:
            return False
        try:
            if self._rest is not None:
                self._rest = self._pushed(self._rest)
            if self._rest is not None:
                self.lost += 1
                return False
            self._rest = self._pushed(memoryview(batch))
        except OSError as error:
            self.dead = True
            _log.warning("the recorder has ended (%s): nothing is recorded any more", error.strerror or error)
            return False
        return True

    def _pushed(self, data: memoryview) -> memoryview | None:
        """Write what fits; what is left of it."""
        try:
            while data:
                data = data[os.write(self._pipe, data) :]
        except BlockingIOError:
            return data
        return None

    def close(self) -> None:
        """Let the process write all that it has, and end. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        ends = time.monotonic() + _PATIENCE
        while not self.dead and not self.send(frame(END, 0, b"")) and time.monotonic() < ends:
            time.sleep(_AGAIN)
        while not self.dead and self._rest is not None and time.monotonic() < ends:
            self.send(b"")
            time.sleep(_AGAIN)
        os.close(self._pipe)
        self.dead = True
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            _log.warning("the recorder still writes after %g s; it goes on by itself", _PATIENCE)
            return
        self._listener.join()
