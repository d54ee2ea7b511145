"""Controller and physics in one thread, without topics."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from wbc_controller.arguments import number
from wbc_controller.controller.controller import Controller
from wbc_controller.controller.result import CycleResult
from wbc_controller.errors import NoSolution
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.limits import RowLimit
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import Mode
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config, load
from wbc_controller.simulation.plant import Plant

_LONGEST_RUN = 86_400.0  # longest simulation by one call, s


class Simulation:
    """Standing robot in MuJoCo with its active controller; its time starts after the torque ramp."""

    result: CycleResult

    def __init__(
        self,
        config: Config | Settings | Mapping[str, Any] | str | Path,
        *,
        tasks: Iterable[Callable[[RobotModel], Task]] = (),
        contacts: Iterable[Callable[[RobotModel], Contact]] = (),
        limits: Iterable[Callable[[RobotModel], RowLimit]] = (),
        preflight: bool = True,
    ) -> None:
        """Build all objects in the nominal posture; arguments as for `load` and `Controller`."""
        config = load(config).replace({"safety.activation_ramp": 0.0})
        self.controller = Controller(config, tasks=tasks, contacts=contacts, limits=limits, preflight=preflight)
        self.reset()

    def reset(self) -> None:
        """Restart at time 0 in the nominal posture; updated settings remain."""
        settings = self.controller.config.settings
        self.plant = Plant(self.controller.model, settings)
        self.plant.hold(False, ramp=0.0)
        self.controller.reset(*self.plant.state())
        for _ in range(round(1.0 / (settings.limits.torque_rate * self.controller.period)) + 2):
            self._cycle()  # ramps the torques at the torque rate

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.plant.time

    def run(self, seconds: float, each: Callable[["Simulation"], None] = lambda simulation: None) -> list[CycleResult]:
        """Simulate for a time, s; return the results. `each` is called after every cycle.

        Raises:
            NoSolution: if a cycle has no solution, or the controller is not active.
            WbcError: if the physics diverges.
        """
        results = []
        for _ in range(round(number(seconds, "seconds", 0.0, _LONGEST_RUN) / self.controller.period)):
            results.append(self._cycle())
            self.plant.apply(self.result.tau)
            each(self)
            for _ in range(self.plant.steps_per_period):
                self.plant.step()
        return results

    def _cycle(self) -> CycleResult:
        q, v = self.plant.state()
        self.result = self.controller.step(q, v, self.time)
        if self.result.mode is not Mode.ACTIVE:
            raise NoSolution(repr(self.result), self.result.mode.value, None)
        return self.result
