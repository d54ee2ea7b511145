"""Actuation: transmissions, passive joints, mimic joints and locked joints."""

import numpy as np
import pinocchio as pin
import pytest
from chains import MENAGERIE, MENAGERIE_JOINTS, TENDON, joint, link, menagerie, mimic, robot
from refusals import refusal
from snapshots import dynamics_at

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import check
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, Mobility
from wbc_controller.inverse_dynamics.robot.mimic import read_mimics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.urdf import parse_urdf
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.validation.fuzz.problems import rest


def random_state(model: RobotModel, rng: np.random.Generator) -> RobotState:
    """Return a random state with consistent mimic joints."""
    base = (pin.SE3ToXYZQUAT(pin.SE3.Random()), rng.normal(size=6)) if model.floating_base else ()
    q, v = model.state(rng.uniform(-0.4, 0.4, model.nj), rng.normal(size=model.nj), *base)
    return RobotState(0, frozen(q), frozen(v))


@pytest.fixture(scope="module")
def small() -> tuple[Settings, RobotModel]:
    settings = menagerie()
    return settings, make_model(settings, MENAGERIE)


def solve(settings: Settings, model: RobotModel, state: RobotState):
    """Return the program, and its solution with references of rest in the posture."""
    controller = make_qp(settings, model)
    posture = RobotState(0, model.configuration(model.posture), np.zeros(model.nv))
    return controller, controller.solve(state, rest(controller, settings, posture))


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize(("changes", "left"), [({}, 1), (TENDON, 2)], ids=["motors", "tendon"])
def test_split_of_generalized_forces(base, changes, left):
    model = make_model(menagerie(base=base, **changes), MENAGERIE)
    actuation, rng = model.actuation, np.random.default_rng(1)
    tau, coupling = rng.normal(size=model.na), rng.normal(size=1) @ actuation.C
    force = actuation.generalized_force(tau) + coupling
    np.testing.assert_allclose(actuation.torques(force), tau, atol=1e-13)
    np.testing.assert_allclose(actuation.split(force)[: actuation.free], 0.0, atol=1e-13)
    # The remaining rows are independent, as many as unactuated coordinates.
    rows = left + (6 if base == "floating" else 0)
    assert np.linalg.matrix_rank(actuation.split(np.eye(model.nv))[: actuation.free]) == actuation.free == rows
    np.testing.assert_allclose(actuation.from_joints(actuation.at_joints(tau)), tau, atol=1e-13)
    v = random_state(model, rng).v
    assert actuation.C @ v == pytest.approx(0.0, abs=1e-14)
    # Equation (20): the power is invariant.
    speeds = actuation.rates(v[model.v_index])
    assert tau @ speeds == pytest.approx(force @ v)
    assert tau @ speeds == pytest.approx(actuation.at_joints(tau) @ v[model.v_index])
    np.testing.assert_allclose(model.joint_forces(force), actuation.at_joints(tau), atol=1e-13)


def test_torque_task_uses_joint_torques(small):
    settings, model = small
    tasks = {"effort": {"type": "torque", "joints": ["knee", "hip"], "target": [3.0, -2.0], "weight": 1e4}}
    tasks["posture"] = {"type": "posture", "weight": 1e-4}
    limits = {"acceleration": 1e4}  # so that they do not bind before the torques
    settings = Settings.model_validate(settings.model_dump() | {"tasks": tasks, "limits": limits})
    state = random_state(model, np.random.default_rng(6))
    _, solution = solve(settings, model, state)
    at_joints = dict(zip(model.joints, model.actuation.at_joints(solution.tau), strict=True))
    assert (at_joints["knee"], at_joints["hip"]) == pytest.approx((3.0, -2.0), abs=1e-3)
    assert solution.task_errors["effort"] < 1e-3
    tasks["effort"] = {"type": "torque", "joints": ["ankle"]}
    settings = Settings.model_validate(settings.model_dump() | {"tasks": tasks})
    with pytest.raises(ConfigurationError, match=r"tasks.effort.joints: no actuator drives 'ankle'"):
        make_qp(settings, model)


def test_rotors_add_the_energy_of_their_own_speeds(small):
    _, model = small
    state = random_state(model, np.random.default_rng(7))
    dynamics = dynamics_at(model, state.q, state.v)
    links = pin.crba(model.pinocchio, model.pinocchio.createData(), np.array(state.q))
    both = model.actuation.rates(state.v[model.v_index])[model.actuators.index("both")]
    energy = 0.5 * state.v @ (dynamics.M - links) @ state.v
    assert energy == pytest.approx(0.5 * 0.1 * both**2)
    # Armature applies to joints with their own motor, not to hip, knee and ankle.
    armature = make_model(menagerie(armature=0.5), MENAGERIE).pinocchio.armature[model.v_index]
    np.testing.assert_array_equal(armature, [0.0, 0.5, 0.5, 0.0, 0.0, 0.5])


def test_passive_joint_torque(small):
    settings, model = small
    rng = np.random.default_rng(4)
    data = model.pinocchio.createData()
    ankle = model.v_index[model.joints.index("ankle")]
    for _ in range(5):
        state = random_state(model, rng)
        _, solution = solve(settings, model, state)
        force = pin.rnea(model.pinocchio, data, np.array(state.q), np.array(state.v), np.array(solution.v_dot))
        spring = 15.0 * (0.25 - state.q[model.q_index][4]) - 0.3 * state.v[ankle]
        assert force[ankle] == pytest.approx(spring, abs=1e-9)
        assert solution.residuals["equations_of_motion"] < 1e-9
        assert len(solution.tau) == model.na == model.nj - 1


def test_mimic_joint_equals_reduced_coordinates(small):
    """Reduced coordinates of the note's 4.2.1: v = G y, and equations of motion premultiplied by Gᵀ."""
    settings, model = small
    state = random_state(model, np.random.default_rng(5))
    controller, solution = solve(settings, model, state)
    dynamics = controller.dynamics
    q, v = state.q, state.v
    elbow, wrist = (model.pinocchio.joints[model.pinocchio.getJointId(name)].idx_v for name in ("elbow", "wrist"))
    assert q[wrist] == pytest.approx(-0.5 * q[elbow] + 0.2)
    assert v[wrist] == pytest.approx(-0.5 * v[elbow])
    assert solution.v_dot[wrist] == pytest.approx(-0.5 * solution.v_dot[elbow], abs=1e-9)
    G = np.delete(np.eye(model.nv), wrist, axis=1)
    y = np.delete(np.arange(model.nv), wrist).tolist()
    G[wrist, y.index(elbow)] = -0.5
    force = model.actuation.generalized_force(solution.tau)
    y_dot = np.linalg.solve(G.T @ dynamics.M @ G, G.T @ (force - dynamics.h))
    np.testing.assert_allclose(G @ y_dot, solution.v_dot, rtol=1e-9, atol=1e-9)
    mobility = G @ np.linalg.solve(G.T @ dynamics.M @ G, G.T)
    np.testing.assert_allclose(Mobility(model)(np.array(q)), mobility, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("solver", "robot_changes"), [("daqp", {}), ("daqp", TENDON), ("proxqp", {}), ("osqp", {})])
def test_equations_of_motion_with_all_actuation(solver, robot_changes):
    """Floating base on two points, with a transmission, a spring and a mimic joint; the remainder is Cᵀλ."""
    ball = {"type": "point", "max_normal_force": 500.0}
    contacts = {"foot": ball | {"frame": "foot"}, "stump": ball | {"frame": "carriage"}}
    changes = {"contacts": contacts, "solver": {"name": solver}}
    settings = menagerie(base="floating", **robot_changes)
    settings = Settings.model_validate(settings.model_dump() | changes)
    model = make_model(settings, MENAGERIE)
    q, v = model.state(model.posture, 0.1 * np.ones(model.nj), np.array([0, 0, 1.0, 0, 0, 0, 1.0]), np.zeros(6))
    controller, solution = solve(settings, model, RobotState(0, frozen(q), frozen(v)))
    dynamics = controller.dynamics
    left = dynamics.M @ solution.v_dot + dynamics.h - model.actuation.generalized_force(solution.tau)
    left -= sum(controller.contacts[name].jacobian(dynamics).T @ force for name, force in solution.forces.items())
    assert max(np.linalg.norm(force) for force in solution.forces.values()) > 1.0
    C = model.actuation.C
    coupling = np.linalg.lstsq(C.T, left, rcond=None)[0]
    exact = 1e-9 if solver == "daqp" else 1e-3
    np.testing.assert_allclose(left, coupling @ C, atol=exact)
    np.testing.assert_allclose(C @ solution.v_dot, 0.0, atol=exact)
    assert solution.residuals["equations_of_motion"] <= exact


def test_chained_mimic_joints_and_their_limits():
    followed = [link("a"), link("b"), link("c"), joint("first", "a", "b", lower=-2.0, upper=2.0, velocity=10.0)]
    second = joint("second", "b", "c", lower=-0.5, upper=1.0, velocity=4.0, more=mimic("first", -2.0, 0.2))
    settings = menagerie(
        joints=["first"], posture=[0.0], actuators=[], transmission={}, passive_joints={}, locked_joints={}
    )
    model = make_model(settings, robot(*followed, second))
    np.testing.assert_allclose([model.position_lower, model.position_upper], [[-0.4], [0.35]])
    np.testing.assert_allclose(model.velocity_limits, [2.0])
    assert make_model(settings, robot(*followed, second.replace("-2.0", "0"))).position_upper == [2.0]
    links = [link(name) for name in "abcd"]
    one, two = joint("one", "a", "b"), joint("two", "b", "c", more=mimic("one", 2.0, 0.1))
    three = joint("three", "c", "d", more=mimic("two", 3.0, 0.5))
    found = read_mimics(parse_urdf(robot(*links, one, two, three)))["three"]
    assert (found.leader, found.ratio, found.offset) == ("one", 6.0, pytest.approx(0.8))


def test_locked_joint_with_mimic_joint():
    full = pin.buildModelFromXML(MENAGERIE)
    settings = menagerie(
        joints=["hip", "knee"], posture=[0.3, -0.2], actuators=[], transmission={}, passive_joints={},
        locked_joints={"tail": 0.7, "slide": -0.2, "elbow": 0.6},
    )  # fmt: skip
    model = make_model(settings, MENAGERIE)
    assert model.moving_joints == ("hip", "knee")
    q = np.zeros(full.nq)
    places = {"hip": 0.3, "knee": -0.2, "tail": 0.7, "slide": -0.2, "elbow": 0.6, "wrist": -0.5 * 0.6 + 0.2}
    for name, position in places.items():
        q[full.joints[full.getJointId(name)].idx_q] = position
    data = full.createData()
    pin.framesForwardKinematics(full, data, q)
    dynamics = Dynamics(model)
    for frame in ("hand", "foot", "brush"):
        found = dynamics.placement(model.frame_id(frame, "test"))
        np.testing.assert_allclose(found.homogeneous, data.oMf[full.getFrameId(frame)].homogeneous, atol=1e-12)


CASES = {
    "unknown passive joint": ({"passive_joints": {"ankel": {}}}, ["robot.passive_joints: 'ankel'", "'ankle'"]),
    "passive actuator": (
        {"actuators": ["rail", "both", "shoulder", "knee_motor", "elbow", "ankle"]},
        ["robot.actuators: 'ankle' is neither in robot.transmission nor a joint", "Valid: "],
    ),
    "order missing": ({"actuators": []}, ["robot.actuators: required with robot.transmission", "both, knee_motor"]),
    "transmission not in the order": (
        {"actuators": ["rail", "both", "shoulder", "elbow"]}, ["robot.actuators: 'knee_motor'", "missing"],
    ),
    "joint without a motor": (
        {"actuators": ["both", "shoulder", "knee_motor", "elbow"]},
        ["no actuator drives joint 'rail'", "robot.passive_joints"],
    ),
    "unknown joint of a transmission": (
        {"transmission": {"both": {"ratios": {"hipp": 1.0}, "effort_limit": 1.0}}, "actuators": ["both"]},
        ["robot.transmission.both.ratios: 'hipp'", "'hip'"],
    ),
    "too many actuators": (
        {"actuators": ["hip", "rail", "both", "shoulder", "knee_motor", "elbow"]},
        ["actuator 'knee_motor' is a linear combination of hip, both", "full row rank"],
    ),
    "ratios of zero": (
        {"transmission": {"none": {"ratios": {"hip": 0.0}, "effort_limit": 1.0}},
         "actuators": ["none", "hip", "shoulder", "elbow", "knee", "rail"]},
        ["robot.transmission.none.ratios", "zero"],
    ),
    "nothing drives": (
        {"joints": ["ankle"], "posture": [0.0], "transmission": {}, "actuators": []},
        ["robot.actuators: the list is empty"],
    ),
    "follower among the joints": (
        {"joints": [*MENAGERIE_JOINTS, "wrist"], "posture": [0.0] * 7}, ["robot.joints: 'wrist' mimics 'elbow'"],
    ),
    "follower locked": ({"locked_joints": {"wrist": 0.1}}, ["robot.locked_joints: 'wrist' mimics 'elbow'"]),
    "locked joint that moves": ({"locked_joints": {"hip": 0.1}}, ["robot.locked_joints: 'hip' is also in robot."]),
    "locked out of reach": (
        {"locked_joints": {"slide": 2.0}}, ["robot.locked_joints: 2 rad for 'slide'", "[-0.5, 0.5]"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_invalid_actuation_is_refused(case):
    changes, parts = CASES[case]
    said = refusal(lambda: make_model(menagerie(**changes), MENAGERIE))
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (mimic("nobody", 1.0), "joint 'two' mimics the unknown joint 'nobody'; Valid: one, two"),
        (mimic("two", 1.0), "the joints two mimic each other in a cycle"),
        (mimic("one", 1.0).replace("1.0", "much"), "joint 'two': <mimic multiplier='much'> is not a number"),
    ],
)
def test_invalid_mimics_are_refused(more, said):
    joints = joint("one", "a", "b"), joint("two", "b", "c", more=more)
    with pytest.raises(ConfigurationError, match=said):
        read_mimics(parse_urdf(robot(link("a"), link("b"), link("c"), *joints)))


def test_weak_actuators_and_unbalanced_passive_joints_are_named():
    settings = menagerie(
        passive_joints={}, actuators=["rail", "both", "shoulder", "knee_motor", "elbow", "ankle"],
        transmission={
            "both": {"ratios": {"hip": 2.0, "knee": 2.0}, "effort_limit": 0.01},
            "knee_motor": {"ratios": {"knee": -3.0}, "effort_limit": 50.0},
        },
    )  # fmt: skip
    with pytest.raises(ConfigurationError, match=r"both .* of 0.01 N·m; conflict: .*torque of both \(limit 0.01 N·m"):
        check(settings, MENAGERIE)
    found = {finding.subject: finding.text for finding in check(menagerie(), MENAGERIE)}
    assert found["joints"].startswith("6, 5 actuators, 1 passive, 1 mimic joints, base fixed")
    assert found["passive joints"].startswith("out of balance in robot.posture: ankle by ")
