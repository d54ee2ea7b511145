"""Forces outside the model: friction and disturbance."""

from collections.abc import Callable

import numpy as np

from wbc_controller.estimation.contact_detection import ContactForces
from wbc_controller.estimation.disturbance_observer import DisturbanceObserver
from wbc_controller.estimation.friction import FrictionCompensation
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Disturbance, Prediction, RobotState, Solution, frozen

_LARGEST_GAP = 3.5  # largest time between two compared states, in control periods


class ModelErrorCompensation:
    """Compensation of forces outside the model from the prediction error of each state."""

    STATE_FIELDS = ("observer", "contact_forces", "_friction", "_prediction")

    def __init__(
        self, observer: DisturbanceObserver, friction: FrictionCompensation | None,
        contact_forces: ContactForces | None, period: float,
    ) -> None:  # fmt: skip
        """Start without a prediction; the control period is in s."""
        self.observer, self.contact_forces, self._friction = observer, contact_forces, friction
        self._largest_gap = _LARGEST_GAP * period
        self._prediction: Prediction | None = None
        self._zero = frozen(np.zeros(len(observer.forces)))

    def restart(self) -> None:
        """Reset."""
        for part in (self.observer, self.contact_forces, self._friction):
            if part is not None:
                part.restart()
        self._prediction = None

    @property
    def unloaded_contacts(self) -> tuple[str, ...]:
        """Names of contacts detected as unloaded."""
        return self.contact_forces.unloaded if self.contact_forces is not None else ()

    @property
    def is_idle(self) -> bool:
        """True if the forces are zero and stay zero."""
        return self._friction is None and self.observer.is_idle

    def update(self, state: RobotState) -> Disturbance | None:
        """Compare a state with its prediction; return the forces outside the model, or None."""
        if self.is_idle:
            return None
        before, self._prediction = self._prediction, None
        gap = 1.0e-9 * (state.stamp - before.stamp) if before is not None else 0.0
        if before is not None and 0.0 < gap <= self._largest_gap:
            self._compare(before, state, gap)
        elif before is not None and gap <= 0.0:  # repeated state
            self._prediction = before
        estimate, friction = self.observer.forces, self._friction
        forces = estimate if friction is None else frozen(estimate + friction.forces)
        return Disturbance(forces, estimate, self.observer.at_bound)

    def _compare(self, before: Prediction, state: RobotState, gap: float) -> None:
        predicted_change = gap * before.v_dot if before.v_dot is not None else None
        contacts = tuple(before.forces)
        if self._friction is not None:
            self._friction.update(before.M, before.J, contacts, state.v, gap, predicted_change)
        if self.observer.is_idle:
            return
        residual = None
        if predicted_change is not None:
            residual = before.M @ (state.v - before.v - predicted_change) - gap * before.excess
        self.observer.update(before.M, before.J, contacts, gap, residual)
        if self.contact_forces is not None and self.observer.missing_contact_forces is not None:
            self.contact_forces.update(before.forces, *self.observer.missing_contact_forces)

    def record_command(
        self, state: RobotState, solution: Solution | None, tau: Array | None, dynamics: Dynamics,
        jacobian: Callable[[tuple[str, ...]], Array],
    ) -> None:  # fmt: skip
        """Store the prediction of a cycle.

        `tau` are the torques sent, (na,); None without torques or during a ramp. `jacobian` returns the stacked contact
        Jacobian.
        """
        if self.is_idle or (self._prediction is not None and self._prediction.stamp == state.stamp):
            return  # repeated state: keep the first torques
        excess, v_dot = self._zero, None
        forces: dict[str, Array] = {}
        # A relaxed solution gives no prediction.
        if solution is not None and tau is not None and not solution.relaxed:
            v_dot, forces = solution.v_dot, {name: frozen(force) for name, force in solution.forces.items()}
            if not np.array_equal(tau, solution.tau):
                excess = dynamics.model.actuation.generalized_force(tau - solution.tau)
        self._prediction = Prediction(
            stamp=state.stamp,
            v=state.v,
            v_dot=v_dot,
            excess=excess,
            forces=forces,
            M=frozen(dynamics.M),
            J=frozen(jacobian(tuple(forces))),
        )
