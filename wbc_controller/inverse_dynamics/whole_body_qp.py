"""Accelerations, torques and forces from state and references."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from wbc_controller.errors import ConfigurationError, NoSolution
from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.formulation.infeasibility import explain
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.problem import NOT_FINITE, Answer
from wbc_controller.inverse_dynamics.formulation.relaxation import (
    contacts_preventing_stop,
    relaxations,
    slipping_contacts,
    soften,
    stopping_shortfall,
    widen,
)
from wbc_controller.inverse_dynamics.formulation.unpacking import unpack
from wbc_controller.inverse_dynamics.solvers import Solver, make_solver
from wbc_controller.inverse_dynamics.solvers.daqp import INFEASIBLE, solve_carefully
from wbc_controller.inverse_dynamics.solvers.hierarchy import Hierarchy
from wbc_controller.records import Array, References, RobotState, Solution

_CLEARANCE = 1.0e-6  # clearance of strict priorities to relaxed bounds against rounding, in the problem's units
_WORTHWHILE_SHARE = 0.5  # contacts are released if at most this share of the missing stopping acceleration remains


class WholeBodyQP:
    """Inverse dynamics by one quadratic program per cycle (S10 as equality constraints, S12) or priority level.

    Minimize over v̇, τ and f

        ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖²

    subject to the equations of motion M v̇ + h = Sᵀτ + Σ Jᵢᵀfᵢ + Σ Jₖᵀwₖ, the contact and loop constraints J v̇ + J̇v =
    -D J v + K e (e: displacement to the anchor or closed loop), friction and wrench cones, and limits. Joint
    accelerations q̈ and the centroidal momentum rate ḣ_G determine v̇; unlike ‖v̇‖², their norm is independent of the
    base link (S2).
    """

    def __init__(
        self, formulation: Formulation, *, solver: str = "daqp", timer: Callable[[], float] = lambda: 0.0
    ) -> None:
        """Make a controller with a clock for stage times, s.

        Raises `ConfigurationError` if the solver is missing, or too inaccurate for the tasks' priorities.
        """
        self.formulation = formulation
        self.model, self.dynamics = formulation.model, formulation.dynamics
        self.tasks, self.contacts = formulation.tasks, formulation.contacts
        self._solver_name, self._make_solver = solver, partial(make_solver, solver)
        self._timer = timer
        self._solvers: dict[tuple[str, ...], Solver] = {}
        self._current: tuple[str, ...] | None = None  # contacts of the last cycle
        self._change: tuple[tuple[str, ...], tuple[str, ...]] | None = None  # of the contacts, not solved yet
        #: Active set found at the last change from one set of contacts to another.
        self._first_sets: dict[tuple[tuple[str, ...], tuple[str, ...]], Any] = {}
        self._hierarchies: dict[tuple[str, ...], Hierarchy] = {}
        tasks = formulation.tasks.values()
        self._priorities = len({task.level for task in tasks}) > 1 or any(task.tolerance is not None for task in tasks)
        if self._priorities and not self._solver_of(self.formulation.layout(())).for_levels:
            raise ConfigurationError(
                f"solver.name = {solver!r} is not accurate enough for task levels above 0 and for tolerances; valid: "
                "daqp, and quadprog through qpsolvers"
            )
        self._solver_of(self.formulation.layout(tuple(self.contacts)))
        self._change = None

    def contact_jacobian(self, names: tuple[str, ...]) -> Array:
        """Return the stacked Jacobians (k, nv) of active contacts."""
        return self.formulation.layout(names).J

    def prepare(self, state: RobotState, references: References) -> None:
        """Allocate arrays for the tasks and contacts of references."""
        layout = self.formulation.build(state, references)
        self.formulation.redundancy = None  # to be examined at the state of the first cycle
        if layout.key not in self._solvers:
            self._solvers[layout.key] = self._make_solver(layout.problem)

    def forget(self) -> None:
        """Discard all warm starts."""
        self._solvers = {key: self._make_solver(self.formulation.layout(key).problem) for key in self._solvers}
        self._hierarchies.clear()
        self._current = self._change = None
        self._first_sets.clear()
        self.formulation.redundancy = None

    def memory(self) -> dict[str, Any] | None:
        """Return warm starts and last state, for `recall`; None if a back end hides its warm start."""
        solvers = [(key, solver.memory()) for key, solver in self._solvers.items()]
        hierarchies = [(key, hierarchy.memory()) for key, hierarchy in self._hierarchies.items()]
        if any(remembered is None for _, remembered in (*solvers, *hierarchies)):
            return None
        return {
            "q": self.dynamics.q,
            "v": self.dynamics.v,
            "solvers": solvers,
            "current": self._current,
            "first_sets": [(*change, side) for change, side in self._first_sets.items()],
            "hierarchies": hierarchies,
            "redundancy": self.formulation.redundancy,
        }

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the result of `memory`."""
        self.forget()
        self.dynamics.update(memory["q"], memory["v"])
        found = memory["redundancy"]
        self.formulation.redundancy = None if found is None else (tuple(found[0]), bool(found[1]), found[2])
        self._solvers.clear()
        for key, remembered in memory["solvers"]:
            solver = self._solvers[tuple(key)] = self._make_solver(self.formulation.layout(tuple(key)).problem)
            solver.recall(remembered)
        self._current = None if memory["current"] is None else tuple(memory["current"])
        self._first_sets = {(tuple(a), tuple(b)): side for a, b, side in memory["first_sets"]}
        for key, remembered in memory["hierarchies"]:
            hierarchy = self._hierarchies[tuple(key)] = Hierarchy(self._make_solver, self._timer)
            hierarchy.recall(remembered)

    def _solver_of(self, layout: Layout) -> Solver:
        """Return the solver for another set of contacts, with the active set that it found at the last such change."""
        if layout.key not in self._solvers:
            self._solvers[layout.key] = self._make_solver(layout.problem)
        solver = self._solvers[layout.key]
        if solver.active_set is not None:
            self._change = self._current or (), layout.key
            solver.active_set.adopt(self._first_sets.get(self._change, 0))
        self._current = layout.key
        return solver

    def _solve_levels(self, layout: Layout) -> Answer:
        if layout.key not in self._hierarchies:
            self._hierarchies[layout.key] = Hierarchy(self._make_solver, self._timer)
        return self._hierarchies[layout.key].solve(layout.problem, layout.levels)

    def solve(
        self, state: RobotState, references: References, tau_before: Array | None = None, explained: bool = True
    ) -> Solution:
        """Compute the solution of one cycle.

        If the problem is infeasible, limits become soft: first the torque rate, then also row limits and joint motion,
        with release of contacts that slip or prevent a joint from stopping. `Solution.relaxed` names the groups with
        violated bounds. `tau_before` are the present torques, (na,) in N·m; None for no rate limit.

        Raises `NoSolution` if equations of motion, contacts and torque limits conflict, or a value is not finite; if
        `explained`, with the conflicting constraints, which takes several periods.
        """
        started = self._timer()
        layout = self.formulation.build(state, references, tau_before)
        built = self._timer()
        answer = self._solve_with_relaxation(layout, references)
        if answer.relaxed and not {*answer.relaxed} <= {"torque_rate"}:
            layout, references, answer = self._release_contacts(layout, references, answer, state, tau_before)
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

    def _release_contacts(
        self, layout: Layout, references: References, found: Answer, state: RobotState, tau_before: Array | None
    ) -> tuple[Layout, References, Answer]:
        lost = slipping_contacts(self.formulation, layout)
        value = None if found.residuals is None else found.residuals.value
        given_up = set() if value is None else {*lost, *contacts_preventing_stop(self.formulation, layout, value)}
        if value is None or not given_up:
            return layout, references, found
        without = replace(references, contacts={**references.contacts, **dict.fromkeys(given_up, 0.0)})
        built = self.formulation.structure, self.formulation.task_errors
        lifted = self.formulation.build(state, without, tau_before)
        other = self._solve_with_relaxation(lifted, without)
        helps = other.residuals is not None and (
            bool(lost)
            or stopping_shortfall(self.formulation, lifted, other.residuals.value)
            < _WORTHWHILE_SHARE * stopping_shortfall(self.formulation, layout, value)
        )
        if not helps:
            self.formulation.structure, self.formulation.task_errors = built
            return layout, references, found
        other.iterations += found.iterations
        other.relaxed = ("contact_motion", *other.relaxed)
        return lifted, without, other

    def _solve_with_relaxation(self, layout: Layout, references: References) -> Answer:
        """Solve a problem with the least relaxation."""
        solver = self._solvers[layout.key] if layout.key == self._current else self._solver_of(layout)
        answer = self._solve_levels(layout) if self._priorities else solver.solve(layout.problem)
        if self._change is not None and solver.active_set is not None:
            self._first_sets[self._change], self._change = solver.active_set.side.copy(), None
        if answer.x is None and answer.status != NOT_FINITE and self.formulation.find_redundancy(layout):
            answer = self._solve_levels(layout) if self._priorities else solver.solve(layout.problem)
        if self._is_solution(answer, layout, solver.tolerance):
            return answer
        if answer.status == NOT_FINITE:
            self.formulation.require_finite_limits(layout)
            message = "the state, the references or tau_before contain values that are not finite"
            raise NoSolution(message, "not solved", layout.problem.copy())
        relaxed = self._relax(layout, references, answer)
        relaxed.iterations += answer.iterations
        if self._is_solution(relaxed, layout, solver.tolerance):
            return relaxed
        return Answer(None, relaxed.status, relaxed.iterations)

    def _is_solution(self, answer: Answer, layout: Layout, tolerance: float) -> bool:
        if answer.x is None:
            return False
        if answer.residuals is None:
            answer.residuals = layout.problem.residuals(answer.x)
        if answer.cost is None and not answer.levels:
            answer.cost = layout.levels[0].cost.value(answer.x)
        return answer.residuals.violation <= tolerance  # False for NaN

    def _relax(self, layout: Layout, references: References, failed: Answer) -> Answer:
        problem, answer, priorities = layout.problem, failed, self._priorities
        infeasible = self._solver_name == "daqp" and failed.status == INFEASIBLE
        if not infeasible and not priorities:  # the solver may fail on a feasible problem
            answer = solve_carefully(problem)
            if answer.x is not None:
                return answer
        for groups in relaxations(self.formulation, layout, references):
            answer = solve_carefully(problem, soften(layout, groups))
            if answer.x is None:
                continue
            # The minimizer with soft constraints also minimizes the problem with widened bounds.
            relaxed = widen(layout, groups, problem.residuals(answer.x).value, _CLEARANCE if priorities else 0.0)
            if priorities:
                answer = self._solve_levels(layout)
            else:
                answer.residuals = None  # of the bounds before widening
            answer.relaxed = (*relaxed, *answer.relaxed)
            return answer
        return Answer(None, answer.status, answer.iterations)
