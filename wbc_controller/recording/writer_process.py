"""Start of the writer process."""

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO, Any, cast

from wbc_controller.recording.writer import END, frame

_log = logging.getLogger(__name__)

_PIPE = 1 << 20  # bytes: Linux's limit for ordinary users
_TIMEOUT = 20.0  # of the closing of the files, s
_RETRY = 0.005  # period of attempts to send the end, s


class WriterProcess:
    """Writer process with a non-blocking pipe of frames (blocking if `patient`, for simulated time)."""

    def __init__(self, plan: dict[str, Any], *, patient: bool) -> None:
        root = str(Path(__file__).resolve().parents[2])
        paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        self._process = subprocess.Popen(  # noqa: S603  # our own
            [sys.executable, "-m", "wbc_controller.recording.writer", json.dumps(plan)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
            env={**os.environ, "PYTHONPATH": paths},
        )  # fmt: skip
        self._pipe = cast(IO[bytes], self._process.stdin)
        if sys.platform == "linux":
            import fcntl

            with contextlib.suppress(OSError):  # lower system limit: less buffer
                fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE)
        os.set_blocking(self._pipe.fileno(), patient)
        self._unsent: memoryview | None = None  # rest of a batch
        self.dead = self._closed = False  # `dead`: the process has ended
        self.last_message = 0, ""  # number of messages, and text of the last one
        self._listener = threading.Thread(target=self._listen, name="recorder", daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        with cast(IO[bytes], self._process.stdout) as lines:
            for line in lines:
                sentence = line.decode("utf-8", "replace").rstrip()
                self.last_message = self.last_message[0] + 1, sentence
                _log.warning("%s", sentence)

    def send(self, batch: bytes) -> bool:
        """Send whole frames from one thread at a time; return False if dropped."""
        if self.dead:
            return False
        try:
            if self._unsent is not None:
                self._unsent = self._write(self._unsent)
            if self._unsent is not None:
                return False
            self._unsent = self._write(memoryview(batch))
        except OSError as error:
            self.dead = True
            _log.warning("the recorder has ended (%s): nothing is recorded any more", error.strerror or error)
            return False
        return True

    def _write(self, data: memoryview) -> memoryview | None:
        try:
            while data:
                data = data[os.write(self._pipe.fileno(), data) :]
        except BlockingIOError:
            return data
        return None

    def close(self) -> None:
        """Let the process write everything and end. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        ends = time.monotonic() + _TIMEOUT
        while not self.dead and not self.send(frame(END, 0, b"")) and time.monotonic() < ends:
            time.sleep(_RETRY)
        while not self.dead and self._unsent is not None and time.monotonic() < ends:
            self.send(b"")
            time.sleep(_RETRY)
        self.dead = True
        self._pipe.close()
        try:
            self._process.wait(_TIMEOUT)
        except subprocess.TimeoutExpired:
            _log.warning("the recorder has not finished after %g s; it continues in the background", _TIMEOUT)
            return
        self._listener.join()
