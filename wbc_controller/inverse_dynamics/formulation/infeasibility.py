"""Conflicting constraints, and the smallest slack.

Linear programs over the constraints of the failed problem:

1. Elastic phase one: minimize Σ σ_g with a slack σ_g ≥ 0 of every named constraint g (Chinneck, "Feasibility and
  infeasibility in optimization", Springer 2008). The constraints with slack are one side of the conflict.
2. Deletion filter: enforce the constraints with the smallest slack, while the total slack of the others grows by at
  most `SLACK_GROWTH`. They are not in the conflict.
3. Repeat with each kind of that side enforced: constraints of other kinds with slack are the next side, up to
  `REMOTE_COST_RATIO` times the smallest cost, and twice the number.
4. Repeat with the named constraints enforced: other constraints up to `EQUAL_COST_RATIO` times the smallest cost also
  belong to the conflict, e.g. the other foot.

The equations of motion always hold: they never conflict alone. `named_constraints` has the violations for σ_g = 1:
multiples of the weight m g, g and the effort limits, smaller ones for contacts. Slip is therefore named only if no
other constraint can be relaxed.
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog

from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, Infeasibility, frozen_mapping

MOMENT_LENGTH = 0.1  # lever, m
CONTACT_SCALE = 0.1  # scale of contact physics relative to settings
_LEAST_TORQUE = 1.0e-9  # N·m
_GRAVITY = 9.81  # m/s²
SLACK_GROWTH = 0.5  # of the total slack in step 2
REMOTE_COST_RATIO = 10.0  # of a relaxation by other kinds
EQUAL_COST_RATIO = 1.5  # of an equivalent relaxation
_SIDES = 6  # of a conflict
_TOLERANCE = 1.0e-6  # Σ σ of feasible constraints
_NO_SLACK = 1.0e-4  # relative σ of a satisfied constraint
_MAX_ITERATIONS = 2000  # per linear program
MAX_PROGRAMS = 40  # per diagnosis


@dataclass(frozen=True, slots=True)
class Constraint:
    """Named constraint lower ≤ rows x ≤ upper."""

    name: str  # kind and owner, e.g. `torque:left_knee_joint`
    rows: Array  # (k, n)
    lower: Array  # (k,)
    upper: Array  # (k,)
    scale: Array  # violation for σ = 1, (k,)
    units: tuple[str, ...]  # of the rows
    factor: float = 1.0  # from the rows to `units`
    offset: float = 0.0  # constant part: h for torques
    contact: Contact | None = None  # owner

    @property
    def kind(self) -> str:
        """First part of the name; the second is the joint, actuator, contact or pair of links."""
        return self.name.partition(":")[0]


def named_constraints(layout: Layout, model: RobotModel, effort: tuple[Array, Array]) -> list[Constraint]:
    """Split a problem into named constraints; `effort` are the torque bounds without the rate limit, both (na,)."""
    problem, nv = layout.problem, model.nv
    force = model.mass * _GRAVITY / FORCE_UNIT
    found: list[Constraint] = []

    def add(
        name: str, rows: Array, bounds: tuple[Array, Array], scale: Array | float, units: Sequence[str], **options: Any
    ) -> None:
        rows, lower, upper = np.atleast_2d(rows), np.atleast_1d(bounds[0]), np.atleast_1d(bounds[1])
        there = np.isfinite(lower) | np.isfinite(upper)
        if there.any():
            scale, units = np.broadcast_to(scale, len(rows))[there], tuple(itertools.compress(units, there))
            found.append(Constraint(name, rows[there], lower[there], upper[there], scale, units, **options))

    identity = np.eye(problem.n)
    for place in layout.places:
        contact, columns, motion, cone = place.contact, place.columns, place.motion, place.cone
        angular = contact.moments
        add(
            f"contact_motion:{contact.name}", problem.A[motion], (problem.b[motion], problem.b[motion]),
            CONTACT_SCALE * np.where(angular, _GRAVITY / MOMENT_LENGTH, _GRAVITY),
            ["rad/s²" if turns else "m/s²" for turns in angular], contact=contact,
        )  # fmt: skip
        moments = np.abs(problem.C[cone, columns][:, contact.moments]).sum(axis=1) > 0.0
        add(
            f"cone:{contact.name}", problem.C[cone], (problem.lower[cone], problem.upper[cone]),
            CONTACT_SCALE * np.where(moments, force * MOMENT_LENGTH, force),
            ["N·m" if moment else "N" for moment in moments], factor=FORCE_UNIT, contact=contact,
        )  # fmt: skip
        for kind, first, last in contact.bound_groups:
            k, part = last - first, slice(columns.start + first, columns.start + last)
            none, moment = np.full(k, np.inf), bool(contact.moments[first])
            scale = force * MOMENT_LENGTH if moment else force
            pull = CONTACT_SCALE * scale if kind == "normal_force" and contact.min_normal_force <= 0.0 else scale
            add(
                f"{kind}:{contact.name}", np.vstack([identity[part]] * 2),
                (np.append(-none, problem.x_lower[part]), np.append(problem.x_upper[part], none)),
                np.repeat([scale, pull], k), ["N·m" if moment else "N"] * 2 * k, factor=FORCE_UNIT,
                contact=contact,
            )  # fmt: skip
    lower, upper = problem.lower[layout.torque], problem.upper[layout.torque]
    rate = np.where(lower > effort[0], lower, -np.inf), np.where(upper < effort[1], upper, np.inf)
    for i, actuator in enumerate(model.actuators):
        row, limit = problem.C[layout.torque][i], max(model.effort_limits[i], _LEAST_TORQUE)
        for kind, bounds in (("torque", effort), ("torque_rate", rate)):
            add(f"{kind}:{actuator}", row, (bounds[0][i], bounds[1][i]), limit, ["N·m"], offset=problem.offset[i])
    names = dict(zip(model.v_index.tolist(), model.joints, strict=True))
    for column in range(nv):
        owner = names.get(column, "base")
        bounds = problem.x_lower[column], problem.x_upper[column]
        add(f"motion:{owner}", identity[column], bounds, _GRAVITY / MOMENT_LENGTH, ["rad/s²"])
    for limit, limit_rows in zip(layout.row_limits, layout.limits, strict=True):
        scale = _GRAVITY / MOMENT_LENGTH if limit.unit == "rad/s²" else _GRAVITY
        for row in range(limit_rows.start, limit_rows.stop):
            name = layout.labels[problem.n + row][0]
            add(name, problem.C[row], (problem.lower[row], problem.upper[row]), scale, [limit.unit])
    return found


def explain(
    layout: Layout, model: RobotModel, effort: tuple[Array, Array], held: Collection[str] = ()
) -> Infeasibility | None:
    """Find the conflicting constraints; None if they are feasible, or the linear programs fail.

    Kinds in `held` are enforced and never named.
    """
    constraints = named_constraints(layout, model, effort)
    question = [constraint for constraint in constraints if constraint.kind not in held]
    given = [constraint for constraint in constraints if constraint.kind in held]
    problem = layout.problem
    A, b = problem.A[layout.mechanism], problem.b[layout.mechanism]
    fixed = (
        np.vstack([A, *(constraint.rows for constraint in given)]),
        np.concatenate([b, *(constraint.lower for constraint in given)]),
        np.concatenate([b, *(constraint.upper for constraint in given)]),
    )
    return _ConflictSearch(fixed, question).run()


@dataclass(frozen=True, slots=True)
class _Side:
    x: Array
    total: float
    slack: dict[str, float]


class _ConflictSearch:
    def __init__(self, fixed: tuple[Array, Array, Array], constraints: Sequence[Constraint]) -> None:
        self._all = {constraint.name: constraint for constraint in constraints}
        A, low, high = fixed
        slack, equal = ((0, 0), (0, len(constraints))), low == high  # columns of σ
        blocks = [np.pad(A[~equal], slack), np.pad(-A[~equal], slack)]
        right = [high[~equal], -low[~equal]]
        for index, constraint in enumerate(constraints):
            for sign, bound in ((1.0, constraint.upper), (-1.0, -constraint.lower)):
                blocks.append(np.pad(sign * constraint.rows / constraint.scale[:, None], slack))
                blocks[-1][:, A.shape[1] + index] = -1.0
                right.append(bound / constraint.scale)
        h = np.concatenate(right)
        there = np.isfinite(h)
        self._unequal = np.vstack(blocks)[there], h[there]
        self._equal = np.pad(A[equal], slack), low[equal]
        self._n = A.shape[1]
        self.programs = 0

    def run(self) -> Infeasibility | None:
        first = self._side(set(self._all), np.inf, len(self._all))
        if first is None:
            return None
        sides = self._sides(first)
        slack: dict[str, float] = {}
        units: dict[str, str] = {}
        sentences = []
        for side in sides:
            phrases = []
            for name in [name for name in self._all if name in side.slack and name not in slack]:
                slack[name], units[name], phrase = _largest_violation(self._all[name], side.x)
                phrases.append(phrase)
            sentences.append(", ".join(phrases))
        return Infeasibility(
            conflict=tuple(slack),
            smallest=tuple(name for name in self._all if name in first.slack),
            slack=frozen_mapping(slack),
            units=frozen_mapping(units),
            sentence="conflict: " + " against ".join(sentences),
        )

    def _sides(self, first: _Side) -> list[_Side]:
        most = max(2, 2 * len(first.slack))
        sides, named = [first], set(first.slack)
        kind = {name: constraint.kind for name, constraint in self._all.items()}

        def add(free: set[str], cost: float) -> set[str]:
            """Add a relaxation of the free constraints; return its new constraints."""
            side = self._side(free, cost, most) if len(sides) < _SIDES else None
            new = set(side.slack) - named if side is not None else set()
            if side is not None and new:
                sides.append(side)
                named.update(new)
            return new

        for held in sorted({kind[name] for name in first.slack}):
            kinds = {held}
            while new := add({name for name in self._all if kind[name] not in kinds}, REMOTE_COST_RATIO * first.total):
                while add(
                    {name for name in self._all if kind[name] not in kinds} - named, EQUAL_COST_RATIO * sides[-1].total
                ):
                    pass
                kinds |= {kind[name] for name in new}
        while add(set(self._all) - named, EQUAL_COST_RATIO * first.total):
            pass
        return sides

    def _side(self, free: set[str], cost: float, count: int) -> _Side | None:
        best = self._minimize_slack(free)
        if best is None or not (_TOLERANCE < best.total <= cost):
            return None
        # The slack grows with the number of enforced constraints: bisection.
        order = sorted(best.slack, key=best.slack.__getitem__)
        low, high, found = 0, len(order), best
        while high - low > 1:
            middle = (low + high) // 2
            fewer = self._minimize_slack(set(order[middle:]))
            if fewer is not None and fewer.total <= (1.0 + SLACK_GROWTH) * best.total:
                low, found = middle, fewer
            else:
                high = middle
        return found if len(found.slack) <= count else None

    def _minimize_slack(self, free: set[str]) -> _Side | None:
        """Minimize Σ σ over the slack of the free constraints; None without solution."""
        if self.programs >= MAX_PROGRAMS:
            return None
        self.programs += 1
        n = self._n
        bounds = [(-np.inf, np.inf)] * n + [(0.0, np.inf if name in free else 0.0) for name in self._all]
        cost, options = np.repeat([0.0, 1.0], [n, len(self._all)]), {"maxiter": _MAX_ITERATIONS}
        result = linprog(cost, *self._unequal, *self._equal, bounds, method="highs-ds", options=options)
        if result.status != 0 or not np.isfinite(result.x).all():
            return None
        slack = dict(zip(self._all, result.x[n:].tolist(), strict=True))
        least = _NO_SLACK * max(slack.values(), default=0.0)
        return _Side(result.x[:n], float(result.fun), {name: given for name, given in slack.items() if given > least})


def _largest_violation(constraint: Constraint, x: Array) -> tuple[float, str, str]:
    value = constraint.rows @ x
    above, below = value - constraint.upper, constraint.lower - value
    beyond = np.maximum(above, below)
    row = int(np.argmax(beyond / constraint.scale))
    amount, unit = constraint.factor * float(beyond[row]), constraint.units[row]
    return amount, unit, _phrase(constraint, row, amount, upper=bool(above[row] > below[row]))


def _phrase(constraint: Constraint, row: int, slack: float, *, upper: bool) -> str:
    kind, _, owner = constraint.name.partition(":")
    unit, contact = constraint.units[row], constraint.contact
    bound = constraint.factor * float((constraint.upper if upper else constraint.lower)[row] + constraint.offset)
    side = f"{'at most' if upper else 'at least'} {bound:.4g} {unit}"
    amount = f"{slack:.3g} {unit}"
    gives = f"{amount} {'more' if upper else 'less'} needed"
    if kind == "cone" and contact is not None:
        what = "friction and centre of pressure" if contact.moments.any() else "friction"
        return f"{what} of {owner} (friction {contact.friction:g}, {amount} more needed)"
    phrases = {
        "torque": f"torque of {owner} (limit {abs(bound):.4g} {unit}, {amount} more needed)",
        "torque_rate": f"torque rate of {owner} ({side} in this cycle, {gives})",
        "motion": f"joint motion of {owner} ({side}, {gives})",
        "contact_motion": f"motion of {owner} (must not move, would move by {amount})",
        "self_collision": f"distance of {owner.replace('/', ' and ')} (has to change by {side}, {gives})",
    }
    of_force = kind in ("normal_force", "yaw_moment", "force", "moment")  # other kinds are row limits
    return phrases.get(kind, f"{kind.replace('_', ' ') if of_force else f'{kind} limit'} of {owner} ({side}, {gives})")
