"""The tasks that docs/balance.md shows keep a pushed robot on its feet where a task on the centre of mass would not."""

import numpy as np
import pytest
from pages import page, snippets

from wbc_controller.settings.files import parse_settings
from wbc_controller.simulation.simulation import Simulation


@pytest.fixture(scope="module")
def talos(robot_of):
    settings, _ = robot_of("talos")
    content = settings.model_dump() | snippets(page("balance"))[0]
    content["control"] |= {"rate": 1000.0}
    return parse_settings(content, "docs/balance.md")


def push(settings, impulse, direction):
    """Push the standing robot: the last result, corners of the soles, (cycles, 8, 3), and spins, N·m·s."""
    simulation, soles, spins = Simulation(settings), [], []
    controller, dynamics = simulation.controller, simulation.controller.dynamics

    def look(simulation):
        soles.append(np.concatenate([contact.points(dynamics) for contact in controller.contacts.values()]))
        spins.append(np.linalg.norm(controller.tasks["spin"].position(dynamics)))

    force = 10.0 * impulse * np.array(direction)
    simulation.plant.push(controller.model.base_link, [*force, 0.0, 0.0, 0.0, 0.0], 0.1)
    simulation.run(1.55, look)
    return simulation.result, np.array(soles), spins


@pytest.mark.parametrize(("impulse", "direction"), [(36.0, (1.0, 0.0)), (39.0, (-1.0, 0.0))])
def test_a_push_beyond_the_edge_of_the_support_is_taken_without_a_step(talos, impulse, direction):
    """1.15 times what a task on the centre of mass takes (benchmarks/push_recovery.py); m ω d is 26 and 30 N·s."""
    result, soles, spins = push(talos, impulse, direction)
    moved, off = np.linalg.norm(soles - soles[0], axis=2).max(), result.task_errors["balance"]
    print(f"soles moved by {1e3 * moved:.1f} mm, spin {max(spins):.1f} N·m·s, in the end {1e3 * off:.1f} mm off")
    assert moved < 0.01
    assert off < 0.01
    assert max(spins) > 3.0  # the swing that did it


def test_a_foot_that_a_push_unloads_stays_where_it_was_made_with_a_stiffness(talos, changed):
    slid = []
    for stiffness in (0.0, 1000.0):
        contacts = {name: {"stiffness": stiffness} for name in talos.contacts}
        soles = push(changed(talos, {"contacts": contacts}), 35.0, (0.0, 1.0))[1]
        slid.append(np.linalg.norm((soles - soles[0])[:, :, :2], axis=2).max(axis=1))
    print(f"slid by {1e3 * slid[0].max():.1f} mm without, {1e3 * slid[1].max():.1f} mm with a stiffness")
    assert slid[0].max() > 1.4 * slid[1].max()
    assert slid[1].max() < 0.005
    assert slid[0][-1] > 0.006  # and stays there
    assert slid[1][-1] < 0.002
