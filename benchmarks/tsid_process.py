"""tsid in an environment and a process of its own: its wheels need other releases of the same libraries than ours."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.core.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings import Settings, SurfaceContact
from wbc_controller.settings.resources import locate

#: What these wheels were built against; later ones of the last two no longer fit.
REQUIREMENTS = ("tsid==1.7.1", "pin==3.4.0", "cmeel-urdfdom==4.0.1", "cmeel-tinyxml2<11")
ENVIRONMENT = Path(__file__).resolve().parents[1] / ".venv-tsid"


def environment() -> Path:
    """Python of tsid's environment, made where there is none.

    Raises:
        SystemExit: where the wheels cannot be installed.
    """
    python, done = ENVIRONMENT / "bin" / "python", ENVIRONMENT / "installed"
    if not (done.is_file() and done.read_text(encoding="utf-8") == " ".join(REQUIREMENTS)):
        print(f"Preparing {ENVIRONMENT.name} for tsid: half a gigabyte on disk, once.", file=sys.stderr)
        install = ["-m", "pip", "install", "--disable-pip-version-check", "--quiet", "--only-binary", ":all:"]
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", ENVIRONMENT], check=True)  # noqa: S603
            subprocess.run([python, *install, *REQUIREMENTS], check=True)  # noqa: S603
        except subprocess.CalledProcessError as error:
            release = ".".join(map(str, sys.version_info[:2]))
            raise SystemExit(f"tsid could not be installed for Python {release} (the command above failed)") from error
        done.write_text(" ".join(REQUIREMENTS), encoding="utf-8")
    return python


class Tsid:
    """tsid with the tasks `com`, `posture` and `waist`, the surface contacts and the torque limits of some settings.

    Attributes:
        unknowns: size of its problem.
        equalities: likewise.
        inequalities: likewise.
    """

    def __init__(
        self,
        settings: Settings,
        model: RobotModel,
        q: Array,
        weights: Mapping[str, float],
        *,
        stiffness: float,
        damping: float,
        waist: str,
    ) -> None:
        """Start the process.

        Args:
            settings: the robot's settings, for its URDF and contacts.
            model: the robot's model.
            q: where the references of posture and waist are, and the contacts' anchors, (nq,).
            weights: of `com`, `posture`, `waist` and `force`, the last one that of the forces' regularization.
            stiffness: of every task, 1/s².
            damping: of every task, 1/s.
            waist: frame whose orientation the task `waist` holds.
        """
        pinocchio = model.pinocchio
        scene: dict[str, Any] = {
            "urdf": str(locate(settings.robot.urdf)),
            "locked": _locked(model),
            "names": list(pinocchio.names),
            "armature": np.array(pinocchio.armature).tolist(),
            "q": q.tolist(),
            "effort_limits": np.array(pinocchio.upperEffortLimit)[6:].tolist(),
            "weights": dict(weights),
            "stiffness": stiffness,
            "damping": damping,
            "waist": waist,
            "contacts": [
                contact.model_dump() | {"name": name}
                for name, contact in settings.contacts.items()
                if isinstance(contact, SurfaceContact)
            ],
        }
        worker = Path(__file__).with_name("tsid_worker.py")
        self._process = subprocess.Popen([environment(), "-I", worker], stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
        self._nv = model.nv
        self._feet = list(settings.contacts)
        self._width = 2 * model.nv - 6 + 6 * len(self._feet) + 1
        self._send((json.dumps(scene) + "\n").encode())
        line = self._process.stdout.readline() if self._process.stdout else b""
        if not line:
            raise SystemExit("tsid's process ended before it was ready; what it said is above")
        self.unknowns, self.equalities, self.inequalities = json.loads(line)

    def __enter__(self) -> Tsid:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate()  # closes its input, on which it ends

    def _send(self, content: bytes) -> None:
        if self._process.stdin is not None:
            self._process.stdin.write(content)
            self._process.stdin.flush()

    def solve(self, rows: Array) -> tuple[Array, Array, Array, Array]:
        """Answer states.

        Args:
            rows: q, v, and the centre of mass's reference position, velocity and acceleration, (n, nq + nv + 9).

        Returns:
            v̇ (n, nv), τ in the order of the model (n, nv - 6), the wrenches about the contacts' frames
            (n, contacts, 6), and the seconds that each took (n,). NaN where tsid found no solution.
        """
        rows = np.ascontiguousarray(np.atleast_2d(rows), dtype=np.float64)
        self._send(struct.pack("<q", len(rows)) + rows.tobytes())
        size = 8 * len(rows) * self._width
        content = self._process.stdout.read(size) if self._process.stdout else b""
        if len(content) != size:
            raise SystemExit("tsid's process ended; what it said is above")
        table = np.frombuffer(content).reshape(len(rows), self._width)
        nv = self._nv
        wrenches = table[:, 2 * nv - 6 : -1].reshape(len(rows), len(self._feet), 6)
        return table[:, :nv], table[:, nv : 2 * nv - 6], wrenches, table[:, -1]


def _locked(model: RobotModel) -> list[str]:
    """Movable joints of the URDF that the model does not actuate."""
    names = pin.buildModelFromXML(model.urdf, pin.JointModelFreeFlyer()).names
    return [name for name in names if name not in set(model.pinocchio.names)]
