"""Contestants as processes, with their environments."""

import io
import json
import struct
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from wbc_controller.records import Array

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
#: Requirements of the rivals' wheels, which need other library versions than ours.
REQUIREMENTS = {
    "tsid": ("tsid==1.7.1", "pin==3.4.0", "cmeel-urdfdom==4.0.1", "cmeel-tinyxml2<11"),
    "placo": ("placo==0.10.2", "pin==3.8.0", "cmeel-urdfdom==4.0.1", "cmeel-tinyxml2<11"),
}
RIVALS = tuple(REQUIREMENTS)


def environment(rival: str) -> Path:
    """Return the Python of a rival's environment, and create it if required.

    Raises:
        SystemExit: if the wheels cannot be installed.
    """
    folder, requirements = ROOT / f".venv-{rival}", REQUIREMENTS[rival]
    python, done = folder / "bin" / "python", folder / "installed"
    if not (done.is_file() and done.read_text(encoding="utf-8") == " ".join(requirements)):
        print(f"Preparing {folder.name} for {rival}, once; it needs 0.5 GB of disk space.", file=sys.stderr)
        install = ["-m", "pip", "install", "--disable-pip-version-check", "--quiet", "--only-binary", ":all:"]
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True)  # noqa: S603
            subprocess.run([python, *install, *requirements], check=True)  # noqa: S603
        except subprocess.CalledProcessError as error:
            release = ".".join(map(str, sys.version_info[:2]))
            raise SystemExit(
                f"installation of {rival} for Python {release} failed (see above); "
                "choose other rivals with --rivals, or --rivals none"
            ) from error
        done.write_text(" ".join(requirements), encoding="utf-8")
    return python


@contextmanager
def code_of(commit: str) -> Iterator[Path]:
    """Yield a temporary folder with the files of a commit.

    Raises:
        SystemExit: if the commit does not exist.
    """
    git = ["git", "-C", str(ROOT)]
    known = subprocess.run(  # noqa: S603
        [*git, "rev-parse", "--quiet", "--verify", "--end-of-options", f"{commit}^{{commit}}"], capture_output=True
    )
    if known.returncode:
        raise SystemExit(f"--against: unknown commit {commit!r}; valid commits: `git log --oneline`")
    archive = subprocess.run([*git, "archive", known.stdout.decode().strip()], check=True, capture_output=True)  # noqa: S603
    with TemporaryDirectory(prefix="wbc_bench_") as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
            files.extractall(folder, filter="data")
        yield Path(folder)


@dataclass(frozen=True)
class Answers:
    """Answers of a contestant; NaN without a solution."""

    v_dot: Array  # accelerations, (n, nv)
    tau: Array  # joint torques in the order of the model, (n, nv - 6)
    forces: Array  # contact forces in their frames, of points in the world, (n, forces)
    parts: Array  # time of each part, (n, parts) in s
    seconds: Array  # time of the whole cycle, (n,) in s


class Contestant:
    """Process of a worker.

    Attributes:
        name: name in the table.
        hello: description of the worker: `serving.Contestant.hello`.
    """

    def __init__(
        self, name: str, python: Sequence[str], worker: str, scene: Mapping[str, Any], arguments: Sequence[str] = ()
    ) -> None:
        """Start a worker, a file of this folder, with its arguments and scene, and wait until it is ready.

        `python` is the interpreter with its options.

        Raises:
            SystemExit: if the process ends early.
        """
        self.name = name
        command = [*python, str(HERE / worker), *arguments]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
        self._send((json.dumps(scene) + "\n").encode())
        line = self._process.stdout.readline() if self._process.stdout else b""
        if not line:
            self._process.communicate()
            raise SystemExit(f"the process of {name} ended before it was ready; see its output above")
        self.hello: dict[str, Any] = json.loads(line)
        self._places = np.cumsum([*self.hello["sizes"], len(self.hello["parts"])])

    def __enter__(self) -> "Contestant":
        return self

    def __exit__(self, *error: object) -> None:
        self._process.communicate()  # the process ends after its input is closed

    def _send(self, content: bytes) -> None:
        if self._process.stdin is not None:
            with suppress(BrokenPipeError):  # the process has ended, which reading reports
                self._process.stdin.write(content)
                self._process.stdin.flush()

    def solve(self, rows: Array, touched: int = 0) -> Answers:
        """Return the answers to states, in order.

        Args:
            rows: q, v, and reference position, velocity and acceleration of the centre of mass, (n, nq + nv + 9).
            touched: bytes of other memory written before each cycle.

        Raises:
            SystemExit: if the process has ended.
        """
        rows = np.ascontiguousarray(np.atleast_2d(rows), dtype=np.float64)
        self._send(struct.pack("<qq", len(rows), touched) + rows.tobytes())
        width = int(self._places[-1]) + 1
        size = 8 * len(rows) * width
        content = self._process.stdout.read(size) if self._process.stdout else b""
        if len(content) != size:
            raise SystemExit(f"the process of {self.name} ended; see its output above")
        table = np.frombuffer(content).reshape(len(rows), width)
        v_dot, tau, forces, parts, seconds = np.split(table, self._places, axis=1)
        return Answers(v_dot, tau, forces, parts, seconds[:, 0])


def rival(name: str, scene: Mapping[str, Any]) -> "Contestant":
    """Return a rival of `RIVALS` in its environment."""
    isolated = [str(environment(name)), "-E", "-s"]  # without our PYTHONPATH
    return Contestant(name, isolated, f"{name}_worker.py", scene)


def ours(scene: Mapping[str, Any], name: str = "ours", code: Path = ROOT) -> "Contestant":
    """Return our cycle, of this commit or of the code in a folder."""
    return Contestant(name, [sys.executable], "our_worker.py", scene, [str(code)])


def floor(scene: Mapping[str, Any]) -> "Contestant":
    """Return the lower bound of any controller."""
    return Contestant("floor", [sys.executable], "floor_worker.py", scene)


def service(scene: Mapping[str, Any], name: str = "ours", code: Path = ROOT) -> "Contestant":
    """Return our whole cycle with messages, of this commit or of the code in a folder."""
    return Contestant(name, [sys.executable], "service_worker.py", scene, [str(code)])
