"""Data of a report: arrays over samples."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.records import Array
from wbc_controller.settings.contacts import ContactSettings


@dataclass(frozen=True, slots=True)
class Result:
    """One line of the verdict."""

    name: str
    target: str
    measured: str
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class RunData:
    """Arrays of a run: n samples, m cycles, na actuators."""

    robot: str
    actuators: tuple[str, ...]  # in the order of the command
    time: Array  # since the first sample, (n,) in s, non-decreasing
    q: Array  # Pinocchio configuration, (n, nq)
    tau: Array  # commanded torques, (n, na) in N·m
    effort_limits: Array  # (na,) in N·m
    com: Array  # centre of mass in the world, (n, 3) in m
    com_reference: Array  # (n, 3) in m; NaN without a reference
    disturbance: Array  # vertical force of the disturbance on the base, (n,) in N; NaN without a solution
    task_errors: Mapping[str, Array] = field(default_factory=dict)  # norms, (n,) in m or rad; NaN while disabled
    #: By contact, a wrench in its frame, (n, 6), or a force along the world's axes, (n, 3), in N and N·m; NaN or zero
    #: while inactive. Solution, and truth of a simulation.
    contact_wrenches: Mapping[str, Array] = field(default_factory=dict)
    true_wrenches: Mapping[str, Array] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)  # Coulomb coefficient by contact
    cycle_seconds: Array = field(default_factory=lambda: np.zeros(0))  # duration of each cycle, (m,) in s
    stage_seconds: Mapping[str, Array] = field(default_factory=dict)  # part of each stage, (m,) in s
    phases: tuple[tuple[float, str], ...] = ()  # starts of the phases since the start of the run, s, and names
    results: tuple[Result, ...] = ()
    modes: tuple[tuple[float, str], ...] = ()  # changes of the supervisor's mode, (time in s, mode)
    contacts: Mapping[str, ContactSettings] = field(default_factory=dict)  # drawn contacts
    #: Model audit, (n,): ``energy`` in W, ``force`` in N, NaN without an audit, and number of ``warnings``.
    audit: Mapping[str, Array] = field(default_factory=dict)
    start: float = 0.0  # stamp of the first sample, s
    stride: int = 1  # cycles per sample

    @property
    def duration(self) -> float:
        """Length of the run, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def spans(self) -> list[tuple[float, float, str]]:
        """Start, end and name of each phase."""
        starts = [start for start, _ in self.phases]
        ends = [*starts[1:], float(self.time[-1])]
        return [(start, end, name) for (start, name), end in zip(self.phases, ends, strict=False)]


def mean_velocity(way: Array, begin: float, end: float) -> Array:
    """Return the mean velocity in the heading between two times in s, (3,) in m/s and rad/s.

    `way`: times in s, x and y in m and heading in rad, (n, 4).
    """
    part = way[(way[:, 0] >= begin) & (way[:, 0] <= end)]
    headings = np.unwrap(part[:, 3])
    steps = np.diff(part[:, 1] + 1j * part[:, 2]) * np.exp(-0.5j * (headings[1:] + headings[:-1]))
    moved = steps.sum()
    change = np.array([moved.real, moved.imag, headings[-1] - headings[0]])
    return change / float(part[-1, 0] - part[0, 0])


def heading(q: Array) -> float:
    """Return the heading of a floating base, rad."""
    x, y, z, w = q[3:7].tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
