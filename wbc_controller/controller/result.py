"""What one cycle of the controller led to, and how a person reads it."""

from __future__ import annotations

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
#: Actuators in the table: those with the largest torques, as shares of their limits.
_LARGEST_SHOWN = 5


@dataclass(slots=True, repr=False)  # not frozen, which would take three times as long to make, in every cycle
class CycleResult:
    """The outcome of one control cycle: what goes to the joints, and why.

    It prints itself as tables, in a terminal and in a notebook, and `plot` draws it. What is read from the solution of
    the quadratic program is empty, or NaN, in cycles that have none.

    Attributes:
        qp: the program that was solved: the robot's model, tasks and contacts by name. Its dynamics go on.
        time: of the state, s.
        mode: mode of the supervisor after the cycle.
        fault: why the mode active was left, where it was.
        command: what goes to the joints; None where nothing is to be sent.
        solution: the answer of the quadratic program, before the supervisor; None where there is none.
        state: the state that was answered; None where none has arrived.
        references: what was asked for, in a cycle that was solved.
        refused: a sentence for each request that was refused in this cycle.
        stage_seconds: time spent in each stage, s.
    """

    qp: WholeBodyQP
    time: float
    mode: Mode
    fault: Fault | None
    command: JointCommand | None
    solution: Solution | None = None
    state: RobotState | None = None
    references: References | None = None
    refused: tuple[str, ...] = ()
    stage_seconds: Mapping[str, float] = field(default_factory=lambda: _NOTHING)

    @property
    def tau(self) -> Array:
        """Torques of the actuators after the supervisor, (na,) in N·m; zero where nothing is to be sent."""
        return np.zeros(self.qp.model.na) if self.command is None else self.command.tau

    @property
    def torques(self) -> dict[str, float]:
        """The same by name of the actuator, N·m."""
        return dict(zip(self.qp.model.actuators, self.tau.tolist(), strict=True))

    @property
    def v_dot(self) -> Array:
        """Generalized acceleration, (nv,)."""
        return np.full(self.qp.model.nv, np.nan) if self.solution is None else self.solution.v_dot

    @property
    def forces(self) -> Mapping[str, Array]:
        """What each active contact bears, in its own coordinates, (k,) in N and N·m: 3 of a point, 6 of a surface."""
        return _NOTHING if self.solution is None else self.solution.forces

    @property
    def wrenches(self) -> dict[str, Array]:
        """The same as wrenches, (6,) in N and N·m, force first, in the axes in which they are published."""
        return {name: self.qp.contacts[name].basis @ force for name, force in self.forces.items()}

    @property
    def task_errors(self) -> Mapping[str, float]:
        """Norm of each task's error, in the unit of its reference."""
        return _NOTHING if self.solution is None else self.solution.task_errors

    @property
    def residuals(self) -> Mapping[str, float]:
        """Largest violation of each group of constraints."""
        return _NOTHING if self.solution is None else self.solution.residuals

    @property
    def binding(self) -> Mapping[str, float]:
        """The binding constraints, each with its multiplier: by how much the cost would fall per unit of its bound."""
        return _NOTHING if self.solution is None else self.solution.binding

    @property
    def relaxed(self) -> tuple[str, ...]:
        """Groups of constraints that were relaxed so that a solution exists; normally empty."""
        return () if self.solution is None else self.solution.relaxed

    @property
    def shapes(self) -> list[Shape]:
        """What can be drawn of the cycle: contacts, forces, friction cones, support, centre of mass, references.

        Raises:
            InputRefused: if no state has arrived.
        """
        if self.state is None:
            raise InputRefused("there is nothing to draw: no state has arrived")
        dynamics = Dynamics(self.qp.model)  # that of the program has gone on
        dynamics.update(self.state.q, self.state.v)
        return list(draw(dynamics, self.qp.tasks, self.qp.contacts, self.references, self.forces))

    def plot(self) -> Any:
        """Draw contact forces, friction cones, support, centre of mass, and the torques as shares of their limits.

        Returns:
            A plotly Figure; a notebook shows it, `show()` opens it in a browser.

        Raises:
            ConfigurationError: where plotly is not installed.
            InputRefused: if no state has arrived.
        """
        from wbc_controller.controller.visualization.plots import plot_cycle

        model = self.qp.model
        shares = dict(zip(model.actuators, (np.abs(self.tau) / model.effort_limits).tolist(), strict=True))
        return plot_cycle(self.shapes, shares, self._heading(), self.binding)

    def friction_used(self) -> dict[str, float]:
        """Of each active contact with a friction cone the tangential force, as a share of what friction allows.

        NaN where a contact bears next to nothing.
        """
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
        return [
            Table(("task", "error", "weight"), tuple(self._task_rows())),
            Table(("contact", "normal force", "friction used"), tuple(self._contact_rows())),
            Table(("largest torques", "torque", "of its limit"), tuple(self._torque_rows())),
            Table(("binding constraint", "multiplier"), tuple((n, f"{m:.3g}") for n, m in self.binding.items())),
        ]

    def _task_rows(self) -> list[tuple[str, ...]]:
        weights = self.references.weights if self.references is not None else {}
        return [
            (name, f"{error:.3g} {self.qp.tasks[name].unit}", f"{weights.get(name, 0.0):g}")
            for name, error in self.task_errors.items()
        ]

    def _contact_rows(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = []
        used = self.friction_used()
        for name, force in self.forces.items():
            contact = self.qp.contacts[name]
            if isinstance(contact, UnilateralContact):
                share = f"{100.0 * used[name]:.0f} % of µ = {contact.friction:g}" if used[name] >= 0.0 else "not loaded"
                rows.append((name, f"{force[contact.normal]:.1f} N", share))
            else:
                rows.append((name, f"‖f‖ = {math.sqrt(float(force @ force)):.1f}", ""))
        return rows

    def _torque_rows(self) -> list[tuple[str, ...]]:
        model, tau = self.qp.model, self.tau
        shares = np.abs(tau) / model.effort_limits
        order = np.argsort(-shares)[:_LARGEST_SHOWN].tolist()
        return [(model.actuators[i], f"{tau[i]:.2f} N·m", f"{100.0 * shares[i]:.0f} %") for i in order if tau[i]]


def plot(results: Sequence[CycleResult]) -> Any:
    """Draw a run over time: task errors, normal forces, friction used, the largest torque, and what was binding when.

    Args:
        results: of the cycles, such as `Simulation.run` gives them.

    Returns:
        A plotly Figure; a notebook shows it, `show()` opens it in a browser.

    Raises:
        ConfigurationError: where plotly is not installed.
        InputRefused: if there is no result.
    """
    from wbc_controller.controller.visualization.plots import Line, Panel, line_panels

    if not isinstance(results, Sequence) or not all(isinstance(each, CycleResult) for each in results):
        raise InputRefused(f"results is {reprlib.repr(results)}; it must be a list of results of cycles")
    if not results:
        raise InputRefused("there is nothing to plot: no results")
    contacts = results[0].qp.contacts
    normals = [
        {
            name: float(f[c.normal])
            for name, f in each.forces.items()
            if isinstance(c := contacts[name], UnilateralContact)
        }
        for each in results
    ]
    limits = results[0].qp.model.effort_limits
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
    """Series by name from the values of each cycle; NaN where there is none."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: scale * np.array([row.get(name, math.nan) for row in rows]) for name in names}
