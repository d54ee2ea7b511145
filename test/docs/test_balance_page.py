"""The tasks that docs/balance.md shows keep a pushed robot on its feet where a task on the centre of mass would not."""

import numpy as np
import pytest
from pages import page, snippets

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.build.robot import make_model
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings.files import parse_settings
from wbc_controller.simulation.plant import Plant

PERIOD = 0.001


@pytest.fixture(scope="module")
def talos(robot_of):
    settings, _ = robot_of("talos")
    content = settings.model_dump() | snippets(page("balance"))[0]
    content["control"] |= {"rate": 1.0 / PERIOD}
    settings = parse_settings(content, "docs/balance.md")
    return settings, make_model(settings)


def push(settings, model, impulse, direction):
    """Push the standing robot: the controller, the references, corners of the soles (cycles, 8, 3), most spin."""
    plant, controller = Plant(model, settings), make_qp(settings, model)
    board, dynamics = make_board(settings, controller), controller.dynamics
    plant.hold(False, ramp=0.0)
    dynamics.update(*plant.state())
    board.reset(dynamics, 0.0)
    references, tau, soles, spin = board.sample(0.0), None, [], 0.0
    for cycle in range(1600):
        if cycle == 50:
            plant.push(model.base_link, [*(10.0 * impulse * np.array(direction)), 0.0, 0.0, 0.0, 0.0], 0.1)
        q, v = plant.state()
        solution = controller.solve(RobotState(plant.stamp, frozen(q), frozen(v)), references, tau)
        tau = solution.tau
        soles.append(np.concatenate([contact.points(dynamics) for contact in controller.contacts.values()]))
        spin = max(spin, float(np.linalg.norm(controller.tasks["spin"].position(dynamics))))
        plant.apply(tau)
        plant.step()
    return controller, references, np.array(soles), spin


@pytest.mark.parametrize(("impulse", "direction"), [(36.0, (1.0, 0.0)), (39.0, (-1.0, 0.0))])
def test_a_push_beyond_the_edge_of_the_support_is_taken_without_a_step(talos, impulse, direction):
    """1.15 times what a task on the centre of mass takes (benchmarks/push_recovery.py); m ω d is 26 and 30 N·s."""
    controller, references, soles, spin = push(*talos, impulse, direction)
    moved = float(np.max(np.linalg.norm(soles - soles[0], axis=2)))
    back = controller.tasks["balance"].position(controller.dynamics) - references.tasks["balance"].position
    print(f"soles moved by {1e3 * moved:.1f} mm, largest spin {spin:.1f} N·m·s, in the end {1e3 * back} mm off")
    assert moved < 0.01
    assert np.linalg.norm(back) < 0.01
    assert spin > 3.0  # the swing that did it


def test_a_foot_that_a_push_unloads_stays_where_it_was_made_with_a_stiffness(talos):
    settings, model = talos
    slid = []
    for stiffness in (0.0, 1000.0):
        contacts = {name: each.model_copy(update={"stiffness": stiffness}) for name, each in settings.contacts.items()}
        soles = push(settings.model_copy(update={"contacts": contacts}), model, 35.0, (0.0, 1.0))[2]
        slid.append(np.linalg.norm((soles - soles[0])[:, :, :2], axis=2).max(axis=1))
    print(f"slid by {1e3 * slid[0].max():.1f} mm without, {1e3 * slid[1].max():.1f} mm with a stiffness")
    assert slid[0].max() > 1.4 * slid[1].max()
    assert slid[1].max() < 0.005
    assert slid[0][-1] > 0.006  # and stays there
    assert slid[1][-1] < 0.002
