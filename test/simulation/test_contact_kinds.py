"""The mock robot's polygons, wheels, tilted floor, contacts between links, grips and closed loops."""

import numpy as np
import pinocchio as pin
import pytest
from audits import audited
from refusals import refusal
from robot_cases import joint, link
from stepping import simulate

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.settings import Settings
from wbc_controller.settings.config import load
from wbc_controller.settings.contacts import LoopSettings
from wbc_controller.simulation.attachments import HINGE_LENGTH, closures_of, points_of
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.simulation import Simulation

POLYGON = [[0.085, 0.0], [0.05, 0.03], [0.05, -0.03], [-0.085, 0.02], [-0.085, -0.02]]
FOOT = {"type": "surface", "frame": "left_ankle_roll_link", "translation": [0.035, 0.0, -0.035], "vertices": POLYGON,
        "max_normal_force": 1000.0}  # fmt: skip
GRIP = {"type": "fixed", "frame": "left_rubber_hand", "rpy": [0.3, 0.2, 0.1], "translation": [0.05, 0.02, 0.01],
        "max_force": 300.0, "max_moment": 30.0}  # fmt: skip
PALM = {"type": "surface", "frame": "right_rubber_hand", "against": "left_rubber_hand", "rpy": [1.756, -0.799, 0.022],
        "half_length": 0.04, "half_width": 0.04, "min_normal_force": 5.0, "max_normal_force": 60.0}  # fmt: skip
KNOB = {"type": "point", "frame": "right_rubber_hand", "against": "left_rubber_hand", "normal": [0.154, -0.98, -0.129],
        "radius": 0.03, "min_normal_force": 5.0, "max_normal_force": 60.0}  # fmt: skip


def g1_with(name, contact):
    values = load("g1").settings.model_dump()
    if name == "left_foot":
        values["contacts"].pop(name)
    values["contacts"][name] = contact
    if contact["type"] == "fixed":  # zero between two links
        target = [10.0, -8.0, 6.0, 0.5, -0.4, 0.3]
        values["tasks"]["pull"] = {"type": "contact_wrench", "contact": name, "target": target, "weight": 0.01}
    return Settings.model_validate(values)


def masked(*held):
    return [axis in held for axis in range(6)]


CASES = {
    "polygon": ("left_foot", FOOT),
    "bolted": ("grip", GRIP),
    "pinned": ("grip", GRIP | {"mask": masked(0, 1, 2)}),
    "hinged": ("grip", GRIP | {"mask": masked(0, 1, 2, 3, 5)}),
    "held by the other hand": ("grip", GRIP | {"against": "right_rubber_hand"}),
    "pinned to the other hand": ("grip", GRIP | {"against": "right_rubber_hand", "mask": masked(0, 1, 2)}),
    "palm": ("palm", PALM),
    "knob": ("knob", KNOB),
    "balls": ("front_left_foot", None),
}


@pytest.mark.parametrize("case", CASES)
def test_the_wrenches_that_are_read_explain_the_acceleration(case):
    """M v̇ + h = Sᵀτ + Σ Jᵀ f, with MuJoCo's v̇ and f, and J of the controller's contacts; and its own forecast of f.

    The audit finds no unexplained power or force; only contacts with the world act on the robot as a whole.
    """
    name, contact = CASES[case]
    robot = Simulation(g1_with(name, contact) if contact else load("go2"))
    model, dynamics, plant = robot.controller.model, robot.controller.dynamics, robot.plant
    robot.controller.set("com", dynamics.com + np.array([0.0, 0.02, 0.0]))
    report = audited(robot, 0.3)[-1]
    assert report.warnings == ()
    assert np.linalg.norm(report.force) < 0.5
    wrenches = {key: np.pad(wrench, (0, 6 - len(wrench))) for key, wrench in plant.contact_wrenches().items()}
    q, v = plant.state()
    dynamics.update(q, v)
    force = dynamics.M @ plant.acceleration() + dynamics.h
    force[model.v_index] -= plant.applied_torques
    for key, made in robot.controller.contacts.items():
        force -= made.jacobian(dynamics).T @ (made.basis.T @ wrenches[key])
    weight = model.mass * model.gravity
    print(f"unexplained: {np.abs(force).max() / weight:.1e} of the weight")
    assert np.abs(force).max() < 1.0e-3 * weight
    made, planned = robot.controller.contacts[name], robot.result.solution.forces[name]
    assert np.abs(planned).max() > 0.5
    np.testing.assert_allclose(made.basis.T @ wrenches[name], planned, atol=0.01 * weight)
    assert np.linalg.norm(made.jacobian(dynamics) @ v) < 0.02


RADIUS = 0.1


def cart(slope=0.0):
    wheels = {"fl": "0.3 0.2 0", "fr": "0.3 -0.2 0", "rl": "-0.3 0.2 0", "rr": "-0.3 -0.2 0"}
    limit = 'lower="-100" upper="100" effort="20" velocity="50"'
    parts = [link("base", 10.0, "0 0 0.1", inertia=0.2)]
    for name, place in wheels.items():
        parts += [link(name, 1.0, inertia=0.005), joint(f"{name}_joint", "base", name, at=place, limit=limit)]
    normal = [np.sin(slope), 0.0, np.cos(slope)]
    wheel = {"type": "rolling", "axis": [0, 2, 0], "radius": RADIUS, "friction": 0.8, "max_normal_force": 300.0}
    drive = {"type": "frame_position", "frame": "base", "mask": [True, False, False], "setpoint_duration": 0.8}
    return Settings.model_validate(
        {
            "robot": {"joints": [f"{n}_joint" for n in wheels], "posture": [0.0] * 4},
            "limits": {"position": False},
            "contacts": {n: wheel | {"frame": n, "normal": normal} for n in wheels},
            "tasks": {"drive": drive},
            "mock": {"floor_normal": normal},
        }
    ), f'<robot name="cart">{"".join(parts)}</robot>'


def test_a_cart_rolls_to_where_it_is_sent_and_its_wheels_turn_as_far():
    settings, urdf = cart()
    robot = Simulation(load(settings, urdf=urdf))
    robot.run(0.1)
    start = np.array(robot.controller.dynamics.q)
    robot.controller.set("drive", np.array([start[0] + 0.5, 0.0, 0.0]))
    wrong = []

    def look(robot):
        robot.plant.forward()
        wrong.append(np.abs(robot.result.solution.v_dot - robot.plant.acceleration()).max())

    robot.run(1.2, look)
    way = robot.controller.dynamics.q - start
    print(f"way {way[0]:.4f} m, wheels {way[7:]} rad; accelerations at most {max(wrong):.3f} off")
    assert way[0] == pytest.approx(0.5, abs=2e-3)
    assert np.abs(way[7:] - way[0] / RADIUS).max() < 0.02
    assert max(wrong) < 0.5  # of some 10 rad/s² of the wheels


def test_the_robot_starts_with_its_lowest_contact_on_a_tilted_floor():
    settings, urdf = cart(0.2)
    model = make_model(settings, urdf)
    controller = make_qp(settings, model)
    q, _ = Plant(model, settings).state()
    np.testing.assert_allclose(q, stance(model, controller, list(settings.contacts), settings.mock.floor_normal))
    normal = np.array(settings.mock.floor_normal)
    controller.dynamics.update(q, np.zeros(model.nv))
    heights = [contact.points(controller.dynamics)[0] @ normal for contact in controller.contacts.values()]
    assert min(heights) == pytest.approx(0.0, abs=1e-9)


def test_a_grip_holds_the_hand_where_it_is_and_lets_it_go():
    settings = g1_with("grip", GRIP | {"enabled": False})
    model = make_model(settings)
    plant, dynamics = Plant(model, settings), Dynamics(model)
    hand = model.frame_id("left_rubber_hand", "")

    def moved(seconds):
        dynamics.update(*plant.state())
        before = dynamics.placement(hand).copy()
        simulate(plant, round(seconds / plant.step_seconds))
        dynamics.update(*plant.state())
        return np.linalg.norm(before.translation - dynamics.placement(hand).translation)

    assert moved(0.1) > 5.0e-3  # without torques the arm falls
    plant.grip("grip", True)
    plant.set_state(plant.state()[0], np.zeros(model.nv))
    assert moved(0.1) < 1.0e-3
    assert np.linalg.norm(plant.contact_wrenches()["grip"]) > 1.0
    plant.grip("grip", False)
    assert moved(0.1) > 5.0e-3
    assert np.linalg.norm(plant.contact_wrenches()["grip"]) == 0.0
    with pytest.raises(InputRefused, match=r"a grip at 'left_foot'.*grip"):
        plant.grip("left_foot", True)


def test_points_that_hold_the_axes_of_masks_and_loops():
    """Of a planar loop the axes out of its plane are held too."""
    assert points_of(masked(0, 1, 2, 3, 4, 5), "key") is None
    np.testing.assert_array_equal(points_of(masked(0, 1, 2), "key"), [[0, 0, 0]])
    np.testing.assert_array_equal(points_of(masked(0, 1, 2, 3, 5), "key"), [[0, 0, 0], [0, HINGE_LENGTH, 0]])
    np.testing.assert_array_equal(points_of(masked(0, 1, 2, 4, 5), "key"), [[0, 0, 0], [HINGE_LENGTH, 0, 0]])
    for mask in (masked(0, 1), masked(0, 1, 2, 3), masked(3, 4, 5), masked(1, 2, 3, 4, 5)):
        assert f"key = {mask}: not supported by the mock robot; valid: all six " in refusal(points_of, mask, "key")
    parts, limit = [link("ground")], 'lower="-4" upper="4" effort="20" velocity="20"'
    for name, parent, place in (("crank", "ground", 0.0), ("coupler", "crank", 0.2), ("rocker", "ground", 0.5)):
        parts += [link(name, 1.0, inertia=0.01), joint(f"{name}_joint", parent, name, at=f"{place} 0 0", limit=limit)]
    names = ["crank_joint", "coupler_joint", "rocker_joint"]
    values = {
        "robot": {"base": "fixed", "joints": names, "posture": [0.0, 0.0, 0.0]},  # in line
        "tasks": {"posture": {"type": "posture"}},
    }
    model = make_model(Settings.model_validate(values), f'<robot name="bars">{"".join(parts)}</robot>')
    loop = {"frame_a": "coupler", "frame_b": "rocker", "translation_a": [0.5, 0.0, 0.0]}
    found = [
        closures_of(model, {"pin": LoopSettings(**loop, mask=mask)})["pin"].points
        for mask in (masked(0, 2), masked(0, 1, 2, 3, 5), masked(0, 2, 4))
    ]
    np.testing.assert_array_equal(found[0], [[0, 0, 0], [0, HINGE_LENGTH, 0]])
    np.testing.assert_array_equal(found[1], found[0])
    assert found[2] is None  # a weld
    assert "loops.pin.mask" in refusal(closures_of, model, {"pin": LoopSettings(**loop, mask=masked(0))})
    assert pin.SE3.Identity().isApprox(closures_of(model, {"pin": LoopSettings(**loop)})["pin"].placements[1])


def test_grips_and_palms_are_made_and_broken_while_the_robot_sways_without_a_jump():
    """Repeated switches in both directions, several per cycle."""
    pinned = {"translation": [0.0] * 3, "mask": masked(0, 1, 2), "max_force": 100.0, "enabled": False}
    contacts = {"grip": GRIP | pinned, "palm": PALM | {"enabled": False}}
    robot = Simulation(load("g1").replace({"contacts": contacts}))
    rng, made, torques = np.random.default_rng(4), dict.fromkeys(contacts, False), []
    start = np.array(robot.controller.dynamics.com)

    def look(robot):
        assert not robot.result.solution.relaxed
        torques.append(robot.result.solution.tau)

    for _ in range(5):
        robot.controller.set("com", start + rng.uniform(-0.02, 0.02, 3) * [0.5, 1.0, 0.5])
        for name in rng.permutation(list(contacts))[: rng.integers(1, 3)]:
            made[name] = not made[name]
            robot.controller.enable(str(name), made[name])
        if made["grip"]:
            robot.plant.grip("grip", True)
        robot.run(0.22, look)
        assert {name for name in contacts if name in robot.result.solution.forces} == {n for n in made if made[n]}
        if not made["grip"]:
            robot.plant.grip("grip", False)
    steps = np.abs(np.diff(torques, axis=0) / robot.controller.model.effort_limits)
    print(f"largest torque step {steps.max():.3f} of the effort limit")
    assert steps.max() < 0.15  # the torque rate allows 0.2
    assert not robot.plant.fallen
