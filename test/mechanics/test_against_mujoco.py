"""Motions and constraint forces compared with MuJoCo.

MuJoCo's constraints are soft: an impedance of at most 0.9999, and a time constant for errors. Tolerances depend on it.
"""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from mechanisms import ball, box, four_bar, move, random_state

from wbc_controller import mechanics as wbm
from wbc_controller.simulation.plant import Plant

STIFF = 'solref="0.01 1" solimp="0.9999 0.9999 0.001"'


@pytest.mark.parametrize("name", ["go2", "g1", "talos"])
def test_free_flight_agrees_to_rounding(robot_of, name):
    """Without constraints: accelerations to 1e-8 of the largest, for random torques."""
    settings, model = robot_of(name)
    plant = Plant(model, settings)
    plant.hold(False, 0.0)
    rng = np.random.default_rng(0)
    S = wbm.actuation_matrix(model.pinocchio, model.joints)
    for _ in range(5):
        q, v = random_state(model.pinocchio, rng, speed=0.5)
        # Within joint limits and above the floor, where MuJoCo has no springs.
        middle = 0.5 * (model.position_lower + model.position_upper)
        q[model.q_index] = middle + 0.2 * (model.position_upper - middle) * rng.uniform(-1, 1, model.na)
        q[2] += 10.0
        tau = 0.1 * plant.effort_limits * rng.uniform(-1, 1, model.na)
        plant.set_state(q, v)
        plant.apply(tau)
        plant.forward()
        for found, given in zip(plant.state(), (q, v), strict=True):
            np.testing.assert_allclose(found, given, atol=1e-12)
        expected = wbm.forward_dynamics(model.pinocchio, q, v, S.T @ tau)
        assert np.abs(plant.acceleration() - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.fixture
def standing(robot_of):
    """Go2 at rest on its feet, with springs at its joints."""
    settings, model = robot_of("go2")
    plant = Plant(model, settings)
    inertia = pin.crba(model.pinocchio, model.pinocchio.createData(), plant.state()[0]).diagonal()[model.v_index]
    gain = 12.0 * model.mass * np.clip(inertia / inertia.max(), 0.05, 1.0)
    plant.hold(False, 0.0)
    for _ in range(round(1.0 / plant.step_seconds)):
        q, v = plant.state()
        plant.apply(gain * (model.posture - q[model.q_index]) - 0.03 * gain * v[model.v_index])
        plant.step()
    return settings, model, plant


def contact_forces(settings, model, plant):
    """Motion by the applied torques, its contact forces, and those of MuJoCo, (4, 3)."""
    specs = settings.contacts.values()
    feet = [wbm.Rolling(frame=spec.frame, radius=spec.radius, centre=np.array(spec.translation)) for spec in specs]
    force = wbm.actuation_matrix(model.pinocchio, model.joints).T @ plant.applied_torques
    motion = wbm.constrained_dynamics(model.pinocchio, *plant.state(), force, feet)
    return motion, motion.multipliers.reshape(4, 3), np.array(list(plant.contact_wrenches().values()))


def test_a_standing_quadruped_has_the_same_contact_forces(standing):
    """At rest: force of each foot to 0.1 % of its load."""
    settings, model, plant = standing
    assert np.abs(plant.state()[1]).max() < 0.05
    _, ours, theirs = contact_forces(settings, model, plant)
    weight = model.mass * model.gravity
    assert np.abs(ours - theirs).max() < 0.001 * weight / 4, (ours, theirs)
    assert np.allclose(ours.sum(axis=0), theirs.sum(axis=0), atol=0.001 * weight)


@pytest.mark.parametrize("torque", [-1.0, 1.0])
def test_a_jolt_of_torque_changes_the_contact_forces_alike(standing, torque):
    """The same robot at a torque step: forces to 0.5 % of the weight.

    Accelerations to 10 % of the largest: 2 % of the feet's motion, left by the impedance, moves the light calves.
    """
    settings, model, plant = standing
    plant.apply(plant.applied_torques + torque * np.tile([0.0, 1.0, -1.0], 4))
    plant.forward()
    motion, ours, theirs = contact_forces(settings, model, plant)
    assert (np.linalg.norm(ours[:, :2], axis=1) < 0.6 * ours[:, 2]).all()  # otherwise MuJoCo's feet slide
    assert np.abs(ours - theirs).max() < 0.005 * model.mass * model.gravity
    assert np.abs(motion.v_dot - plant.acceleration()).max() < 0.1 * np.abs(motion.v_dot).max()


def mujoco_four_bar(model):
    def inertial(joint):
        inertia, (x, y, z) = model.inertias[joint], np.diag(model.inertias[joint].inertia)
        place = f'mass="{inertia.mass:.17g}" pos="{inertia.lever[0]:.17g} 0 0"'
        return f'<inertial {place} diaginertia="{x:.17g} {y:.17g} {z:.17g}"/>'

    return f"""
<mujoco><option timestep="0.0005" integrator="RK4" tolerance="1e-14" iterations="200"/>
<worldbody>
  <body name="crank"><joint name="crank" axis="0 1 0"/>{inertial(1)}
    <body name="coupler" pos="0.2 0 0"><joint name="coupler" axis="0 1 0"/>{inertial(2)}</body></body>
  <body name="rocker" pos="0.5 0 0"><joint name="rocker" axis="0 1 0"/>{inertial(3)}</body>
</worldbody>
<equality><connect name="loop" body1="coupler" body2="rocker" anchor="0.5 0 0" {STIFF}/></equality></mujoco>
"""


def test_a_four_bar_moves_and_strains_alike():
    """Impedance 0.9999: angles over one second to 1e-5 rad, force of the pin to 0.1 % of the largest."""
    model, loop, q, v = four_bar()
    steps = 500
    qs, vs = move(model, loop, q, v, 2e-3, steps)

    theirs = mujoco.MjModel.from_xml_string(mujoco_four_bar(model))
    data = mujoco.MjData(theirs)
    # The anchor is defined at qpos0; place the second one where the loop closes.
    theirs.eq_data[0, 3:6] = [0.4, 0.0, 0.0]
    data.qpos[:], data.qvel[:] = q, v
    worst_angle, forces = 0.0, []
    for k in range(steps + 1):
        worst_angle = max(worst_angle, np.abs(data.qpos - qs[k]).max())
        if k % 10 == 0:
            # Force at our state, without error correction.
            probe = mujoco.MjData(theirs)
            probe.qpos[:], probe.qvel[:] = qs[k], vs[k]
            mujoco.mj_forward(theirs, probe)
            motion = wbm.constrained_dynamics(model, qs[k], vs[k], np.zeros(3), loop)
            forces.append((motion.multipliers, probe.efc_force[:3].copy()))
        mujoco.mj_step(theirs, data, nstep=4)
    ours, others = (np.array(column) for column in zip(*forces, strict=True))
    assert worst_angle < 1e-5, worst_angle
    assert np.abs(ours).max() > 5.0
    assert np.abs(ours - others).max() < 0.001 * np.abs(ours).max(), np.abs(ours - others).max()


def test_a_ball_rolls_down_a_slope_alike():
    """Impedance 0.9999: speed after 0.5 s, friction and normal force to 0.1 %."""
    angle = 0.3
    xml = f"""
    <mujoco><option timestep="0.0005" gravity="{9.81 * np.sin(angle)} 0 {-9.81 * np.cos(angle)}" cone="elliptic"
      impratio="10" tolerance="1e-14"/>
    <worldbody><geom type="plane" size="0 0 1" friction="2 0 0" {STIFF}/>
      <body pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.1" mass="2" friction="2 0 0" {STIFF}/></body>
    </worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(theirs)
    mujoco.mj_step(theirs, data, nstep=1000)
    local = np.zeros(6)
    mujoco.mj_contactForce(theirs, data, 0, local)

    model = ball(2.0)
    model.gravity = pin.Motion(np.array([9.81 * np.sin(angle), 0, -9.81 * np.cos(angle), 0, 0, 0]))
    rolling = [wbm.Rolling(frame="ball_link", radius=0.1, height=-0.1)]
    q, zero = pin.neutral(model), np.zeros(6)
    motion = wbm.constrained_dynamics(model, q, zero, zero, rolling)
    _, vs = move(model, rolling, q, zero, 0.01, 50)
    assert data.qvel[0] == pytest.approx(np.linalg.norm(vs[-1][:3]), rel=0.001)
    assert data.qvel[4] == pytest.approx(vs[-1][4], rel=0.001)
    assert local[0] == pytest.approx(motion.multipliers[2], rel=0.001)
    assert np.linalg.norm(local[1:3]) == pytest.approx(np.linalg.norm(motion.multipliers[:2]), rel=0.001)


@pytest.mark.parametrize(("lift", "moment"), [(0.0, 0.0), (0.0, 8.0), (0.0, -22.0), (1.2, 0.0)])
def test_box_at_rest_tipping_and_lifted(lift, moment):
    """Unilateral contacts at rest, unevenly loaded, tipping, lifted: corner forces to 0.1 % of the weight.

    Four corners are redundant: the sums of both sides are compared.
    """
    size, mass = (0.4, 0.3, 0.5), 10.0
    model, floor = box(size, mass)
    balls = "".join(
        f'<geom type="sphere" size="0.001" pos="{x} {y} {z + 0.001}" mass="0" condim="1" {STIFF}/>'
        for x, y, z in (contact.offset for contact in floor)
    )
    diagonal = " ".join(f"{x:.17g}" for x in np.diag(model.inertias[1].inertia))
    xml = f"""
    <mujoco><option timestep="0.0005" tolerance="1e-14"/><worldbody><geom type="plane" size="0 0 1" condim="1" {STIFF}/>
      <body pos="0 0 {size[2] / 2}"><freejoint/><inertial pos="0 0 0" mass="{mass}" diaginertia="{diagonal}"/>{balls}
      </body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(theirs)
    mujoco.mj_step(theirs, data, nstep=200)  # settle
    weight = mass * 9.81
    force = data.xfrc_applied[1] = np.array([0, 0, lift * weight, moment, 0, 0])
    mujoco.mj_forward(theirs, data)
    local, sides = np.zeros(6), np.zeros(2)
    for index in range(data.ncon):
        mujoco.mj_contactForce(theirs, data, index, local)
        sides[int(data.contact[index].pos[1] < 0.0)] += local[0]

    motion = wbm.constrained_dynamics(model, pin.neutral(model), np.zeros(6), force, unilateral=floor)
    ours = np.array([motion.push[[0, 2]].sum(), motion.push[[1, 3]].sum()])
    assert np.abs(ours - sides).max() < 0.001 * weight, (ours, sides)
    assert data.qacc[3] == pytest.approx(motion.v_dot[3], abs=0.001 * 9.81)
    assert data.qacc[2] == pytest.approx(motion.v_dot[2], abs=0.001 * 9.81)
    np.testing.assert_array_equal(ours == 0.0, [lift > 1.0, lift > 1.0 or moment < -0.15 * weight])
