"""Our cycle without messages: from a frozen state to a checked command.

It also runs on older commits, back to d8d35bb.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbc_controller.errors import NoSolution
from wbc_controller.records import Array, JointCommand, Mode, References, RobotState, Solution, frozen
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.settings import Settings
from wbc_controller.settings.files import parse_settings

try:  # module of d8d35bb; first, because an editable installation would find the newer modules
    from wbc_controller.assembly.program import make_qp
    from wbc_controller.assembly.references import make_board
    from wbc_controller.assembly.robot import make_model
    from wbc_controller.assembly.safety import make_supervisor_limits
except ModuleNotFoundError:
    from wbc_controller.controller.build.program import make_qp
    from wbc_controller.controller.build.references import make_board
    from wbc_controller.controller.build.robot import make_model
    from wbc_controller.controller.build.safety import make_supervisor_limits

if TYPE_CHECKING:
    from wbc_controller.inverse_dynamics.robot.model import RobotModel

__all__ = ["Cycle", "Stopped", "make_model", "parse_settings"]


class Stopped(Exception):
    """The supervisor left its active mode."""


class Cycle:
    """Active controller and supervisor.

    Attributes:
        controller: the controller.
        solution: last solution.
        failures: number of cycles without a solution.
    """

    def __init__(self, settings: Settings, model: RobotModel) -> None:
        self.controller = make_qp(settings, model)
        self.supervisor = Supervisor(model, make_supervisor_limits(settings, model))
        self.board = make_board(settings, self.controller)
        self.solution: Solution | None = None
        self.failures = 0
        self._period = 1.0 / settings.control.rate
        self._now = 0.0
        self._v_index = model.v_places

    def start(self, q: Array) -> References:
        """Set the references to a configuration at rest, and activate."""
        self.controller.dynamics.update(q, np.zeros(self.controller.model.nv))
        self.board.reset(self.controller.dynamics, 0.0)
        self.supervisor.request("activate", self._now, None)
        return self.board.sample(0.0)

    def state(self, q: Array, v: Array) -> RobotState:
        """Return a frozen state, one period after the last one."""
        return RobotState(round(1e9 * (self._now + self._period)), frozen(q), frozen(v))

    def step(self, state: RobotState, references: References) -> JointCommand:
        """Execute a cycle.

        Raises:
            Stopped: if the supervisor left its active mode.
        """
        return self.active(self.answer(state, references))

    def answer(self, state: RobotState, references: References) -> JointCommand | None:
        """Return the command for a state in any mode."""
        self._now += self._period
        outcome: Solution | NoSolution
        try:
            before = self.supervisor.torques_before(self._now)
            outcome = self.solution = self.controller.solve(state, references, before, False)
        except NoSolution as failure:
            outcome = failure
            self.failures += 1
        return self.supervisor.step(self._now, state, state.v[self._v_index], None, outcome)

    def active(self, command: JointCommand | None) -> JointCommand:
        """Return a command in active mode.

        Raises:
            Stopped: if the supervisor left its active mode.
        """
        if command is None or self.supervisor.mode not in (Mode.ACTIVE, Mode.HOLDING):
            fault = self.supervisor.fault
            raise Stopped(f"{self.supervisor.mode.value}, {fault.sentence if fault is not None else 'no fault'}")
        return command
