"""A controller and the mock robot's physics, cycle by cycle, on one thread, without topics between."""

from __future__ import annotations

from collections.abc import Callable

from wbc_controller.build import make_board, make_controller, make_model
from wbc_controller.core.references import Change
from wbc_controller.mock.plant import Plant
from wbc_controller.records import Array, RobotState, Solution, frozen
from wbc_controller.settings import Settings


class Simulation:
    """What a script or a test needs to see what a configuration does.

    Attributes:
        settings: the robot's settings.
        plant: the physics; its base is let go.
        controller: solves the quadratic program.
        board: holds the references.
        time: simulated, s.
        solution: of the last cycle.
    """

    solution: Solution

    def __init__(self, settings: Settings, urdf: str | None = None) -> None:
        """Build the robot, its controller and the physics, in the nominal posture.

        Args:
            settings: the robot's settings.
            urdf: the URDF's text, where it did not come from the settings.

        Raises:
            ConfigurationError: where the robot cannot be controlled or simulated.
        """
        self.settings = settings
        model = make_model(settings, urdf)
        self.plant = Plant(model, settings)
        self.controller = make_controller(settings, model)
        self.board = make_board(settings, self.controller)
        self.plant.hold(False, ramp=0.0)
        self.controller.dynamics.update(*self.plant.state())
        self.board.reset(self.controller.dynamics, 0.0)
        self.time = 0.0
        self._tau: Array | None = None

    def apply(self, *changes: Change) -> None:
        """Apply changes to the references, all in one cycle."""
        self.board.apply(changes, self.controller.dynamics, self.time)

    def run(self, seconds: float, each: Callable[[Simulation], None] = lambda simulation: None) -> None:
        """Go on.

        Args:
            seconds: how long.
            each: called after every cycle, before the physics goes on.

        Raises:
            NoSolution: where a cycle has none.
            WbcError: where the physics has diverged.
        """
        period = self.controller.formulation.period
        for _ in range(round(seconds / period)):
            q, v = self.plant.state()
            state = RobotState(self.plant.stamp, frozen(q), frozen(v))
            self.solution = self.controller.solve(state, self.board.sample(self.time), self._tau)
            self._tau = self.solution.tau
            self.plant.apply(self._tau)
            each(self)
            for _ in range(self.plant.steps_per_period):
                self.plant.step()
            self.time += period
