"""Figures of a walk: torques, slip and contact forces."""

from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial
from wbc_controller.validation.accuracy.flaws import chatter
from wbc_controller.walking.gait import Phase

CHATTER = 25.0  # frequency above which torques are chatter, Hz
_AT_TOUCHDOWN, _SETTLING = 0.01, 0.05  # time after a touchdown for the torque rate, and until slip counts, s


@dataclass(frozen=True, slots=True)
class WalkFigures:
    """Largest figures of a walk."""

    torque: float = 0.0  # as a share of the limit
    rate: float = 0.0  # torque rate at a touchdown, as a share of the limit
    chatter: float = 0.0  # RMS of a torque above `CHATTER`, as a share of the limit
    slip: float = 0.0  # of a foot in contact, m
    outside: float = 0.0  # excess of a commanded contact force over its cone, N or N·m


class WalkMeter:
    """Measures the figures of a walk, cycle by cycle."""

    def __init__(self, trial: EstimationTrial) -> None:
        settings, self._trial = trial.settings, trial
        self._limits = trial.model.effort_limits
        self._step = settings.limits.torque_rate * self._limits / settings.control.rate
        self._torques: list[Array] = []
        self._since = np.inf  # cycles since the last touchdown
        self._phase: Phase | None = None
        self._placed: dict[str, tuple[int, Array]] = {}
        self._rate = self._slip = self._outside = 0.0

    def update(self) -> None:
        """Measure one cycle."""
        trial, walker = self._trial, self._trial.controller.walker
        command, solution = trial.report.command, trial.report.solution
        if walker is None or command is None or solution is None:
            return
        self._since = 0.0 if (self._phase, walker.phase) == (Phase.SINGLE, Phase.DOUBLE) else self._since + 1.0
        self._phase = walker.phase
        if self._torques and self._since < _AT_TOUCHDOWN * trial.settings.control.rate:
            self._rate = max(self._rate, float(np.max(np.abs(command.tau - self._torques[-1]) / self._step)))
        self._torques.append(np.array(command.tau))
        for name, force in solution.forces.items():
            cone = trial.controller.qp.contacts[name].cone
            self._outside = max(self._outside, float(np.max(cone @ force, initial=0.0)))
        self._follow(list(solution.forces))

    def _follow(self, contacts: list[str]) -> None:
        settled = _SETTLING * self._trial.settings.control.rate
        placed = {}
        for name in contacts:
            place = self._trial.mock.plant.foot_placement(name).translation[:2].copy()
            cycles, before = self._placed.get(name, (0, place))
            if cycles < settled:
                before = place
            self._slip = max(self._slip, float(np.linalg.norm(place - before)))
            placed[name] = cycles + 1, before
        self._placed = placed

    def figures(self) -> WalkFigures:
        """Return the figures until now."""
        if not self._torques:
            return WalkFigures()
        torques = np.array(self._torques)
        return WalkFigures(
            torque=float(np.max(np.abs(torques) / self._limits)),
            rate=self._rate,
            chatter=chatter(torques, self._trial.settings.control.rate, self._limits, CHATTER),
            slip=self._slip,
            outside=self._outside,
        )
