"""Watch of the first seconds for unexplained motion.

Torques at wrong joints let them run away within a few cycles. As damping would act on wrong joints too, the response is
zero torque. The unexplained velocity of each joint decays, and gains Δv - v̇ Δt per step. v̇ is that of the solution
plus N M⁻¹ Sᵀ Δτ for torques not sent (`estimation.projection`), with a free or a held base.
"""

import math
from collections.abc import Callable

import numpy as np

from wbc_controller.estimation.projection import split_force
from wbc_controller.inverse_dynamics.arrays import all_true
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, Fault, JointCommand, RobotState, Solution

Jacobian = Callable[[tuple[str, ...]], Array]  # Jacobian of the named contacts, (k, nv)
UNEXPLAINED_MOTION = "UNEXPLAINED_MOTION"  # code of the fault
_MEMORY = 0.1  # time constant of the decay, s
_LARGEST_GAP = 3.5  # largest time between two compared states, in control periods
_PRISMATIC = 0.2  # speed of a prismatic joint equivalent to 1 rad/s, m/s
_LOADED = 3.0  # factor of the limit for joints of a leg in contact, which move if the contact is lost
_NEGLIGIBLE = 0.02  # negligible missing torques, as a share of the effort limits


class BringUpWatch:
    """Watch of the joint motion against the torques sent; `fault` is that of the last cycle, or None."""

    def __init__(self, model: RobotModel, time: float, speed: float, period: float) -> None:
        """Start for `time`, s, with the largest unexplained `speed`, rad/s."""
        self.fault: Fault | None = None
        self._model = model
        self._left, self._largest_gap = time, _LARGEST_GAP * period
        self._limit = np.where(np.array(model.units) == "m", _PRISMATIC, 1.0) * speed
        self._limits = np.full(model.nv, np.inf)
        self._limits[model.v_index] = self._limit
        self._negligible = _NEGLIGIBLE * model.effort_limits
        self._base = np.eye(6 if model.floating_base else 0, model.nv)
        self._unexplained = np.zeros((2, model.nv))
        self._before: tuple[RobotState, Array] | None = None  # state, and the predictions of v̇ from it

    def check(
        self,
        state: RobotState,
        dynamics: Dynamics,
        solution: Solution | None,
        command: JointCommand | None,
        jacobian: Jacobian,
    ) -> None:
        """Compare a state with its prediction, and set `fault`; arguments of `ModelAudit.check`."""
        self.fault = None
        if self._left <= 0.0:
            return
        if solution is None or command is None:
            self._before = None
            return
        before = self._before
        gap = 1.0e-9 * (state.stamp - before[0].stamp) if before is not None else math.inf
        if gap <= 0.0:  # repeated state: keep the first torques
            return
        if before is None or gap > self._largest_gap:
            self._unexplained[:] = 0.0
        else:
            self._left -= gap
            self._unexplained *= math.exp(-gap / _MEMORY)
            q = state.q[self._model.q_places]
            if all_true((q >= self._model.position_lower) & (q <= self._model.position_upper)):  # not at a stop
                self._unexplained += state.v - before[0].v - gap * before[1]
                self._judge(state.v, jacobian(tuple(solution.forces)))
        self._before = state, self._predictions(dynamics, solution, command, jacobian)

    def _predictions(self, dynamics: Dynamics, solution: Solution, command: JointCommand, jacobian: Jacobian) -> Array:
        """Return v̇ with a free and with a held base, (2, nv), or (nv,) if they are equal."""
        missing = command.tau - solution.tau
        if all_true(np.abs(missing) <= self._negligible):
            return solution.v_dot
        force = self._model.actuation.generalized_force(missing)
        free = jacobian(tuple(solution.forces))
        held = np.vstack([free, self._base])
        changes = [np.linalg.solve(dynamics.M, split_force(dynamics.M, J, force)[0]) for J in (free, held)]
        return solution.v_dot + np.array(changes)

    def _judge(self, v: Array, J: Array) -> None:
        """Set the fault if a joint exceeds its limit with both predictions; J is the contact Jacobian."""
        speeds = np.abs(self._unexplained)
        if all_true(speeds <= self._limits):
            return
        model = self._model
        speeds = np.minimum(speeds.min(axis=0), np.abs(v))[model.v_index]
        limit = self._limit * np.where(J[:, model.v_index].any(axis=0), _LOADED, 1.0)
        worst = int((speeds / limit).argmax())
        if not (speeds[worst] <= limit[worst]):
            unit = f"{model.units[worst]}/s"
            self.fault = Fault(
                UNEXPLAINED_MOTION,
                f"joint {model.joints[worst]!r} deviates by {speeds[worst]:.2g} {unit} from the motion predicted for "
                f"the torques sent (limit {limit[worst]:g} {unit}, safety.bring_up_speed): wrong joint order or sign, "
                "or a false external wrench; compare the order of the effort command with robot.actuators (default: "
                "robot.joints)",
            )
