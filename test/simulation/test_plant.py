import math

import numpy as np
import pinocchio as pin
import pytest
from refusals import refusal
from stepping import simulate
from urdf_models import build_model

import wbc_controller as wbc
from wbc_controller.errors import InputRefused
from wbc_controller.settings.files import parse_settings
from wbc_controller.simulation.plant import Plant


def penetration(plant):
    """Return the largest penetration of the floor, m."""
    return max([0.0, *(-contact.dist for contact in plant.data.contact)])


@pytest.fixture
def plant(go2):
    return Plant(*go2)


def free_acceleration(model, q, v, tau):
    """v̇ without contacts, (nv,), by the articulated-body algorithm."""
    generalized = np.zeros(model.nv)
    generalized[model.v_index] = tau
    return pin.aba(model.pinocchio, model.pinocchio.createData(), q, v, generalized)


def in_the_air(model, settings):
    """Return a released plant 10 m above the floor, at rest."""
    plant = Plant(model, settings)
    plant.hold(False, ramp=0.0)
    base = pin.SE3(np.eye(3), np.array([0.0, 0.0, 10.0]))
    plant.set_state(model.configuration(model.posture, base), np.zeros(model.nv))
    return plant


def test_links_without_a_contact_that_come_down_are_named(plant):
    plant.hold(False, ramp=0.0)
    plant.damp(0.5)
    while not (down := plant.links_on_the_floor()):
        assert plant.time < 3.0
        plant.step()
    assert down <= {"base", *(f"{leg}_{link}" for leg in ("FL", "FR", "RL", "RR") for link in ("hip", "thigh", "calf"))}


@pytest.mark.parametrize("name", ["g1", "go2"])
def test_standing_the_feet_carry_the_weight_and_the_release_is_smooth(load, name):
    model, settings = load(name)
    simulation = wbc.Simulation(settings)
    plant = simulation.plant = Plant(model, settings)
    assert (plant.held, plant.fallen, plant.time) == (True, False, 0.0)
    start, _ = plant.state()
    weight = model.mass * model.gravity
    forces, depths, speeds = [], [], []

    def run(steps):
        forces.clear()
        for step in range(steps):
            if step % plant.steps_per_period == 0:
                plant.apply(simulation._cycle().tau)
            plant.step()
            depths.append(penetration(plant))
            speeds.append(np.abs(plant.state()[1][:6]).max())
            forces.append(sum(wrench[2] for wrench in plant.contact_wrenches().values()))

    run(20)
    assert 0.0 <= penetration(plant) < 1e-4
    touching = [name for name, wrench in plant.contact_wrenches().items() if np.linalg.norm(wrench) > 0.0]
    assert (touching, plant.links_on_the_floor()) == (list(settings.contacts), frozenset())
    assert {contact.friction[0] for contact in plant.data.contact} == {settings.mock.friction}
    run(180)
    plant.hold(False)
    assert not plant.held
    run(700)
    assert max(abs(force - weight) for force in forces) < 0.02 * weight  # no drop
    assert np.ptp(forces[-100:]) < 1e-3 * weight  # no chatter
    assert abs(forces[-1] - weight) < 1e-3 * weight
    assert max(depths) < 1e-3
    assert max(speeds) < 0.02
    assert not plant.fallen
    assert np.linalg.norm(plant.state()[0][:3] - start[:3]) < 1e-3


def test_a_push_changes_the_momentum_by_its_impulse(load):
    model, settings = load("g1")
    frame = str(model.pinocchio.frames[-1].name)
    wrench = np.array([30.0, -20.0, 10.0, 1.0, 2.0, -3.0])

    def momentum(pushed):
        plant = in_the_air(model, settings)
        data = model.pinocchio.createData()
        arm = np.zeros(3)
        plant.damp(50.0)
        if pushed:
            plant.push(frame, wrench / 2.0, 0.02)
            plant.push(frame, wrench / 2.0, 0.02)
        for _ in range(30):
            q, _ = plant.state()
            pin.framesForwardKinematics(model.pinocchio, data, q)
            com = pin.centerOfMass(model.pinocchio, data, q)
            if plant.time < 0.02 - 1e-9:
                arm += (data.oMf[model.pinocchio.getFrameId(frame)].translation - com) / 20.0
            plant.step()
        q, v = plant.state()
        h = pin.computeCentroidalMomentum(model.pinocchio, data, q, v)
        return h.linear.copy(), h.angular.copy(), arm

    linear, angular, arm = momentum(True)
    linear_free, angular_free, _ = momentum(False)
    np.testing.assert_allclose(linear - linear_free, 0.02 * wrench[:3], rtol=0.01)
    expected = 0.02 * (wrench[3:] + np.cross(arm, wrench[:3]))
    np.testing.assert_allclose(angular - angular_free, expected, atol=0.01 * np.linalg.norm(expected))


def test_joints_stop_at_their_limits_and_damping_saturates(go2, plant):
    model, settings = go2
    flying = in_the_air(model, settings)
    flying.apply(0.5 * flying.effort_limits)
    simulate(flying, 500)
    q, _ = flying.state()
    assert (q[model.q_index] <= model.position_upper + 0.02).all()
    assert (q[model.q_index] > model.position_upper - 0.02).any()
    q, v = plant.state()
    v[model.v_index] = 5.0
    plant.set_state(q, v)
    plant.damp(1e5)
    assert (plant.applied_torques < 0.0).all()
    assert (plant.applied_torques >= -plant.effort_limits).all()
    assert (plant.applied_torques == -plant.effort_limits).any()
    simulate(plant, 200)
    assert np.abs(plant.state()[1]).max() < 0.05


def test_the_hoist_releases_a_robot_gradually_and_carries_it_back(plant):
    start, _ = plant.state()
    plant.damp(2.0)
    plant.hold(False)
    simulate(plant, 150)
    assert start[2] - plant.state()[0][2] < 0.01
    simulate(plant, 1000)
    assert start[2] - plant.state()[0][2] > 0.1
    simulate(plant, 850)
    assert plant.fallen
    plant.hold(True)
    assert plant.held
    speed = 0.0
    for _ in range(2500):
        plant.step()
        speed = max(speed, float(np.abs(plant.state()[1][:3]).max()))
    np.testing.assert_allclose(plant.state()[0][:7], start[:7], atol=1e-3)
    assert not plant.fallen
    assert speed < 2.0


@pytest.mark.parametrize("frame", ["FL_calf", "imu"])
def test_an_imu_on_any_link_measures_what_pinocchio_computes(go2, frame):
    model, settings = go2
    plant, data = Plant(model, settings), model.pinocchio.createData()
    rng = np.random.default_rng(0)
    q, v = plant.state()
    q[:7] = pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 2.0), np.array([0.1, -0.2, 1.0])))
    plant.hold(False, ramp=0.0)
    plant.set_state(q, v + rng.normal(size=model.nv))
    plant.apply(rng.normal(size=model.na))
    for _ in range(20):
        plant.step()
        quaternion, omega, force = plant.imu(frame)
        q, v = plant.state()
        pin.forwardKinematics(model.pinocchio, data, q, v, plant.acceleration())
        pin.updateFramePlacements(model.pinocchio, data)
        place = data.oMf[model.frame_id(frame, "frame")]
        at = (model.pinocchio, data, model.frame_id(frame, "frame"), pin.LOCAL)
        np.testing.assert_allclose(pin.Quaternion(quaternion).matrix(), place.rotation, atol=1e-9)
        np.testing.assert_allclose(omega, pin.getFrameVelocity(*at).angular, atol=1e-9)
        expected = pin.getFrameClassicalAcceleration(*at).linear - place.rotation.T @ model.pinocchio.gravity.linear
        np.testing.assert_allclose(force, expected, atol=1e-6)
        plant.set_state(q, v)  # restarts the mean: instantaneous force


def test_what_an_imu_measures_adds_up_to_the_velocity(go2):
    (model, settings), frame = go2, "imu"
    simulation, period = wbc.Simulation(settings), 1.0 / settings.control.rate
    plant, data = simulation.plant, model.pinocchio.createData()
    plant.push(model.base_link, [30.0, 20.0, -80.0, 3.0, 2.0, 1.0], 0.1)

    def velocity():
        pin.forwardKinematics(model.pinocchio, data, *plant.state())
        pin.updateFramePlacements(model.pinocchio, data)
        at = (model.pinocchio, data, model.frame_id(frame, "frame"), pin.LOCAL_WORLD_ALIGNED)
        return np.array(pin.getFrameVelocity(*at).linear)

    plant.imu(frame)
    start, total, largest = velocity(), np.zeros(3), 0.0
    for _ in range(100):
        plant.apply(simulation._cycle().tau)
        turned = pin.Quaternion(plant.imu(frame)[0]).matrix()
        simulate(plant, plant.steps_per_period)
        _, omega, force = plant.imu(frame)
        middle = turned @ pin.exp3(0.5 * period * omega)
        total += period * (middle @ force + model.pinocchio.gravity.linear)
        largest = max(largest, float(np.linalg.norm(velocity() - start)))
    assert largest > 0.1
    np.testing.assert_allclose(total, velocity() - start, atol=0.002)


def test_a_joint_moves_again_when_all_its_locks_are_gone(go2, plant):
    model, _ = go2
    before = plant.model.joint("FL_calf_joint").range.copy()
    place = model.q_index[model.joints.index("FL_calf_joint")]

    def moved():
        start = plant.state()[0][place]
        plant.apply(np.where(np.array(model.joints) == "FL_calf_joint", -20.0, 0.0))
        simulate(plant, 20)
        return abs(plant.state()[0][place] - start)

    first, second = plant.lock("FL_calf_joint"), plant.lock("FL_calf_joint")
    assert moved() < 1e-2
    first()
    assert moved() < 1e-3
    second()
    assert moved() > 0.05
    np.testing.assert_array_equal(plant.model.joint("FL_calf_joint").range, before)


def test_time_is_counted_in_steps_and_unusable_values_change_nothing(go2, plant):
    model, settings = go2
    simulate(plant, 7)
    assert plant.stamp == 7_000_000
    settings = settings.model_copy(update={"control": settings.control.model_copy(update={"rate": 300.0})})
    other = Plant(model, settings)
    assert other.steps_per_period == 4
    assert other.step_seconds == pytest.approx(1.0 / 1200.0)
    plant.apply(np.ones(12))
    for tau in ([0.0] * 11, [0.0] * 13, [[0.0] * 12], [math.nan] + [0.0] * 11, [math.inf] * 12):
        with pytest.raises(InputRefused, match="expected"):
            plant.apply(tau)
        np.testing.assert_array_equal(plant.applied_torques, np.ones(12))
    q, v = plant.state()
    for bad_q, bad_v in ((q[1:], v), (q, v[1:]), (q * math.nan, v), (q * 0.0, v)):
        with pytest.raises(InputRefused, match="expected"):
            plant.set_state(bad_q, bad_v)
    for frame, wrench, duration, said in (
        ("FR_fot", [0.0] * 6, 0.1, "did you mean 'FR_foot'"),
        ("universe", [0.0] * 6, 0.1, "unknown moving link"),
        ("base", [0.0] * 3, 0.1, r"expected \(6,\)"),
        ("base", [math.nan] + [0.0] * 5, 0.1, "finite"),
        ("base", [1e9] + [0.0] * 5, 0.1, "at most"),
        ("base", [0.0] * 6, math.nan, "must be from 0 to 86400"),
        ("base", [0.0] * 6, 0.0, "positive"),
    ):
        with pytest.raises(InputRefused, match=said):
            plant.push(frame, wrench, duration)


def arm_settings(joints, posture, base="fixed"):
    robot = {"joints": joints, "posture": posture, "base": base}
    return parse_settings({"robot": robot, "tasks": {"posture": {"type": "posture"}}}, "here")


ARM = """<robot name="arm"><link name="world"/><link name="upper"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 -0.5" rpy="0.1 0.2 0.3"/><mass value="1"/>
<inertia ixx="IXX" iyy="0.1" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="world"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="50" velocity="10"/><dynamics damping="1" friction="1"/></joint>
<joint name="elbow" type="revolute"><origin xyz="0 0 -1"/><parent link="upper"/><child link="lower"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" effort="50" velocity="10"/></joint></robot>"""


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_robot_rooted_in_a_link_called_world(base):
    joints = ["elbow", "shoulder"]  # other order than the tree
    settings = arm_settings(joints, [0.3, 0.2], base)
    urdf = ARM.replace("IXX", "0.1")
    if base == "floating":
        inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        world = f'<link name="world"><inertial><mass value="3"/>{inertia}</inertial></link>'
        urdf = urdf.replace('<link name="world"/>', world)
    model = build_model(urdf, joints, [0.3, 0.2], floating_base=base == "floating", armature=0.02)
    plant = Plant(model, settings)
    plant.hold(False, ramp=0.0)
    plant.apply([1.0, -2.0])
    plant.forward()
    q, v = plant.state()
    expected = free_acceleration(model, q, v, [1.0, -2.0])
    np.testing.assert_allclose(plant.acceleration(), expected, rtol=1e-9, atol=1e-9)
    assert plant.contact_wrenches() == {}
    plant.step()
    assert not plant.fallen


def carriage(base):
    """An arm on a base that drives in a plane about an axis; `base` is the joint, or the joints, below the arm."""
    return ARM.replace("IXX", "0.1").replace(
        '<joint name="shoulder" type="revolute"><parent link="world"/>',
        '<link name="cart"><inertial><mass value="20"/><inertia ixx="1" iyy="1" izz="2" ixy="0" ixz="0" iyz="0"/>'
        f'</inertial></link>{base}<joint name="shoulder" type="revolute"><parent link="cart"/>',
    )


LIMIT = '<limit lower="-9" upper="9" effort="50" velocity="10"/>'
DUMMIES = (
    '<link name="dx"/><link name="dy"/>'
    f'<joint name="x" type="prismatic"><parent link="world"/><child link="dx"/>{LIMIT}</joint>'
    f'<joint name="y" type="prismatic"><parent link="dx"/><child link="dy"/><axis xyz="0 1 0"/>{LIMIT}</joint>'
    f'<joint name="yaw" type="revolute"><parent link="dy"/><child link="cart"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
)
PLANAR = (
    '<joint name="drive" type="planar"><origin xyz="0 0 0.1" rpy="0.1 0 0.2"/><parent link="world"/>'
    '<child link="cart"/><axis xyz="AXIS"/><limit effort="500" velocity="10"/></joint>'
)


@pytest.mark.parametrize(
    ("urdf", "base"),
    [
        (carriage(DUMMIES), ["x", "y", "yaw"]),
        (carriage(PLANAR.replace("AXIS", "0 0 1")), ["drive/x", "drive/y", "drive/theta"]),
        (carriage(PLANAR.replace("AXIS", "0 1 0")), ["drive/x", "drive/y", "drive/theta"]),
    ],
    ids=["links without mass", "planar", "planar in x and z"],
)
def test_a_base_that_drives_in_a_plane(urdf, base):
    joints, posture = [*base, "shoulder", "elbow"], [0.1, -0.2, 0.5, 0.4, -0.3]
    settings = arm_settings(joints, posture)
    wbc.check(wbc.load(settings, urdf=urdf))
    model = build_model(urdf, joints, posture, floating_base=False)
    plant = Plant(model, settings)
    q, v = model.configuration(np.array(posture)), np.linspace(1.0, -1.0, model.nv)
    tau = np.array([3.0, -2.0, 1.0, 4.0, 5.0])
    plant.apply(tau)
    plant.set_state(q, v)
    # The simulator's own links without mass have a millionth of the robot's.
    np.testing.assert_allclose(plant.acceleration(), free_acceleration(model, q, v, tau), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("axis", ["0 0 1", "1 2 -3"])
def test_a_planar_joint_moves_in_its_plane_and_turns_about_its_axis(axis):
    urdf, normal = carriage(PLANAR.replace("AXIS", axis)), np.array([float(part) for part in axis.split()])
    model = build_model(urdf, ["drive/x", "drive/y", "drive/theta"], [0.0] * 3, floating_base=False).pinocchio
    data, origin = model.createData(), pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.0, 0.2), np.array([0.0, 0.0, 0.1]))
    q = np.array([2.0, -1.0, 0.7])
    pin.framesForwardKinematics(model, data, q)
    moved = origin.actInv(data.oMf[model.getFrameId("cart")])
    assert abs(moved.translation @ normal) < 1e-12
    assert np.linalg.norm(moved.translation) == pytest.approx(math.hypot(2.0, 1.0))
    np.testing.assert_allclose(pin.log3(moved.rotation), 0.7 * normal / np.linalg.norm(normal), atol=1e-12)
    if axis == "0 0 1":  # as in MoveIt
        np.testing.assert_allclose(moved.translation, [2.0, -1.0, 0.0], atol=1e-12)


def arm(urdf):
    joints, posture = ["shoulder", "elbow"], [0.0, 0.0]
    return Plant(build_model(urdf, joints, posture, floating_base=False), arm_settings(joints, posture))


def test_inertias_of_flat_links_and_of_no_body(caplog):
    """Flat links are accepted; links for frames often have an invalid inertia, which MuJoCo refuses."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        rotation = pin.exp3(rng.normal(size=3))
        x, y = rng.uniform(0.01, 1.0, size=2)
        tensor = rotation @ np.diag([x, y, x + y]) @ rotation.T
        places = {f"i{'xyz'[i]}{'xyz'[j]}": (i, j) for i in range(3) for j in range(i, 3)}
        inertia = " ".join(f'{name}="{float(tensor[place])!r}"' for name, place in places.items())
        arm(ARM.replace('ixx="IXX" iyy="0.1" izz="0.01" ixy="0.001" ixz="0" iyz="0"', inertia))
    valid = ARM.replace("IXX", "0.1")
    assert "robot.urdf: MuJoCo" in refusal(arm, valid.replace('<mass value="1"/>', '<mass value="0"/>'))
    arm(valid)
    assert not caplog.text
    plant = arm(ARM.replace("IXX", "9"))
    assert "invalid inertia of lower: " in caplog.text
    body = plant.model.body("lower")
    np.testing.assert_allclose(body.inertia, (9.0 + 0.1 + 0.01) / 3.0)
