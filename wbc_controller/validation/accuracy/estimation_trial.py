"""Robot without odometry on simulated time."""

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.report import CycleReport
from wbc_controller.errors import NoSolution
from wbc_controller.middleware.codec import com_trajectory
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.records import Array, Mode
from wbc_controller.settings.config import Config, load
from wbc_controller.simulation.faults.fault import Fault

#: Additional times for the torque ramp, and for settling after the release of the base, s.
_RAMP_TIME, _REST_TIME = 0.2, 1.0
_TIMEOUT = 5.0  # s
Changes = Mapping[str, Any]  # changed settings by dotted key
NO_CHANGES: Changes = MappingProxyType({})
_FALL_TIME = 2.0  # longest time of a fall, s


class EstimationTrial(Lockstep):
    """A mock robot on its estimate, and a user for motions of the centre of mass."""

    report: CycleReport
    origin: Array  # reference of the centre of mass while standing, (3,) in m; set by `stand`
    shift: Array  # offset from the true world to the estimate's world at rest, (3,) in m; set by `stand`

    def __init__(self, robot: str | Config, changes: Changes, *, force_sensors: bool = False) -> None:
        """Build a robot on its hoist; raise `ConfigurationError` if this fails."""
        values = {"control.markers_rate": 0.0, "safety.bring_up_time": 0.0, **changes}
        settings = load(robot).replace(values).settings
        model = make_model(settings)
        measured = [each for each in controller_endpoints(settings, model) if each.key == "measured_wrench"]
        remappings = {f"~/contacts/{each.subject}/wrench": each.name for each in measured if force_sensors}
        super().__init__(settings, model=model, mock={"remappings": remappings})
        self.faults: Sequence[Fault] = ()
        self.true_state = self.mock.plant.state()  # true q and v of the last cycle
        self._com = next(iter(self.user.tasks("com")), "")

    def cycle(self) -> CycleReport:
        """Execute one control period."""
        self.true_state = self.mock.plant.state()
        self.report = super().cycle()
        return self.report

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        """Run for `seconds`, with `each` after every cycle; raise `NoSolution` if the active mode ends."""
        for _ in range(round(seconds * self.settings.control.rate)):
            self.cycle()
            if self.report.mode is not Mode.ACTIVE or self.mock.plant.fallen:
                fault = self.report.fault
                why = f"{fault.code}: {fault.sentence}" if fault is not None else "the robot fell"
                raise NoSolution(why, self.report.mode.value, None)
            each()

    def lead_time(self) -> float:
        """Return the time until a link other than the feet touches the ground, s; NaN after 2 s."""
        ended = self.time
        while self.time - ended < _FALL_TIME:
            if self.mock.plant.links_on_the_floor():
                return self.time - ended
            self.cycle()
        return math.nan

    def settle(self) -> None:
        """Wait for the estimate, with the base held."""
        settled = 0.0 if self.loop.estimator is None else self.settings.estimation.settling
        for _ in range(math.ceil((settled + 0.05) * self.settings.control.rate)):
            self.cycle()

    def stand(self) -> None:
        """Wait for the estimate, activate and release; raise `NoSolution` if this fails."""
        self.settle()
        deadline = self.time + _TIMEOUT
        while self.report.mode is not Mode.ACTIVE:
            self.user.send_text("command", "activate")
            self.cycle()
            if self.time > deadline:
                raise NoSolution("; ".join(self.report.refused), self.report.mode.value, None)
        self.run(self.settings.safety.activation_ramp + _RAMP_TIME)
        self.mock.plan(self.faults, since=self.time)
        self.mock.plant.hold(False)
        self.run(_REST_TIME)
        self.origin = self.reference_com()
        base = None if self.loop.estimator is None else self.loop.estimator.base
        self.shift = np.zeros(3) if base is None else base[0][:3] - self.true_state[0][:3]

    def reference_com(self) -> Array:
        """Return the reference of the centre of mass, (3,) in m."""
        return np.array(self.controller.board.present(self._com, 1.0e-9 * self.mock.stamp).position)

    def follow(self, times: Sequence[float], points: Sequence[Array]) -> None:
        """Send a trajectory of the centre of mass through points at rest in the estimate's world, (3,) in m."""
        self.user.send("trajectory", com_trajectory(times, np.array(points)), self._com)
