"""The generalized forces that act beside those of the model: known friction, and what is estimated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wbc_controller.estimation.contact_forces import ContactForces
from wbc_controller.estimation.disturbance_observer import DisturbanceEstimate
from wbc_controller.estimation.friction import FrictionCompensation
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Disturbance, Prediction, RobotState, Solution, frozen

#: Largest time between two states that are compared, in control periods; beyond it, states were lost in between.
_LARGEST_GAP = 3.5


class BesideTheModel:
    """Compares each state with what was predicted for it, and says what acts beside the model.

    Attributes:
        estimate: of what is not known.
        carried: what the contacts carry, while `estimate` is on; None where nobody asks.
    """

    MEMORY = ("estimate", "carried", "_friction", "_before")

    def __init__(
        self,
        estimate: DisturbanceEstimate,
        friction: FrictionCompensation | None,
        carried: ContactForces | None,
        period: float,
    ) -> None:
        """Begin with nothing.

        Args:
            estimate: of what is not known.
            friction: what is known; None where nothing is.
            carried: what the contacts carry; None where nobody asks.
            period: of the control, s.
        """
        self.estimate, self.carried = estimate, carried
        self._friction = friction
        self._largest_gap = _LARGEST_GAP * period
        self._before: Prediction | None = None
        self._nothing = frozen(np.zeros(len(estimate.forces)))

    def restart(self) -> None:
        """Forget all."""
        self.estimate.restart()
        if self.carried is not None:
            self.carried.restart()
        if self._friction is not None:
            self._friction.restart()
        self._before = None

    @property
    def lifted(self) -> tuple[str, ...]:
        """Names of the contacts that carry nothing, where that is known."""
        return self.carried.lifted if self.carried is not None else ()

    def look(self, state: RobotState) -> Disturbance | None:
        """Compare a state with what was predicted for it.

        Args:
            state: the latched state.

        Returns:
            What acts beside the model; None where nothing does.
        """
        if self.rests:
            return None
        before, self._before = self._before, None
        gap = 1.0e-9 * (state.stamp - before.stamp) if before is not None else 0.0
        if before is not None and 0.0 < gap <= self._largest_gap:
            wanted = gap * before.v_dot if before.v_dot is not None else None
            contacts = tuple(before.forces)
            if self._friction is not None:
                self._friction.look(before.M, before.J, contacts, state.v, gap, wanted)
            if not self.estimate.rests:
                missed = None
                if wanted is not None:
                    missed = before.M @ (state.v - before.v - wanted) - gap * before.excess
                self.estimate.look(before.M, before.J, contacts, gap, missed)
                if self.carried is not None and self.estimate.held is not None:
                    self.carried.look(before.forces, *self.estimate.held)
        elif before is not None and gap <= 0.0:  # the same state again
            self._before = before
        estimated, friction = self.estimate.forces, self._friction
        forces = estimated if friction is None else frozen(estimated + friction.forces)
        return Disturbance(forces, estimated, self.estimate.at_bound)

    @property
    def rests(self) -> bool:
        """Whether nothing acts, and nothing is to be found out: then a cycle needs neither `look` nor `sent`."""
        return self._friction is None and self.estimate.rests

    def sent(
        self,
        state: RobotState,
        solution: Solution | None,
        tau: Array | None,
        dynamics: Dynamics,
        jacobian: Callable[[tuple[str, ...]], Array],
    ) -> None:
        """Remember what a cycle has found.

        Args:
            state: its latched state.
            solution: its solution, where it has one.
            tau: torques that were sent, (na,) in N·m; None where none were, or on a ramp, where others hold the robot.
            dynamics: the snapshot of that state.
            jacobian: gives the stacked Jacobian of contacts in that snapshot, (k, nv), by their names.
        """
        if self.rests or (self._before is not None and self._before.stamp == state.stamp):
            return  # the torques that were sent first have acted for longer
        model, excess, v_dot = dynamics.model, self._nothing, None
        forces: dict[str, Array] = {}
        if (
            solution is not None and tau is not None and not solution.relaxed
        ):  # one that misses its bounds tells nothing
            v_dot, forces = solution.v_dot, {name: frozen(force) for name, force in solution.forces.items()}
            if not np.array_equal(tau, solution.tau):
                excess = model.actuation.generalized_force(tau - solution.tau)
        self._before = Prediction(
            state.stamp, state.v, v_dot, excess, forces, frozen(dynamics.M), frozen(jacobian(tuple(forces)))
        )
