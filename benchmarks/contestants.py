"""The contestants, each a process of its own, and the environments that they need."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

import numpy as np

from wbc_controller.records import Array

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
#: What the rivals' wheels were built against: their wheels and ours need other releases of the same libraries.
REQUIREMENTS = {
    "tsid": ("tsid==1.7.1", "pin==3.4.0", "cmeel-urdfdom==4.0.1", "cmeel-tinyxml2<11"),
    "placo": ("placo==0.10.2", "pin==3.8.0", "cmeel-urdfdom==4.0.1", "cmeel-tinyxml2<11"),
}
RIVALS = tuple(REQUIREMENTS)


def environment(rival: str) -> Path:
    """Python of a rival's environment, made where there is none.

    Raises:
        SystemExit: where the wheels cannot be installed.
    """
    folder, requirements = ROOT / f".venv-{rival}", REQUIREMENTS[rival]
    python, done = folder / "bin" / "python", folder / "installed"
    if not (done.is_file() and done.read_text(encoding="utf-8") == " ".join(requirements)):
        print(f"Preparing {folder.name} for {rival}: half a gigabyte on disk, once.", file=sys.stderr)
        install = ["-m", "pip", "install", "--disable-pip-version-check", "--quiet", "--only-binary", ":all:"]
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)  # noqa: S603
            subprocess.run([python, *install, *requirements], check=True)  # noqa: S603
        except subprocess.CalledProcessError as error:
            release = ".".join(map(str, sys.version_info[:2]))
            raise SystemExit(
                f"{rival} could not be installed for Python {release} (the command above failed); "
                "--rivals names those to compare with, 'none' for none"
            ) from error
        done.write_text(" ".join(requirements), encoding="utf-8")
    return python


@contextmanager
def code_of(commit: str) -> Iterator[Path]:
    """The files of a commit, in a temporary folder.

    Raises:
        SystemExit: where this repository has no such commit.
    """
    git = ["git", "-C", str(ROOT)]
    known = subprocess.run(  # noqa: S603
        [*git, "rev-parse", "--quiet", "--verify", "--end-of-options", f"{commit}^{{commit}}"], capture_output=True
    )
    if known.returncode:
        raise SystemExit(f"--against {commit!r}: no commit of this repository; `git log --oneline` lists them")
    archive = subprocess.run([*git, "archive", known.stdout.decode().strip()], check=True, capture_output=True)  # noqa: S603
    with TemporaryDirectory(prefix="wbc_bench_") as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
            files.extractall(folder, filter="data")
        yield Path(folder)


@dataclass(frozen=True)
class Answers:
    """What a contestant answered to some states; NaN where it found no solution.

    Attributes:
        v_dot: accelerations, (n, nv).
        tau: torques of the joints in the order of the model, (n, nv - 6).
        forces: of the contacts, in their frames or, of points, in the world, (n, forces).
        parts: seconds that each part took, (n, parts).
        seconds: seconds that the whole cycle took, (n,).
    """

    v_dot: Array
    tau: Array
    forces: Array
    parts: Array
    seconds: Array


class Contestant:
    """A worker's process.

    Attributes:
        name: for the table.
        hello: what it said of itself: `serving.Contestant.hello`.
    """

    def __init__(
        self, name: str, python: Sequence[str], worker: str, scene: Mapping[str, Any], arguments: Sequence[str] = ()
    ) -> None:
        """Start it, and wait until it is ready.

        Args:
            name: for the table.
            python: the interpreter and its options.
            worker: file of this folder.
            scene: what it is told.
            arguments: of the worker.

        Raises:
            SystemExit: where it ends before.
        """
        self.name = name
        command = [*python, str(HERE / worker), *arguments]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
        self._send((json.dumps(scene) + "\n").encode())
        line = self._process.stdout.readline() if self._process.stdout else b""
        if not line:
            self._process.communicate()
            raise SystemExit(f"{name}'s process ended before it was ready; what it said is above")
        self.hello: dict[str, Any] = json.loads(line)
        self._places = np.cumsum([*self.hello["sizes"], len(self.hello["parts"])])

    def __enter__(self) -> Contestant:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate()  # closes its input, on which it ends

    def _send(self, content: bytes) -> None:
        if self._process.stdin is not None:
            try:
                self._process.stdin.write(content)
                self._process.stdin.flush()
            except BrokenPipeError:
                pass  # it has ended: reading its answer says so

    def solve(self, rows: Array, touched: int = 0) -> Answers:
        """Answer states, in order.

        Args:
            rows: q, v, and the centre of mass's reference position, velocity and acceleration, (n, nq + nv + 9).
            touched: bytes of other memory that it writes before each cycle.

        Raises:
            SystemExit: where the process has ended.
        """
        rows = np.ascontiguousarray(np.atleast_2d(rows), dtype=np.float64)
        self._send(struct.pack("<qq", len(rows), touched) + rows.tobytes())
        width = int(self._places[-1]) + 1
        size = 8 * len(rows) * width
        content = self._process.stdout.read(size) if self._process.stdout else b""
        if len(content) != size:
            raise SystemExit(f"{self.name}'s process ended; what it said is above")
        table = np.frombuffer(content).reshape(len(rows), width)
        v_dot, tau, forces, parts, seconds = np.split(table, self._places, axis=1)
        return Answers(v_dot, tau, forces, parts, seconds[:, 0])


def rival(name: str, scene: Mapping[str, Any]) -> Contestant:
    """A rival, in its environment: one of `RIVALS`."""
    isolated = [str(environment(name)), "-E", "-s"]  # our PYTHONPATH is not for it
    return Contestant(name, isolated, f"{name}_worker.py", scene)


def ours(scene: Mapping[str, Any], name: str = "ours", code: Path = ROOT) -> Contestant:
    """Our cycle, of this commit or of the code in a folder."""
    return Contestant(name, [sys.executable], "our_worker.py", scene, [str(code)])


def floor(scene: Mapping[str, Any]) -> Contestant:
    """What no controller can do without."""
    return Contestant("floor", [sys.executable], "floor_worker.py", scene)


def service(scene: Mapping[str, Any], name: str = "ours", code: Path = ROOT) -> Contestant:
    """Our whole cycle, bytes to bytes, of this commit or of the code in a folder."""
    return Contestant(name, [sys.executable], "service_worker.py", scene, [str(code)])
