"""The whole-body controller: from a state and references to accelerations, torques and contact forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from wbc_controller.core.contacts import Contact
from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.infeasibility import explain
from wbc_controller.core.limits import JointMotionLimit, TorqueLimit
from wbc_controller.core.model import RobotModel
from wbc_controller.core.problem import FORCE_UNIT, Layout, QuadraticProgram
from wbc_controller.core.solvers import Solver, make_solver
from wbc_controller.core.tasks import Task
from wbc_controller.errors import NoSolution
from wbc_controller.records import Array, Infeasibility, References, RobotState, Solution, frozen, frozen_mapping

#: Length that makes a rate of angular momentum comparable to one of linear momentum in the regularization, m.
ROTATION_LENGTH = 0.1
#: Distance from a bound, relative to its size (at least 1), within which a constraint counts as binding.
_BINDING = 1.0e-5


class Controller:
    """Solves one quadratic program per cycle (S10 as equality constraints, S12).

    Minimize, over v̇, τ and f,

        ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖²

    subject to the equations of motion M v̇ + h = Sᵀτ + Σ Jᵢᵀfᵢ + Σ Jₖᵀwₖ, the contacts' motion J v̇ + J̇v = -D J v, the
    contacts' wrench cones, and the limits of the joints. Here q̈ are the joints' accelerations and ḣ_G is the rate of
    the momentum about the centre of mass: together they determine v̇, and unlike ‖v̇‖² they do not depend on which link
    the coordinates take for the base (S2). Building the problem (`build`) is apart from solving it
    (`solve`).

    Attributes:
        model: the robot's model.
        dynamics: the snapshot of the last cycle.
        tasks: the tasks, by name.
        contacts: the contacts, by name.
    """

    def __init__(
        self,
        model: RobotModel,
        tasks: Sequence[Task],
        contacts: Sequence[Contact],
        torque_limit: TorqueLimit,
        motion_limit: JointMotionLimit,
        *,
        period: float,
        solver: str = "daqp",
        regularization_acceleration: float = 1.0e-5,
        regularization_force: float = 1.0e-6,
        timer: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """Make a controller.

        Args:
            model: the robot's model.
            tasks: what is wanted.
            contacts: what may carry force.
            torque_limit: bounds of the torques.
            motion_limit: bounds of the joints' accelerations.
            period: time between cycles, s.
            solver: name of the solver.
            regularization_acceleration: ε_a.
            regularization_force: ε_f.
            timer: gives seconds, for the stage times; by default no time passes.

        Raises:
            ConfigurationError: where the solver is not installed.
        """
        self.model = model
        self.dynamics = Dynamics(model)
        self.tasks: Mapping[str, Task] = {task.name: task for task in tasks}
        self.contacts: Mapping[str, Contact] = {contact.name: contact for contact in contacts}
        self.torque_limit = torque_limit
        self.motion_limit = motion_limit
        self.period = period
        self._solver_name = solver
        self._regularization_acceleration = regularization_acceleration
        self._regularization_force = regularization_force
        self._timer = timer
        self._layouts: dict[tuple[str, ...], tuple[Layout, Solver]] = {}
        self._joint_columns = np.arange(6 if model.floating_base else 0, model.nv)
        self._momentum_scale = np.repeat([1.0, 1.0 / ROTATION_LENGTH], 3)[:, None] / model.mass
        rows = sum(task.dimension for task in tasks) + 6
        self._task_rows = np.zeros((rows, model.nv))
        self._task_right = np.zeros(rows)
        self._task_errors: dict[str, float] = {}
        self._layout(tuple(self.contacts))

    def _layout(self, names: tuple[str, ...]) -> tuple[Layout, Solver]:
        """Problem and solver for one set of made contacts; each keeps its warm start."""
        if names not in self._layouts:
            layout = Layout(self.model, [self.contacts[name] for name in names])
            self._layouts[names] = layout, make_solver(self._solver_name, layout.problem)
        return self._layouts[names]

    def build(self, state: RobotState, references: References, tau_before: Array | None = None) -> Layout:
        """Compute the dynamics and fill the problem.

        Args:
            state: where the robot is.
            references: what is wanted.
            tau_before: the torques that the joints have now, (na,) in N·m, where the torque rate is to be held.

        Returns:
            The layout, whose `problem` is ready to be solved, looked at or dumped.
        """
        self.dynamics.update(state.q, state.v)
        made = tuple(name for name in self.contacts if references.contacts.get(name, 0.0) > 0.0)
        layout, _ = self._layout(made)
        self._fill_cost(layout, references)
        self._fill_equations_of_motion(layout, references, tau_before)
        self._fill_contacts(layout, references)
        self._fill_joint_motion(layout)
        return layout

    def _fill_cost(self, layout: Layout, references: References) -> None:
        problem, dynamics, nv = layout.problem, self.dynamics, self.model.nv
        row = 0
        self._task_errors = {}
        for name, task in self.tasks.items():
            weight = references.weights.get(name, 0.0)
            if weight <= 0.0:
                continue
            J, right, error = task.equation(dynamics, references.tasks[name])
            end = row + task.dimension
            scale = weight**0.5
            np.multiply(J, scale, out=self._task_rows[row:end])
            np.multiply(right, scale, out=self._task_right[row:end])
            self._task_errors[name] = error
            row = end
        row = self._regularize_momentum(row)
        rows, right = self._task_rows[:row], self._task_right[:row]
        H = problem.H
        np.matmul(rows.T, rows, out=H[:nv, :nv])
        diagonal = H.reshape(-1)[:: len(H) + 1]
        diagonal[self._joint_columns] += self._regularization_acceleration
        diagonal[nv:] = self._regularization_force * FORCE_UNIT**2
        np.matmul(rows.T, right, out=problem.g[:nv])
        np.negative(problem.g[:nv], out=problem.g[:nv])

    def _regularize_momentum(self, row: int) -> int:
        """Add the rows of √ε_a ḣ_G / m, for a base that moves; gives the number of rows filled."""
        if not self.model.floating_base:
            return row
        scale = self._regularization_acceleration**0.5 * self._momentum_scale
        np.multiply(self.dynamics.centroidal_matrix, scale, out=self._task_rows[row : row + 6])
        np.multiply(-self.dynamics.centroidal_drift, scale[:, 0], out=self._task_right[row : row + 6])
        return row + 6

    def _fill_equations_of_motion(self, layout: Layout, references: References, tau_before: Array | None) -> None:
        problem, dynamics, model = layout.problem, self.dynamics, self.model
        for contact, columns in zip(layout.contacts, layout.forces, strict=True):
            rows = slice(columns.start - model.nv, columns.stop - model.nv)
            layout.J[rows] = contact.jacobian(dynamics)
        h = self._h(references)
        unactuated, floating, torque = layout.unactuated, layout.floating, layout.torque
        accelerations, forces = layout.acceleration_columns, layout.force_columns
        problem.A[floating, accelerations] = dynamics.M[unactuated]
        problem.A[floating, forces] = -FORCE_UNIT * layout.J[:, unactuated].T
        problem.b[floating] = -h[unactuated]
        problem.C[torque, accelerations] = dynamics.M[model.v_index]
        problem.C[torque, forces] = -FORCE_UNIT * layout.J[:, model.v_index].T
        lower, upper = self.torque_limit.bounds(tau_before, self.period)
        problem.lower[torque] = lower - h[model.v_index]
        problem.upper[torque] = upper - h[model.v_index]

    def _h(self, references: References) -> Array:
        """Bias forces less the generalized forces of the known external wrenches (equation (22); S4)."""
        if not references.external_wrenches:
            return self.dynamics.h
        h = np.array(self.dynamics.h)
        for frame, wrench in references.external_wrenches.items():
            h -= self.dynamics.external_force(frame, wrench)
        return h

    def _fill_contacts(self, layout: Layout, references: References) -> None:
        problem, dynamics = layout.problem, self.dynamics
        for contact, columns, rows in zip(layout.contacts, layout.forces, layout.motion, strict=True):
            J = layout.J[columns.start - self.model.nv : columns.stop - self.model.nv]
            problem.A[rows, layout.acceleration_columns] = J
            problem.b[rows] = -contact.drift(dynamics) - contact.damping * (J @ dynamics.v)
            lower, upper = contact.bounds(references.contacts[contact.name])
            problem.x_lower[columns] = lower / FORCE_UNIT
            problem.x_upper[columns] = upper / FORCE_UNIT

    def _fill_joint_motion(self, layout: Layout) -> None:
        problem, dynamics, model = layout.problem, self.dynamics, self.model
        lower, upper = self.motion_limit.bounds(dynamics.q[model.q_index], dynamics.v[model.v_index], self.period)
        problem.x_lower[layout.joints] = lower
        problem.x_upper[layout.joints] = upper

    def solve(
        self,
        state: RobotState,
        references: References,
        tau_before: Array | None = None,
        explained: bool = True,
    ) -> Solution:
        """Compute one answer.

        Where the limits of joint motion leave no solution they are relaxed, then the torque rate; the solution says so.

        Args:
            state: where the robot is.
            references: what is wanted.
            tau_before: the torques that the joints have now, (na,) in N·m, where the torque rate is to be held.
            explained: find out which constraints conflict where there is no solution. It takes several periods.

        Raises:
            NoSolution: where the equations of motion, contacts and torque limits cannot be met together, or where a
                value is not finite.
        """
        started = self._timer()
        layout = self.build(state, references, tau_before)
        built = self._timer()
        solver = self._layouts[layout.key][1]
        problem = layout.problem
        if not problem.is_finite:  # back ends may spin for seconds on it, or raise
            raise NoSolution(
                "the state, the references or the torques before hold a value that is not finite",
                "not solved",
                problem.copy(),
            )
        answer = solver.solve(problem)
        iterations = answer.iterations
        relaxed: list[str] = []
        for relaxation in ("joint_motion", "torque_rate"):
            if _usable(answer.x, problem, solver):
                break
            relaxed.append(relaxation)
            self._relax(layout, relaxation, references)
            answer = solver.solve(problem)
            iterations += answer.iterations
        solved = self._timer()
        if answer.x is None or not _usable(answer.x, problem, solver):
            why = explain(layout, model=self.model, effort=self.effort_bounds(references)) if explained else None
            raise NoSolution(
                f"no accelerations, torques and contact forces satisfy the equations of motion, the contacts "
                f"({', '.join(layout.key) or 'none'}) and the torque limits together ({self._solver_name}: "
                f"{answer.status}){_because(why, explained=explained)}",
                answer.status,
                problem.copy(),
                why,
            )
        return self._solution(layout, answer.x, references, tuple(relaxed), iterations, (started, built, solved))

    def explain(
        self, state: RobotState, references: References, tau_before: Array | None = None
    ) -> Infeasibility | None:
        """Say which constraints conflict, with those among them that `solve` would relax.

        It is no part of a cycle: it takes several periods.

        Args:
            state: where the robot is.
            references: what is wanted.
            tau_before: the torques that the joints have now, (na,) in N·m, where the torque rate is to be held.

        Returns:
            The conflict; None where the constraints can be met together, or a value is not finite.
        """
        layout = self.build(state, references, tau_before)
        if not layout.problem.is_finite:
            return None
        return explain(layout, self.model, self.effort_bounds(references))

    def effort_bounds(self, references: References) -> tuple[Array, Array]:
        """Bounds of the problem's torque rows by the effort limits alone, without the rate."""
        lower, upper = self.torque_limit.bounds(None, self.period)
        h = self._h(references)[self.model.v_index]
        return lower - h, upper - h

    def _relax(self, layout: Layout, what: str, references: References) -> None:
        problem = layout.problem
        if what == "joint_motion":
            problem.x_lower[layout.joints] = -np.inf
            problem.x_upper[layout.joints] = np.inf
        else:
            problem.lower[layout.torque], problem.upper[layout.torque] = self.effort_bounds(references)

    def _solution(
        self,
        layout: Layout,
        x: Array,
        references: References,
        relaxed: tuple[str, ...],
        iterations: int,
        times: tuple[float, float, float],
    ) -> Solution:
        problem, model = layout.problem, self.model
        v_dot, f = x[: model.nv], FORCE_UNIT * x[model.nv :]
        generalized = self.dynamics.M @ v_dot + self._h(references) - layout.J.T @ f  # = Sᵀτ
        tau = generalized[model.v_index]
        motion = problem.A @ x - problem.b
        residuals = {
            "equations_of_motion": _largest(generalized[layout.unactuated]),
            "contact_motion": _largest(motion[layout.floating.stop :]),
            "inequalities": max(0.0, problem.violation(x)),
        }
        forces = {
            contact.name: frozen(FORCE_UNIT * x[columns])
            for contact, columns in zip(layout.contacts, layout.forces, strict=True)
        }
        started, built, solved = times
        return Solution(
            v_dot=frozen(v_dot),
            tau=frozen(tau),
            forces=frozen_mapping(forces),
            residuals=frozen_mapping(residuals),
            task_errors=frozen_mapping(self._task_errors),
            binding=self._binding(layout, x),
            relaxed=relaxed,
            iterations=iterations,
            stage_seconds=frozen_mapping(
                {"build": built - started, "solve": solved - built, "unpack": self._timer() - solved}
            ),
            external_wrenches=frozen_mapping(references.external_wrenches),
        )

    def _binding(self, layout: Layout, x: Array) -> tuple[str, ...]:
        """Names of the inequalities that hold with equality."""
        problem, joints = layout.problem, self.model.joints
        value = problem.C @ x
        names: list[str] = []
        at_lower, at_upper = _at(value, problem.lower), _at(value, problem.upper)
        torque = layout.torque
        names += [f"torque:{joints[i]}:lower" for i in np.flatnonzero(at_lower[torque])]
        names += [f"torque:{joints[i]}:upper" for i in np.flatnonzero(at_upper[torque])]
        names += [
            f"cone:{contact.name}"
            for contact, rows in zip(layout.contacts, layout.cones, strict=True)
            if at_upper[rows].any()
        ]
        at_lower, at_upper = _at(x, problem.x_lower), _at(x, problem.x_upper)
        names += [f"motion:{joints[i]}:lower" for i in np.flatnonzero(at_lower[layout.joints])]
        names += [f"motion:{joints[i]}:upper" for i in np.flatnonzero(at_upper[layout.joints])]
        for contact, columns in zip(layout.contacts, layout.forces, strict=True):
            if at_lower[columns].any():
                names.append(f"normal_force:{contact.name}:lower")
            if at_upper[columns].any():
                names.append(f"normal_force:{contact.name}:upper")
        return tuple(names)


def _usable(x: Array | None, problem: QuadraticProgram, solver: Solver) -> bool:
    """Whether an answer is one: there, finite, and within tolerance of every constraint."""
    if x is None:
        return False
    return bool(problem.violation(x) <= solver.tolerance)  # False for NaN


def _because(why: Infeasibility | None, *, explained: bool) -> str:
    if why is not None:
        return f"; {why.sentence}"
    return "; they do not conflict: it is the solver that failed" if explained else ""


def _at(value: Array, bound: Array) -> np.ndarray:
    near = np.abs(value - bound) <= _BINDING * np.maximum(1.0, np.abs(bound))
    return np.asarray(near & np.isfinite(bound))


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values), initial=0.0))
