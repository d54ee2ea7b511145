"""Robots walk in simulation by a velocity command, stop and stand; a saved state continues exactly."""

import numpy as np
import pytest

import wbc_controller as wbc
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.recording.json_records import from_json, to_json
from wbc_controller.walking.gait import Phase

#: Command forward, sideways and turning, m/s and rad/s.
COMMANDS = [
    ("g1", (0.4, 0.0, 0.0)),
    ("g1", (-0.2, 0.1, 0.0)),
    ("g1", (0.0, 0.0, 0.5)),
    ("talos", (0.3, 0.0, 0.0)),
]


def heading(q):
    x, y, z, w = q[3:7]
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@pytest.mark.parametrize("robot, command", COMMANDS)
def test_a_robot_walks_as_commanded_and_stops(robot, command):
    simulation = wbc.Simulation(robot)
    controller = simulation.controller
    controller.walk(*command)
    results = simulation.run(3.5)
    assert controller.walker.phase in (Phase.SINGLE, Phase.DOUBLE)
    (start, _), begun = simulation.plant.state(), simulation.time
    results += simulation.run(3.0)
    (end, _), ended = simulation.plant.state(), simulation.time
    middle = 0.5 * (heading(start) + heading(end))
    along = complex(*(end - start)[:2]) * np.exp(-1j * middle) / (ended - begun)
    turned = (heading(end) - heading(start)) / (ended - begun)
    assert along.real == pytest.approx(command[0], abs=0.05)
    assert along.imag == pytest.approx(command[1], abs=0.05)
    assert turned == pytest.approx(command[2], abs=0.05)
    controller.stand()
    results += simulation.run(3.5)
    assert controller.walker.phase is Phase.STAND
    assert not any(result.relaxed for result in results)
    assert np.abs(simulation.plant.state()[1]).max() < 0.02
    assert set(results[-1].forces) == {"left_foot", "right_foot"}


def test_a_walk_continues_exactly_from_a_saved_state():
    simulation = wbc.Simulation("g1")
    controller = simulation.controller
    controller.walk(0.3, 0.0, 0.2)
    simulation.run(1.7)
    assert controller.walker.phase is Phase.SINGLE
    saved = from_json(to_json(controller.memory()))
    states = []
    results = simulation.run(0.8, lambda now: states.append((now.result.state, now.result.time)))
    assert controller.walker.steps >= 1
    other = wbc.Controller(controller.config)
    other.reset(states[0][0].q, states[0][0].v, states[0][1])
    other.recall(saved, controller.config.settings)
    for result, (state, time) in zip(results, states, strict=True):
        assert np.array_equal(other.step(state.q, state.v, time).tau, result.tau)


def test_a_robot_without_the_section_does_not_walk():
    controller = wbc.Controller("go2")
    controller.reset(controller.stance(), np.zeros(controller.model.nv))
    with pytest.raises(InputRefused, match="no section 'walking'"):
        controller.walk(0.1)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_velocity_that_is_not_finite_is_refused(value):
    controller = wbc.Controller("g1")
    controller.reset(controller.stance(), np.zeros(controller.model.nv))
    with pytest.raises(InputRefused, match="walking velocity"):
        controller.walk(value)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"walking.left": "hand"}, "walking.left = 'hand' is not a surface contact; valid: left_foot, right_foot"),
        ({"walking.left": "left_foot"}, "two surface contacts"),
        ({"walking.left": "left_foot", "walking.right": "left_foot"}, "two surface contacts"),
        ({"tasks.walking_dcm": {"type": "capture_point"}}, "tasks.walking_dcm: the walker has a task of this name"),
    ],
)
def test_invalid_settings_are_refused(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        wbc.Controller(wbc.load("g1").replace(changes))
