"""Robot on a bench with faults on its measurements, messages and torques."""

from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.simulation.faults.catalogue import KINDS
from wbc_controller.simulation.faults.fault import Injector
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.sensors import Measurement


class Bench:
    """Go2 on its hoist with prescribed joint motion."""

    def __init__(self, model, settings, plant) -> None:
        self.model, self.plant = model, plant
        self.period = 1.0 / settings.control.rate
        self.faults = Injector(model, self.plant, self.period)
        self.true_speed = np.linspace(0.1, 0.5, model.nj)

    def plan(self, kind: str, **parameters) -> None:
        self.faults.plan([KINDS[kind].model_validate(parameters)], self.plant.time)

    def pass_period(self) -> None:
        for _ in range(self.plant.steps_per_period):
            self.plant.step()

    def run(self, periods: int, damping: float | None = None) -> None:
        """Advance faults and physics with damping, N·m·s/rad, in place of torques."""
        for _ in range(periods):
            self.faults.update()
            if damping is not None:
                self.plant.damp(damping)
            self.pass_period()

    def measure(self):
        """Return the measured and the true values."""
        stamp = self.plant.stamp + 1_000_000_000
        self.faults.update()
        measured, true = (Measurement(self.model, self.plant, stamp, self.model.base_link) for _ in range(2))
        time = self.plant.time
        for values in (measured, true):
            values.position = self.model.posture + self.true_speed * time
            values.velocity = self.true_speed.copy()
            values.pose[:3] = [0.3 * time, 0.2 * time, 0.5]
            values.twist[:] = [0.3, 0.2, 0.0, 0.0, 0.0, 0.0]
        self.faults.distort(measured)
        return SimpleNamespace(measured=measured, true=true)

    def measures(self, periods: int) -> list:
        found = []
        for _ in range(periods):
            found.append(self.measure())
            self.pass_period()
        return found

    def arrivals(self, stream: str, periods: int, *, messages: bool = True) -> list[list[int]]:
        """Return the numbers of the messages that arrive in each period; one is sent per period."""
        arrived = []
        for number in range(periods):
            self.faults.update()
            payload = str(number).encode() if messages else None
            arrived.append([int(parcel.payload) for parcel in self.faults.deliver(stream, number, payload)])
            self.pass_period()
        return arrived


@pytest.fixture(scope="module")
def plant(load) -> Plant:
    """Return one plant for a module of faults that do not change it."""
    return Plant(*load("go2"))


@pytest.fixture
def bench(go2, plant) -> Bench:
    return Bench(*go2, plant)
