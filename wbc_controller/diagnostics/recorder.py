"""Records states, torques, forces, modes, times and audits of the last cycles, and saves them to a file at the end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.records import CycleReport

#: Columns of ``audit``.
AUDIT_COLUMNS = ("energy", "throughput", "force", "torque", "warnings")
#: Cycles that are kept: 10 minutes at 500 Hz, about 400 MB with 30 actuators.
MOST_CYCLES = 300_000


@contextlib.contextmanager
def recording(path: Path | None) -> Iterator[tuple[Callable[[CycleReport], None], ...]]:
    """Record a run to a file: gives the observers of its cycles, none without a file, and saves them at the end.

    A run without a command leaves no file.

    Raises:
        WbcError: if the file cannot be written; found out before the run, or for a disk that is full, at its end.
    """
    if path is None:
        yield ()
        return
    with _translated(path):
        new = not path.exists()
        path.open("ab").close()
        if new:
            path.unlink()
    recorder = CycleRecorder()
    try:
        yield (recorder.add,)
    finally:
        if recorder.count:
            recorder.save(path)


class CycleRecorder:
    """Collects the torques, times and audits of the last cycles that sent a command.

    Args:
        most: number of cycles that are kept; the memory that they take is reserved as they come.

    Attributes:
        count: number of cycles that sent a command.
    """

    def __init__(self, most: int = MOST_CYCLES) -> None:
        self._most = most
        self.count = 0
        self._columns: dict[str, np.ndarray] = {}

    def add(self, report: CycleReport) -> None:
        """Add the report of a cycle."""
        if report.command is None:
            return
        audit = report.audit
        row: dict[str, Any] = {
            "stamp": np.int64(report.command.stamp),
            "tau": report.command.tau,
            "mode": np.array(report.mode.value, dtype="U16"),
            "audit": np.array(
                (np.nan, np.nan, np.nan, np.nan, 0.0)
                if audit is None
                else (
                    audit.energy,
                    audit.throughput,
                    np.linalg.norm(audit.force),
                    np.max(np.abs(audit.joint_torques)),
                    len(audit.warnings),
                )
            ),
        }
        if report.state is not None:
            row |= {"q": report.state.q, "v": report.state.v}
        if report.solution is not None:
            row |= {f"force/{contact}": force for contact, force in report.solution.forces.items()}
        row |= {f"seconds/{stage}": np.float64(seconds) for stage, seconds in report.stage_seconds.items()}
        i = self.count % self._most
        for name in self._columns.keys() - row.keys():
            self._columns[name][i] = np.nan
        for name, value in row.items():
            if name not in self._columns:
                # Zeros take no memory until something else is written over them.
                self._columns[name] = np.zeros((self._most, *value.shape), dtype=value.dtype)
                if self.count:
                    self._columns[name][: min(self.count, self._most)] = np.nan
            self._columns[name][i] = value
        self.count += 1

    def save(self, path: Path) -> None:
        """Write an .npz file.

        It holds stamp (n,) in ns, tau (n, na) in N·m, mode (n,), seconds/<stage> (n,) in s, and audit (n, 5) with the
        columns of `AUDIT_COLUMNS`: energy residual and throughput in W, unexplained force in N, largest unexplained
        joint torque in N·m, and the number of warnings; q (n, nq) and v (n, nv), the states that were answered; and
        force/<contact> (n, k) in N and N·m, its force in the solution. Without an audit the residuals are NaN, as is
        all that a cycle had not: a state, the force of a contact that was not active, the time of a stage. Without
        cycles it is empty.

        Raises:
            WbcError: if the file cannot be written; none is left then.
        """
        oldest = self.count % self._most if self.count > self._most else 0
        columns = {name: column[: self.count] for name, column in self._columns.items()}
        if oldest:
            columns = {name: np.roll(column, -oldest, axis=0) for name, column in columns.items()}
        try:
            # Through an open file, because numpy would append .npz to another suffix.
            with _translated(path), path.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **columns)
        except WbcError:
            if path.is_file():
                path.unlink()
            raise


@contextlib.contextmanager
def _translated(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise WbcError(f"the record {str(path)!r} cannot be written: {error.strerror or error}") from error
