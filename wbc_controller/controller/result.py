"""Result of a cycle, with tables and plots."""

import math
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from wbc_controller.controller.visualization.scene import Shape, draw, friction_used
from wbc_controller.controller.visualization.tables import Table, as_html, as_text
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.contacts import UnilateralContact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array, Fault, JointCommand, Mode, References, RobotState, Solution

_NOTHING: Mapping[str, Any] = MappingProxyType({})
_LARGEST_SHOWN = 5  # number of actuators in the table


@dataclass(slots=True, repr=False)  # not frozen: faster construction
class CycleResult:
    """Result of one control cycle. Prints as tables in terminals and notebooks.

    Without a solution of the quadratic program, its values are empty or NaN.
    """

    qp: WholeBodyQP  # with model, tasks and contacts; dynamics of the newest cycle
    time: float  # time of the state, s
    mode: Mode  # after the cycle
    fault: Fault | None  # latched
    command: JointCommand | None  # None if nothing is sent
    solution: Solution | None = None  # before the supervisor
    state: RobotState | None = None
    references: References | None = None  # None without a solve
    refused: tuple[str, ...] = ()  # one sentence per refused request
    stage_seconds: Mapping[str, float] = field(default_factory=lambda: _NOTHING)  # s, by stage

    @property
    def tau(self) -> Array:
        """Torques of the actuators after the supervisor, (na,) in N·m; zero without a command."""
        return np.zeros(self.qp.model.na) if self.command is None else self.command.tau

    @property
    def torques(self) -> dict[str, float]:
        """Torques by actuator, N·m."""
        return dict(zip(self.qp.model.actuators, self.tau.tolist(), strict=True))

    @property
    def v_dot(self) -> Array:
        """Generalized acceleration, (nv,)."""
        return np.full(self.qp.model.nv, np.nan) if self.solution is None else self.solution.v_dot

    @property
    def forces(self) -> Mapping[str, Array]:
        """Contact forces of active contacts in contact coordinates, (3,) for points, (6,) for surfaces, N and N·m."""
        return _NOTHING if self.solution is None else self.solution.forces

    @property
    def wrenches(self) -> dict[str, Array]:
        """Contact wrenches, (6,) in N and N·m, in the axes of the published messages."""
        return {name: self.qp.contacts[name].basis @ force for name, force in self.forces.items()}

    @property
    def task_errors(self) -> Mapping[str, float]:
        """Norm of each task error, in the unit of the reference."""
        return _NOTHING if self.solution is None else self.solution.task_errors

    @property
    def residuals(self) -> Mapping[str, float]:
        """Largest violation of each group of constraints."""
        return _NOTHING if self.solution is None else self.solution.residuals

    @property
    def binding(self) -> Mapping[str, float]:
        """Multiplier of each binding constraint: decrease of the cost per unit of relaxation."""
        return _NOTHING if self.solution is None else self.solution.binding

    @property
    def relaxed(self) -> tuple[str, ...]:
        """Relaxed groups of constraints; normally empty."""
        return () if self.solution is None else self.solution.relaxed

    @property
    def shapes(self) -> list[Shape]:
        """Shapes of contacts, forces, friction cones, support, centre of mass and references; requires a state."""
        if self.state is None:
            raise InputRefused("cannot draw: no state has arrived")
        dynamics = Dynamics(self.qp.model)  # the program's dynamics belong to a newer cycle
        dynamics.update(self.state.q, self.state.v)
        return list(draw(dynamics, self.qp.tasks, self.qp.contacts, self.references, self.forces))

    def plot(self) -> Any:
        """Return a plotly Figure of `shapes` and largest torques; without plotly, raise `ConfigurationError`."""
        from wbc_controller.controller.visualization.plots import plot_cycle

        model = self.qp.model
        shares = dict(zip(model.actuators, (np.abs(self.tau) / model.effort_limits).tolist(), strict=True))
        return plot_cycle(self.shapes, shares, self._heading(), self.binding)

    def friction_used(self) -> dict[str, float]:
        """Return the tangential force of active contacts as a share of the friction limit; NaN if unloaded."""
        return friction_used(self.qp.contacts, self.forces, self.qp.model.mass * self.qp.model.gravity)

    def __repr__(self) -> str:
        return as_text(self._heading(), self._tables())

    def _repr_html_(self) -> str:
        return as_html(self._heading(), self._tables())

    def _heading(self) -> str:
        heading = f"{self.mode.value} at {self.time:.3f} s"
        if self.fault is not None:
            heading += f": {self.fault.code}: {self.fault.sentence}"
        heading += "".join(f"; refused {sentence}" for sentence in self.refused)
        return heading + (f"; relaxed {', '.join(self.relaxed)}" if self.relaxed else "")

    def _tables(self) -> list[Table]:
        model, tau, used = self.qp.model, self.tau, self.friction_used()
        weights = self.references.weights if self.references is not None else {}
        tasks = [
            (name, f"{error:.3g} {self.qp.tasks[name].unit}", f"{weights.get(name, 0.0):g}")
            for name, error in self.task_errors.items()
        ]
        contacts = []
        for name, force in self.forces.items():
            contact = self.qp.contacts[name]
            if isinstance(contact, UnilateralContact):
                share = f"{100.0 * used[name]:.0f} % of µ = {contact.friction:g}" if used[name] >= 0.0 else "not loaded"
                contacts.append((name, f"{force[contact.normal]:.1f} N", share))
            else:
                contacts.append((name, f"‖f‖ = {np.linalg.norm(force):.1f}", ""))
        shares = np.abs(tau) / model.effort_limits
        largest = [i for i in np.argsort(-shares)[:_LARGEST_SHOWN].tolist() if tau[i]]
        torques = [(model.actuators[i], f"{tau[i]:.2f} N·m", f"{100.0 * shares[i]:.0f} %") for i in largest]
        binding = [(name, f"{multiplier:.3g}") for name, multiplier in self.binding.items()]
        return [
            Table(("task", "error", "weight"), tuple(tasks)),
            Table(("contact", "normal force", "friction used"), tuple(contacts)),
            Table(("largest torques", "torque", "of its limit"), tuple(torques)),
            Table(("binding constraint", "multiplier"), tuple(binding)),
        ]


def plot(results: Sequence[CycleResult]) -> Any:
    """Return a plotly Figure of a run: task errors, normal forces, friction, largest torque, binding constraints.

    A missing plotly raises `ConfigurationError`.
    """
    from wbc_controller.controller.visualization.plots import Line, Panel, line_panels

    if not isinstance(results, Sequence) or not all(isinstance(each, CycleResult) for each in results):
        raise InputRefused(f"results = {reprlib.repr(results)}: must be a list of results of cycles")
    if not results:
        raise InputRefused("cannot plot: no results")
    contacts, limits = results[0].qp.contacts, results[0].qp.model.effort_limits
    normal = {name: each.normal for name, each in contacts.items() if isinstance(each, UnilateralContact)}
    normals = [{name: float(f[normal[name]]) for name, f in each.forces.items() if name in normal} for each in results]
    torque = np.array([100.0 * float(np.max(np.abs(each.tau) / limits)) for each in results])
    names = dict.fromkeys(name for each in results for name in each.binding)
    time = np.array([each.time for each in results])
    panels = {
        "task errors": _columns([each.task_errors for each in results]),
        "normal forces, N": _columns(normals),
        "friction used, %": _columns([each.friction_used() for each in results], 100.0),
        "largest torque, % of its limit": {"torque": torque},
    }
    return line_panels(
        [
            Panel("", [Line(name, time, values, group=heading) for name, values in series.items()], heading)
            for heading, series in panels.items()
        ],
        height=180 * (len(panels) + bool(names)) + 120,
        marks={name: np.array([each.time for each in results if name in each.binding]) for name in names},
        title=f"{results[0].qp.model.name}, {results[0].time:.3f} to {results[-1].time:.3f} s",
    )


def _columns(rows: Sequence[Mapping[str, float]], scale: float = 1.0) -> dict[str, Array]:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: scale * np.array([row.get(name, math.nan) for row in rows]) for name in names}
