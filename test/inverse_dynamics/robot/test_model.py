import re

import numpy as np
import pinocchio as pin
import pytest
from urdf_models import build_model

from wbc_controller.errors import ConfigurationError
from wbc_controller.settings.robot import JointLimitSettings

LEG = ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
POSTURE = (0.1, 0.8, -1.5)


@pytest.mark.parametrize("position", [9.0, np.nan])
def test_a_posture_outside_the_limits_is_refused(go2, position):
    said = rf"robot\.posture: {position} rad for 'FL_thigh_joint'.*\[-1\.5708, 3\.4907\]"
    with pytest.raises(ConfigurationError, match=said):
        build_model(go2.urdf, LEG, [0.1, position, -1.5])


def test_joint_with_the_name_of_a_link(go2):
    """The frame is then that of the link."""
    renamed = go2.urdf.replace('"FL_foot_joint"', '"FL_foot"').replace('"FR_foot_joint"', '"root_joint"')
    assert renamed.count('"root_joint"') == 1
    model = build_model(renamed, LEG, POSTURE)
    assert model.joints == LEG
    for name in ("FL_foot", "FR_foot"):
        frame = model.pinocchio.frames[model.frame_id(name, "here")]
        assert (frame.name, frame.type) == (name, pin.BODY)
    with pytest.raises(ConfigurationError, match="here = 'FX_foot': the robot has no such frame"):
        model.frame_id("FX_foot", "here")


def test_continuous_joint_has_one_coordinate(go2):
    joint = re.search(r'<joint\s+name="FL_thigh_joint".*?</joint>', go2.urdf, re.DOTALL).group()
    broken = go2.urdf.replace(joint, joint.replace('type="revolute"', 'type="continuous"'))
    assert broken != go2.urdf
    model, plain = build_model(broken, LEG, POSTURE), build_model(go2.urdf, LEG, POSTURE)
    assert (model.nq, model.nv) == (plain.nq, plain.nv)
    i = LEG.index("FL_thigh_joint")
    assert model.position_upper[i] == -model.position_lower[i] == 1.0e6
    q = model.configuration(model.posture)
    assert pin.crba(model.pinocchio, model.pinocchio.createData(), q) == pytest.approx(
        pin.crba(plain.pinocchio, plain.pinocchio.createData(), q)
    )
    assert 'type="continuous"' not in model.urdf


def test_joint_limits_replace_the_urdf(go2):
    given = {"FL_thigh_joint": JointLimitSettings(effort=11.0, velocity=5.0, lower=-0.5, upper=1.5),
             "FL_calf_joint": JointLimitSettings(effort=12.0)}  # fmt: skip
    model, plain = build_model(go2.urdf, LEG, POSTURE, joint_limits=given), build_model(go2.urdf, LEG, POSTURE)
    i, j = LEG.index("FL_thigh_joint"), LEG.index("FL_calf_joint")
    assert (model.effort_limits[i], model.velocity_limits[i]) == (11.0, 5.0)
    assert (model.position_lower[i], model.position_upper[i]) == (-0.5, 1.5)
    assert model.effort_limits[j] == 12.0
    assert model.velocity_limits[j] == plain.velocity_limits[j]
    assert model.position_upper[j] == plain.position_upper[j]
    # Readers of the model's URDF, such as the mock robot, have the same limits.
    again = build_model(model.urdf, LEG, POSTURE)
    assert again.effort_limits.tolist() == model.effort_limits.tolist()
    assert plain.urdf == go2.urdf
    with pytest.raises(ConfigurationError, match=r"joint_limits: 'FL_tigh_joint' is not .* did you mean 'FL_thigh_j"):
        build_model(go2.urdf, LEG, POSTURE, joint_limits={"FL_tigh_joint": JointLimitSettings(effort=1.0)})


def test_a_joint_without_limits_is_named(go2):
    joint = re.search(r'<joint\s+name="FL_thigh_joint".*?</joint>', go2.urdf, re.DOTALL).group()
    bare = go2.urdf.replace(joint, re.sub(r"<limit.*?/>", "", joint, flags=re.DOTALL))
    with pytest.raises(ConfigurationError, match=r"'FL_thigh_joint': it has no <limit effort=…>; add it, or set robot"):
        build_model(bare, LEG, POSTURE)
    whole = {"FL_thigh_joint": JointLimitSettings(effort=11.0, velocity=5.0, lower=-0.5, upper=1.5)}
    assert build_model(bare, LEG, POSTURE, joint_limits=whole).effort_limits[LEG.index("FL_thigh_joint")] == 11.0
    crossed = {"FL_thigh_joint": JointLimitSettings(lower=9.0)}
    with pytest.raises(ConfigurationError, match="'FL_thigh_joint': the lower limit 9 is above the upper"):
        build_model(go2.urdf, LEG, POSTURE, joint_limits=crossed)


def test_order_of_the_joints(go2):
    order = np.random.default_rng(0).permutation(go2.na)
    shuffled = build_model(go2.urdf, [go2.joints[i] for i in order], go2.posture[order], armature=0.01)
    assert shuffled.joints == tuple(go2.joints[i] for i in order)
    base = pin.SE3.Random()
    np.testing.assert_allclose(pin.XYZQUATToSE3(go2.configuration(go2.posture, base)[:7]).homogeneous, base.homogeneous)
    np.testing.assert_array_equal(go2.configuration(go2.posture)[:7], [0, 0, 0, 0, 0, 0, 1])
    for name in ("effort_limits", "velocity_limits", "position_lower", "position_upper", "posture"):
        np.testing.assert_array_equal(getattr(shuffled, name), getattr(go2, name)[order])
    joints = np.linspace(-0.3, 0.3, go2.na)
    np.testing.assert_array_equal(shuffled.configuration(joints[order]), go2.configuration(joints))
    for i, name in enumerate(shuffled.joints):
        joint = shuffled.pinocchio.joints[shuffled.pinocchio.getJointId(name)]
        assert (joint.idx_q, joint.idx_v) == (shuffled.q_index[i], shuffled.v_index[i])


def test_limits_and_armature(go2):
    whole, half = (build_model(go2.urdf, LEG, POSTURE, effort_limit_scale=s, armature=0.03) for s in (1.0, 0.5))
    np.testing.assert_allclose(whole.effort_limits, [23.7, 23.7, 45.43])
    np.testing.assert_allclose(half.effort_limits, 0.5 * whole.effort_limits)
    np.testing.assert_array_equal(whole.pinocchio.armature[whole.v_index], [0.03] * 3)
    assert not whole.pinocchio.armature[:6].any()
    for name in ("effort_limits", "velocity_limits", "position_lower", "position_upper", "posture"):
        assert not getattr(whole, name).flags.writeable


def test_unknown_names_are_refused_with_the_nearest_one(g1):
    with pytest.raises(ConfigurationError, match=r"tasks\.x\.frame = 'pelvs': .*did you mean 'pelvis'\? Valid: "):
        g1.frame_id("pelvs", "tasks.x.frame")
    with pytest.raises(ConfigurationError, match=r"tasks\.x\.joints: 'left_knee' .*did you mean 'left_knee_joint'"):
        g1.joint_columns(["left_knee"], "tasks.x.joints")
    np.testing.assert_array_equal(g1.joint_columns([], "x"), np.arange(g1.na))
    np.testing.assert_array_equal(g1.joint_columns(["waist_yaw_joint"], "x"), [12])
