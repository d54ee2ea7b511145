"""Shipped robots, random states, and controllers."""

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array, References, RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.validation.fuzz.problems import random_problem, rest


class Bench:
    """Controller of a shipped robot, with states and references."""

    def __init__(self, settings: Settings, model: RobotModel, changes: dict[str, dict[str, Any]]) -> None:
        self.model = model
        update = {key: getattr(settings, key).model_copy(update=values) for key, values in changes.items()}
        self.settings = settings.model_copy(update=update)
        self.controller: WholeBodyQP = make_qp(self.settings, self.model, lambda: 0.0)
        self.stance = stance(self.model, self.controller, list(self.controller.contacts))

    def on_soles(self, **values: float) -> "Bench":
        """Return the same robot with other values of all contacts in the controller."""
        contacts = self.settings.contacts.items()
        return self.rebuilt(contacts={name: contact.model_copy(update=values) for name, contact in contacts})

    def rebuilt(self, **sections: Any) -> "Bench":
        """Return the same robot with other sections of its settings."""
        other = copy.copy(self)
        other.settings = self.settings.model_copy(update=sections)
        other.controller = make_qp(other.settings, self.model, lambda: 0.0)
        return other

    def on_levels(self, **levels: int) -> "Bench":
        """Return the same robot with tasks on other priority levels."""
        tasks = self.settings.tasks
        moved = {name: tasks[name].model_copy(update={"level": level}) for name, level in levels.items()}
        return self.rebuilt(tasks={**tasks, **moved})

    def state(self, q: Array | None = None, v: Array | None = None) -> RobotState:
        """Return a state, by default at rest in the stance."""
        v = np.zeros(self.model.nv) if v is None else v
        return RobotState(0, frozen(self.stance if q is None else q), frozen(v))

    def near_stance(self, rng: np.random.Generator, position: float = 0.1, velocity: float = 0.3) -> RobotState:
        """Return a random state within joint limits, near the stance."""
        q = pin.integrate(self.model.pinocchio, self.stance, position * rng.uniform(-1, 1, self.model.nv))
        lower, upper = self.model.position_lower + 0.05, self.model.position_upper - 0.05
        q[self.model.q_index] = np.clip(q[self.model.q_index], lower, upper)
        return self.state(q, velocity * rng.uniform(-1, 1, self.model.nv))

    def rushing(self, joint: str, gap: float, speed: float) -> tuple[Array, Array]:
        """Return q and v of the stance, with one joint moving to its upper limit from a distance."""
        i = self.model.joints.index(joint)
        q, v = np.array(self.stance), np.zeros(self.model.nv)
        q[self.model.q_index[i]] = self.model.position_upper[i] - gap
        v[self.model.v_index[i]] = speed
        return q, v

    def random_problem(self, seed: int) -> tuple[RobotState, References, Array | None]:
        """Return a random state, references and present torques."""
        return random_problem(self.model, self.stance, self.references(), seed)

    def references(self, state: RobotState | None = None, **weights: float) -> References:
        """Return references at a state, with the configured weights by default."""
        state = self.state() if state is None else state
        found = rest(self.controller, self.settings, state)
        return replace(found, weights={**found.weights, **weights})


@pytest.fixture(scope="session")
def g1(robot_of) -> RobotModel:
    return robot_of("g1")[1]


@pytest.fixture(scope="session")
def go2(robot_of) -> RobotModel:
    return robot_of("go2")[1]


@pytest.fixture(scope="session")
def bench(robot_of) -> Callable[..., Bench]:
    """Return a function that builds a controller by name or settings: bench("g1", limits={"velocity": False})."""

    def build(robot: str | Settings, **changes: dict[str, Any]) -> Bench:
        return Bench(*(robot_of(robot) if isinstance(robot, str) else (robot, make_model(robot))), changes)

    return build
