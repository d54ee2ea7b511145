"""The whole-body controller: from a state and references to accelerations, torques and contact forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from wbc_controller.core.contacts import Contact
from wbc_controller.core.program.formulation import Formulation
from wbc_controller.core.program.infeasibility import explain
from wbc_controller.core.program.layout import Layout
from wbc_controller.core.program.problem import Level, QuadraticProgram, Residuals
from wbc_controller.core.program.relaxation import (
    hindering_contacts,
    lost_contacts,
    relaxations,
    soften,
    stops_missed,
    widen,
)
from wbc_controller.core.program.unpacking import unpack
from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.core.solvers import Answer, Solver, make_solver
from wbc_controller.core.solvers.daqp import INFEASIBLE, solve_carefully
from wbc_controller.core.solvers.hierarchy import Hierarchy
from wbc_controller.core.solvers.solver import NOT_FINITE
from wbc_controller.core.tasks import Task
from wbc_controller.errors import ConfigurationError, NoSolution
from wbc_controller.records import Array, Infeasibility, LevelReport, References, RobotState, Solution

#: Room that strict priorities leave at relaxed bounds, in the problem's units, so that rounding does not close it.
_ROOM = 1.0e-6
#: Share of what joints miss to stop at their limits that may be left where contacts are given up for it.
_WORTH = 0.5


class _Attempt(NamedTuple):
    """What came of solving a built problem.

    Attributes:
        answer: of the solver.
        residuals: of the answer; None where it cannot be used.
        levels: the quadratic programs that were solved.
        relaxed: groups in which a bound is missed, and lower levels that failed.
    """

    answer: Answer
    residuals: Residuals | None
    levels: tuple[LevelReport, ...]
    relaxed: tuple[str, ...]


class WholeBodyQP:
    """Solves one quadratic program per cycle (S10 as equality constraints, S12), or one per priority level.

    Minimize, over v̇, τ and f,

        ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖²

    subject to the equations of motion M v̇ + h = Sᵀτ + Σ Jᵢᵀfᵢ + Σ Jₖᵀwₖ, the motion constraints of active contacts and
    closed loops J v̇ + J̇v = -D J v + K e (e is the displacement to the anchor of the contact, or to the closed loop),
    the friction and wrench cones of the contacts, and the limits. Here q̈ are the joint accelerations and ḣ_G is the
    rate of the momentum about the centre of mass: together they determine v̇, and unlike ‖v̇‖² they do not depend on the
    choice of the base link (S2). Building the problem (`formulation`) is separate from solving it.

    Attributes:
        formulation: builds the problem.
    """

    def __init__(
        self, formulation: Formulation, *, solver: str = "daqp", timer: Callable[[], float] = lambda: 0.0
    ) -> None:
        """Make a controller.

        Args:
            formulation: builds the problem.
            solver: name of the solver.
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
        """Stacked Jacobians of contacts in the last cycle, (k, nv), where that cycle's solution has their forces.

        Args:
            names: of all contacts with a force in it, in their order.
        """
        return self.formulation.layout(names).J

    def forget(self) -> None:
        """Discard all warm starts: the next solution is that of a new program."""
        self._solvers.clear()
        self._hierarchies.clear()
        self._current = None

    def memory(self) -> dict[str, Any] | None:
        """All that the next solution depends on beside its arguments: the warm starts, and the last state.

        Returns:
            None where a solver keeps its warm start to itself (`Solver.memory`).
        """
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
        if self._current is None or self._current[0] is not layout:
            if layout.key not in self._solvers:
                self._solvers[layout.key] = make_solver(self._solver_name, layout.problem)
            self._current = layout, self._solvers[layout.key]
        return self._current[1]

    def _solve(self, layout: Layout) -> tuple[Answer, tuple[LevelReport, ...], tuple[str, ...]]:
        """Solve one quadratic program, or one per level; also gives level reports and the lower levels that failed."""
        if self._priorities:
            if layout.key not in self._hierarchies:
                self._hierarchies[layout.key] = Hierarchy(partial(make_solver, self._solver_name), self._timer)
            hierarchy = self._hierarchies[layout.key]
            answer = hierarchy.solve(layout.problem, layout.levels)
            return answer, hierarchy.reports, hierarchy.unsolved
        started = self._timer()
        answer = self._solver_of(layout).solve(layout.problem)
        if answer.x is None:
            return answer, (), ()
        return answer, (self._report(layout.levels[0], answer.x, answer, started),), ()

    def solve(
        self,
        state: RobotState,
        references: References,
        tau_before: Array | None = None,
        explained: bool = True,
    ) -> Solution:
        """Compute the solution of one cycle.

        If the problem is infeasible, the torque rate limit is relaxed, and if that is not enough, also the limits on
        combinations of accelerations and those of joint motion. What their bounds miss becomes part of the cost.
        In this second case contacts that move fast are given up, and those that keep a joint from stopping at its
        position limit. `Solution.relaxed` names the groups in which a bound is missed.

        Args:
            state: the latched state of the robot.
            references: task references, weights and contact activations.
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
        found = self._attempt(layout, references)
        if found.relaxed and found.residuals is not None and not {*found.relaxed} <= {"torque_rate"}:
            layout, references, found = self._without_contacts(
                layout, references, found, found.residuals.value, state, tau_before
            )
        solved = self._timer()
        answer, residuals = found.answer, found.residuals
        if answer.x is None or residuals is None:
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
        solution = unpack(
            self.formulation, layout, answer.x, answer.multipliers, residuals, references,
            answer.iterations, found.levels, found.relaxed, stages,
        )  # fmt: skip
        stages["unpack"] = self._timer() - solved
        return solution

    def _without_contacts(
        self,
        layout: Layout,
        references: References,
        found: _Attempt,
        value: Array,
        state: RobotState,
        tau_before: Array | None,
    ) -> tuple[Layout, References, _Attempt]:
        """Give up the contacts that hold nothing, and those that keep a joint from stopping, where that helps.

        Returns:
            The problem, references and attempt without them; those of the arguments where no contact is given up.
        """
        lost = lost_contacts(self.formulation, layout)
        given_up = {*lost, *hindering_contacts(self.formulation, layout, value)}
        if not given_up:
            return layout, references, found
        without = replace(references, contacts={**references.contacts, **dict.fromkeys(given_up, 0.0)})
        lifted = self.formulation.build(state, without, tau_before)
        other = self._attempt(lifted, without)
        helps = other.residuals is not None and (
            bool(lost)
            or stops_missed(self.formulation, lifted, other.residuals.value)
            < _WORTH * stops_missed(self.formulation, layout, value)
        )
        if not helps:
            return layout, references, found
        other.answer.iterations += found.answer.iterations
        return lifted, without, other._replace(relaxed=("contact_motion", *other.relaxed))

    def _attempt(self, layout: Layout, references: References) -> _Attempt:
        """Solve a built problem, with as little as possible relaxed.

        Raises:
            NoSolution: where a value of the problem is not finite.
        """
        answer, levels, unsolved = self._solve(layout)
        if answer.status == NOT_FINITE:
            raise NoSolution(
                "the state, the references or the torques before hold a value that is not finite",
                "not solved",
                layout.problem.copy(),
            )
        tolerance = self._solver_of(layout).tolerance
        residuals = _usable(answer, layout.problem, tolerance)
        if residuals is not None:
            return _Attempt(answer, residuals, levels, unsolved)
        iterations = answer.iterations
        answer, levels, unsolved, relaxed = self._relax(layout, references, answer)
        residuals = _usable(answer, layout.problem, tolerance)
        answer.iterations += iterations
        return _Attempt(answer, residuals, levels, (*relaxed, *unsolved))

    def _relax(
        self, layout: Layout, references: References, failed: Answer
    ) -> tuple[Answer, tuple[LevelReport, ...], tuple[str, ...], tuple[str, ...]]:
        """Solve a problem for which the solver has found no solution, with as little as possible relaxed.

        Returns:
            What `_solve` returns, and the names of the groups in which a bound is missed.
        """
        started, problem, level = self._timer(), layout.problem, layout.levels[0]
        answer, priorities = failed, self._priorities
        infeasible = self._solver_name == "daqp" and failed.status == INFEASIBLE
        if not infeasible and not priorities:  # the solver may have failed on a feasible problem
            answer = solve_carefully(problem)
            if answer.x is not None:
                return answer, (self._report(level, answer.x, answer, started),), (), ()
        for groups in relaxations(self.formulation, layout, references):
            answer = solve_carefully(problem, soften(layout, groups))
            if answer.x is None:
                continue
            # The minimizer of the problem with soft constraints is that of the problem with bounds widened to it.
            relaxed = widen(layout, groups, problem.residuals(answer.x).value, _ROOM if priorities else 0.0)
            if priorities:
                return *self._solve(layout), relaxed
            answer.residuals = problem.residuals(answer.x)
            return answer, (self._report(level, answer.x, answer, started),), (), relaxed
        return Answer(None, answer.status, answer.iterations), (), (), ()

    def _report(self, level: Level, x: Array, answer: Answer, started: float) -> LevelReport:
        """The report of the only level."""
        cost = level.cost.value(x) if answer.cost is None else answer.cost
        return LevelReport(level.tasks, cost, answer.iterations, self._timer() - started)

    def explain(
        self, state: RobotState, references: References, tau_before: Array | None = None
    ) -> Infeasibility | None:
        """Find the constraints that conflict, including those that `solve` would relax.

        This takes several periods, and is not part of a control cycle.

        Args:
            state: the latched state of the robot.
            references: task references, weights and contact activations.
            tau_before: the present torques of the actuators, (na,) in N·m; None for no torque rate limit.

        Returns:
            The conflict; None where the constraints can be met together, or a value is not finite.
        """
        layout = self.formulation.build(state, references, tau_before)
        if not layout.problem.is_finite:
            return None
        return explain(layout, self.model, self.formulation.effort_bounds(references))


def _usable(answer: Answer, problem: QuadraticProgram, tolerance: float) -> Residuals | None:
    """Residuals of an answer; None if it has no x, is not finite, or violates a constraint beyond the tolerance."""
    if answer.x is None:
        return None
    residuals = answer.residuals or problem.residuals(answer.x)
    return residuals if residuals.violation <= tolerance else None  # None for NaN
