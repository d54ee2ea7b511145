"""Data of a report: one record of arrays over the samples of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.contacts import placement_of
from wbc_controller.records import Array, frozen
from wbc_controller.settings import ContactSettings, SurfaceContact


@dataclass(frozen=True, slots=True)
class Phase:
    """A phase of a run, which lasts until the next one."""

    time: float  # start of the phase since the start of the run, s
    name: str


@dataclass(frozen=True, slots=True)
class Result:
    """One line of the verdict."""

    name: str
    target: str  # its target, as readable text
    measured: str  # its measured value, as readable text
    passed: bool  # True if the target was met


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Placement of a contact on the robot, for drawing its forces."""

    frame: str  # frame of the URDF that carries the contact
    placement: Array  # position and quaternion of the contact in that frame, (7,)
    corners: Array  # corners of the support in the contact's axes, (m, 3) in m


@dataclass(frozen=True, slots=True, eq=False)
class RunData:
    """Arrays over the samples of a run: n samples of the state, m cycles of the controller, na actuators."""

    robot: str
    actuators: tuple[str, ...]  # names of the actuators, in the order of the command
    time: Array  # time since the first sample, (n,) in s; never decreases
    q: Array  # Pinocchio configuration, (n, nq)
    tau: Array  # commanded torques, (n, na) in N·m
    effort_limits: Array  # effort limits, (na,) in N·m
    com: Array  # centre of mass in the world, (n, 3) in m
    com_reference: Array  # reference of the centre of mass, (n, 3) in m; NaN without a reference
    #: Vertical force on the base by the disturbance of the solution, (n,) in N; NaN without a solution.
    disturbance: Array
    #: Per task, the norm of its error, (n,) in m or rad; NaN while the task is disabled.
    task_errors: Mapping[str, Array] = field(default_factory=dict)
    #: Per contact, its force or wrench in the solution, (n, k) in N and N·m: a wrench in the contact's frame, force
    #: first (k = 6), or a force along the world's axes (k = 3). NaN or zero while inactive.
    contact_wrenches: Mapping[str, Array] = field(default_factory=dict)
    #: Per contact, the true force or wrench of a simulation, in the same form.
    true_wrenches: Mapping[str, Array] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)  # per contact, its Coulomb coefficient
    #: Duration of each cycle of the controller, (m,) in s.
    cycle_seconds: Array = field(default_factory=lambda: np.zeros(0))
    stage_seconds: Mapping[str, Array] = field(default_factory=dict)  # per stage, its part of this duration, (m,) in s
    phases: tuple[Phase, ...] = ()  # the phases of the run
    results: tuple[Result, ...] = ()
    modes: tuple[tuple[float, str], ...] = ()  # changes of the supervisor's mode, (time in s, mode)
    #: Per contact, its placement on the robot; contacts without an entry are not drawn.
    supports: Mapping[str, Support] = field(default_factory=dict)
    #: Results of the model audit by name, each (n,): ``energy`` in W, ``force`` in N, NaN without an audit, and the
    #: number of ``warnings``.
    audit: Mapping[str, Array] = field(default_factory=dict)
    start: float = 0.0  # stamp of the first sample, s
    stride: int = 1  # cycles of the controller per sample

    @property
    def duration(self) -> float:
        """Length of the run, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def spans(self) -> list[tuple[float, float, str]]:
        """Start, end and name of each phase; the last one ends with the run."""
        starts = [phase.time for phase in self.phases]
        ends = [*starts[1:], float(self.time[-1])]
        return [(start, end, phase.name) for start, end, phase in zip(starts, ends, self.phases, strict=False)]


def supports_of(contacts: Mapping[str, ContactSettings]) -> dict[str, Support]:
    """Collect the placement of each contact of a configuration on the robot.

    Args:
        contacts: the section ``contacts`` of the robot's settings.
    """
    supports = {}
    for name, contact in contacts.items():
        shape = contact.corners if isinstance(contact, SurfaceContact) else [[0.0, 0.0]]
        corners = frozen([[*corner, 0.0] for corner in shape])
        placement = pin.SE3ToXYZQUAT(placement_of(contact.translation, getattr(contact, "rpy", (0.0, 0.0, 0.0))))
        supports[name] = Support(contact.frame, frozen(placement), corners)
    return supports
