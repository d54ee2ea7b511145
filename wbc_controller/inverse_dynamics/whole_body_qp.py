"""The whole-body controller: from a state and references to accelerations, torques and contact forces."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from wbc_controller.errors import ConfigurationError, NoSolution
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.formulation.answer import NOT_FINITE, Answer
from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.formulation.infeasibility import explain
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.relaxation import (
    hindering_contacts,
    lost_contacts,
    relaxations,
    soften,
    stops_missed,
    widen,
)
from wbc_controller.inverse_dynamics.formulation.unpacking import unpack
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.solvers import Solver, make_solver
from wbc_controller.inverse_dynamics.solvers.daqp import INFEASIBLE, solve_carefully
from wbc_controller.inverse_dynamics.solvers.hierarchy import Hierarchy
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import Array, Infeasibility, References, RobotState, Solution

#: Room that strict priorities leave at relaxed bounds, in the problem's units, so that rounding does not close it.
_ROOM = 1.0e-6
#: Share of what joints miss to stop at their limits that may be left where contacts are given up for it.
_WORTH = 0.5


class WholeBodyQP:
    """Solves one quadratic program per cycle (S10 as equality constraints, S12), or one per priority level.

    Minimize, over v̇, τ and f,

        ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖²

    subject to the equations of motion M v̇ + h = Sᵀτ + Σ Jᵢᵀfᵢ + Σ Jₖᵀwₖ, the motion constraints of active contacts and
    closed loops J v̇ + J̇v = -D J v + K e (e is the displacement to the anchor of the contact, or to the closed loop),
    the friction and wrench cones of the contacts, and the limits. Here q̈ are the joint accelerations and ḣ_G is the
    rate of the momentum about the centre of mass: together they determine v̇, and unlike ‖v̇‖² they do not depend on the
    choice of the base link (S2). Building the problem (`formulation`) is separate from solving it.
    """

    def __init__(
        self, formulation: Formulation, *, solver: str = "daqp", timer: Callable[[], float] = lambda: 0.0
    ) -> None:
        """Make a controller.

        Args:
            timer: returns the time in s, for the stage times; by default they are all 0.

        Raises:
            ConfigurationError: where the solver is not installed, or not accurate enough for the tasks' priorities.
        """
        self.formulation = formulation
        self._solver_name = solver
        self._timer = timer
        self._solvers: dict[tuple[str, ...], Solver] = {}
        self._current: tuple[Layout, Solver] | None = None  # of the last cycle
        self._hierarchies: dict[tuple[str, ...], Hierarchy] = {}
        self._priorities = formulation.has_priorities
        if self._priorities and not self._solver_of(self.formulation.layout(())).for_levels:
            raise ConfigurationError(
                f"solver.name = {solver!r} is not accurate enough for tasks with a level above 0 or with a tolerance; "
                "take daqp, or quadprog through qpsolvers"
            )
        self._solver_of(self.formulation.layout(tuple(self.contacts)))

    @property
    def model(self) -> RobotModel:
        """The robot's model."""
        return self.formulation.model

    @property
    def dynamics(self) -> Dynamics:
        """The snapshot of the last cycle."""
        return self.formulation.dynamics

    @property
    def tasks(self) -> Mapping[str, Task]:
        """The tasks, by name."""
        return self.formulation.tasks

    @property
    def contacts(self) -> Mapping[str, Contact]:
        """The contacts, by name."""
        return self.formulation.contacts

    def contact_jacobian(self, names: tuple[str, ...]) -> Array:
        """Stacked Jacobians, (k, nv), of the contacts with a force in the last cycle's solution, in their order."""
        return self.formulation.layout(names).J

    def forget(self) -> None:
        """Discard all warm starts: the next solution is that of a new program."""
        self._solvers.clear()
        self._hierarchies.clear()
        self._current = None

    def memory(self) -> dict[str, Any] | None:
        """State that the next solution depends on: warm starts and last state; None if a solver hides its own."""
        solvers = [(key, solver.memory()) for key, solver in self._solvers.items()]
        hierarchies = [(key, hierarchy.memory()) for key, hierarchy in self._hierarchies.items()]
        if any(remembered is None for _, remembered in (*solvers, *hierarchies)):
            return None
        return {"q": self.dynamics.q, "v": self.dynamics.v, "solvers": solvers, "hierarchies": hierarchies}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` gave."""
        self.forget()
        self.dynamics.update(memory["q"], memory["v"])
        for key, remembered in memory["solvers"]:
            self._solver_of(self.formulation.layout(tuple(key))).recall(remembered)
        for key, remembered in memory["hierarchies"]:
            hierarchy = self._hierarchies[tuple(key)] = Hierarchy(partial(make_solver, self._solver_name), self._timer)
            hierarchy.recall(remembered)

    def _solver_of(self, layout: Layout) -> Solver:
        """The solver for one set of active contacts; each keeps its own warm start."""
        if layout.key not in self._solvers:
            self._solvers[layout.key] = make_solver(self._solver_name, layout.problem)
        solver = self._solvers[layout.key]
        self._current = layout, solver
        return solver

    def _by_levels(self, layout: Layout) -> Answer:
        """Solve one quadratic program per level."""
        if layout.key not in self._hierarchies:
            self._hierarchies[layout.key] = Hierarchy(partial(make_solver, self._solver_name), self._timer)
        return self._hierarchies[layout.key].solve(layout.problem, layout.levels)

    def solve(
        self, state: RobotState, references: References, tau_before: Array | None = None, explained: bool = True
    ) -> Solution:
        """Compute the solution of one cycle.

        If the problem is infeasible, the torque rate limit is relaxed, and if that is not enough, also the limits on
        combinations of accelerations and those of joint motion. What their bounds miss becomes part of the cost.
        In this second case contacts that move fast are given up, and those that keep a joint from stopping at its
        position limit. `Solution.relaxed` names the groups in which a bound is missed.

        Args:
            tau_before: the present torques of the actuators, (na,) in N·m; None for no torque rate limit.
            explained: search at once for the conflicting constraints if there is no solution. This takes several
                periods; `NoSolution.explained` does it later.

        Raises:
            NoSolution: where the equations of motion, contacts and torque limits cannot be met together, or where a
                value is not finite.
        """
        started = self._timer()
        layout = self.formulation.build(state, references, tau_before)
        built = self._timer()
        answer = self._attempt(layout, references)
        if answer.relaxed and answer.residuals is not None and not {*answer.relaxed} <= {"torque_rate"}:
            layout, references, answer = self._without_contacts(
                layout, references, answer, answer.residuals.value, state, tau_before
            )
        solved = self._timer()
        if answer.residuals is None:
            failed = layout.snapshot()
            failure = NoSolution(
                f"no accelerations, torques and contact forces satisfy the equations of motion, the contacts "
                f"({', '.join(layout.key) or 'none'}) and the torque limits together ({self._solver_name}: "
                f"{answer.status})",
                answer.status,
                failed.problem,
                search=partial(explain, failed, self.model, self.formulation.effort_bounds(references)),
            )
            raise failure.explained() if explained else failure
        stages = {"build": built - started, "solve": solved - built}
        solution = unpack(self.formulation, layout, answer, references, stages)
        stages["unpack"] = self._timer() - solved
        return solution

    def _without_contacts(
        self,
        layout: Layout,
        references: References,
        found: Answer,
        value: Array,
        state: RobotState,
        tau_before: Array | None,
    ) -> tuple[Layout, References, Answer]:
        """Give up the contacts that hold nothing, and those that keep a joint from stopping, if that helps."""
        lost = lost_contacts(self.formulation, layout)
        given_up = {*lost, *hindering_contacts(self.formulation, layout, value)}
        if not given_up:
            return layout, references, found
        without = replace(references, contacts={**references.contacts, **dict.fromkeys(given_up, 0.0)})
        built = self.formulation.structure, self.formulation.task_errors
        lifted = self.formulation.build(state, without, tau_before)
        other = self._attempt(lifted, without)
        helps = other.residuals is not None and (
            bool(lost)
            or stops_missed(self.formulation, lifted, other.residuals.value)
            < _WORTH * stops_missed(self.formulation, layout, value)
        )
        if not helps:
            self.formulation.structure, self.formulation.task_errors = built
            self.formulation.parameters = None  # those of the other structure
            return layout, references, found
        other.iterations += found.iterations
        other.relaxed = ("contact_motion", *other.relaxed)
        return lifted, without, other

    def _attempt(self, layout: Layout, references: References) -> Answer:
        """Solve a built problem, with as little as possible relaxed; an answer without residuals is not a solution."""
        current = self._current
        solver = current[1] if current is not None and current[0] is layout else self._solver_of(layout)
        answer = self._by_levels(layout) if self._priorities else solver.solve(layout.problem)
        known = answer.residuals
        if known is not None and answer.cost is not None and known.violation <= solver.tolerance:
            return answer  # as an active set leaves it, complete
        if self._usable(answer, layout, solver.tolerance):
            return answer
        if answer.status == NOT_FINITE:
            self.formulation.require_finite_limits(layout)
            raise NoSolution(
                "the state, the references or the torques before hold a value that is not finite",
                "not solved",
                layout.problem.copy(),
            )
        relaxed = self._relax(layout, references, answer)
        relaxed.iterations += answer.iterations
        if self._usable(relaxed, layout, solver.tolerance):
            return relaxed
        return Answer(None, relaxed.status, relaxed.iterations)

    def _usable(self, answer: Answer, layout: Layout, tolerance: float) -> bool:
        """Whether an answer has an x that violates no constraint beyond the tolerance; what it lacks is computed."""
        if answer.x is None:
            return False
        if answer.residuals is None:
            answer.residuals = layout.problem.residuals(answer.x)
        if answer.cost is None and not answer.levels:
            answer.cost = layout.levels[0].cost.value(answer.x)
        return answer.residuals.violation <= tolerance  # not for NaN

    def _relax(self, layout: Layout, references: References, failed: Answer) -> Answer:
        """Solve a problem for which the solver has found no solution, with as little as possible relaxed."""
        problem, answer, priorities = layout.problem, failed, self._priorities
        infeasible = self._solver_name == "daqp" and failed.status == INFEASIBLE
        if not infeasible and not priorities:  # the solver may have failed on a feasible problem
            answer = solve_carefully(problem)
            if answer.x is not None:
                return answer
        for groups in relaxations(self.formulation, layout, references):
            answer = solve_carefully(problem, soften(layout, groups))
            if answer.x is None:
                continue
            # The minimizer of the problem with soft constraints is that of the problem with bounds widened to it.
            relaxed = widen(layout, groups, problem.residuals(answer.x).value, _ROOM if priorities else 0.0)
            if priorities:
                answer = self._by_levels(layout)
            else:
                answer.residuals = None  # of the bounds that were widened
            answer.relaxed = (*relaxed, *answer.relaxed)
            return answer
        return Answer(None, answer.status, answer.iterations)

    def explain(
        self, state: RobotState, references: References, tau_before: Array | None = None
    ) -> Infeasibility | None:
        """Find the constraints that conflict, including those that `solve` would relax.

        This takes several periods, and is not part of a control cycle. None if the constraints can be met together, or
        a value is not finite; `tau_before` as in `solve`.
        """
        layout = self.formulation.build(state, references, tau_before)
        if not layout.problem.is_finite:
            return None
        return explain(layout, self.model, self.formulation.effort_bounds(references))
