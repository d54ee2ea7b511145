"""One whole cycle of ours without its messages: a frozen state in, a checked command out."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wbc_controller.assembly.program import make_qp
from wbc_controller.assembly.references import make_board
from wbc_controller.assembly.safety import make_supervisor
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.errors import NoSolution
from wbc_controller.records import Array, JointCommand, Mode, References, RobotState, Solution, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings, parse_settings

#: Gains that the comparison with tsid is made with, 1/s² and 1/s.
STIFFNESS, DAMPING = 100.0, 20.0
#: Weights of the tasks, the same in both, and of tsid's regularization of the forces.
WEIGHTS = {"com": 1.0, "posture": 0.1, "waist": 1.0, "force": 1.0e-8}


def tsids_tasks(weights: Mapping[str, float] = WEIGHTS) -> dict[str, Any]:
    """The three tasks that tsid has."""
    gains = {"stiffness": STIFFNESS, "damping": DAMPING, "setpoint_duration": 0.0}
    return {
        "com": {"type": "com", "weight": weights["com"], **gains},
        "posture": {"type": "posture", "weight": weights["posture"], **gains},
        "waist": {"type": "frame_orientation", "frame": "base_link", "weight": weights["waist"], **gains},
    }


def talos(tasks: dict[str, Any], *, contact_stiffness: float = 0.0, **sections: dict[str, Any]) -> Settings:
    """Settings of Talos at 1 kHz."""
    content = load_settings(find_configuration("talos")).model_dump()
    content["control"] |= {"rate": 1000.0}
    content["mock"] |= {"step": 0.001}
    content["safety"] |= {"activation_ramp": 0.0}
    content["tasks"] = tasks
    for contact in content["contacts"].values():
        contact["stiffness"] = contact_stiffness
    for section, values in sections.items():
        content[section] |= values
    return parse_settings(content, "benchmarks/our_cycle.py")


def balance_tasks() -> dict[str, Any]:
    """The tasks that docs/balance.md shows."""
    page = Path(__file__).resolve().parents[1] / "docs" / "balance.md"
    blocks = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    return dict(yaml.safe_load(blocks[0])["tasks"])


class Cycle:
    """Controller and supervisor, active.

    Attributes:
        controller: the controller.
        solution: the last one.
        failures: cycles without a solution.
    """

    def __init__(self, settings: Settings, model: RobotModel) -> None:
        self.controller = make_qp(settings, model)
        self.supervisor = make_supervisor(settings, model)
        self.board = make_board(settings, self.controller)
        self.solution: Solution | None = None
        self.failures = 0
        self._period = 1.0 / settings.control.rate
        self._now = 0.0
        self._v_index = model.v_places

    def start(self, q: Array) -> References:
        """Take the references from a configuration at rest, and activate."""
        self.controller.dynamics.update(q, np.zeros(self.controller.model.nv))
        self.board.reset(self.controller.dynamics, 0.0)
        self.supervisor.request("activate", self._now, None)
        return self.board.sample(0.0)

    def step(self, state: RobotState, references: References) -> JointCommand:
        """Answer a state.

        Raises:
            SystemExit: where the supervisor left its active mode for good.
        """
        self._now += self._period
        outcome: Solution | NoSolution
        try:
            before = self.supervisor.torques_before(self._now)
            outcome = self.solution = self.controller.solve(state, references, before, False)
        except NoSolution as failure:
            outcome = failure
            self.failures += 1
        command = self.supervisor.step(self._now, state, state.v[self._v_index], None, outcome)
        if command is None or self.supervisor.mode not in (Mode.ACTIVE, Mode.HOLDING):
            raise SystemExit(f"the supervisor is {self.supervisor.mode.value}: {self.supervisor.fault}")
        return command


def state_of(q: Array, v: Array) -> RobotState:
    """A frozen state."""
    return RobotState(0, frozen(q), frozen(v))
