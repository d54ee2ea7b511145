"""One scenario on every transport: by topics alone, from hanging on the hoist to standing on three legs and back."""

import numpy as np
import pytest

pytestmark = pytest.mark.live


def test_stand_move_and_change_by_topics(user, make):
    weight = user.model.mass * user.model.gravity
    user.wait_for_service()
    assert user.mode == "inactive"
    user.activate()
    user.run(0.6)
    user.send("mock", "hold", make.bool(False))
    user.run(1.2)  # stand
    for owner in ("controller", "mock"):
        force = user.vertical_force(owner, 0.5)
        assert len(force) > 20
        np.testing.assert_allclose(force, weight, rtol=0.01, err_msg=owner)

    start = user.com()
    target = start + np.array([0.0, 0.02, 0.0])
    user.send("controller", "setpoint", make.point(target), "com")
    user.run(1.2)
    assert np.linalg.norm(user.com() - target) < 0.003

    # Several changes at once: back again, with other weights.
    x, y, z = start + np.array([-0.03, -0.03, 0.0])
    tasks = f"{{com: {{weight: 40, setpoint: [{x:.6f}, {y:.6f}, {z:.6f}]}}, posture: {{weight: 0.004}}}}"
    update = f"{{tasks: {tasks}, contacts: {{rear_right_foot: {{enabled: true}}}}}}"
    user.send("controller", "update", make.string(update))
    user.run(1.2)
    assert np.linalg.norm(user.com() - [x, y, z]) < 0.003

    # The centre of mass is over the other three legs.
    user.send("controller", "weight", make.float64(45.0), "com")
    user.send("controller", "task_enable", make.bool(False), "base")
    user.send("controller", "contact_enable", make.bool(False), "front_left_foot")
    user.run(0.6)
    place = "controller", "contact_wrench", "front_left_foot"
    count = len(user.arrivals[place])
    user.run(0.2)
    assert len(user.arrivals[place]) == count  # no longer in the QP
    assert np.linalg.norm(user.com() - [x, y, z]) < 0.005
    user.send("controller", "task_enable", make.bool(True), "base")
    user.send("controller", "contact_enable", make.bool(True), "front_left_foot")
    user.run(0.6)
    assert len(user.arrivals[place]) > count
    assert user.last(*place).wrench.force.z > 1.0
    assert np.linalg.norm(user.com() - [x, y, z]) < 0.003

    assert user.mode == "active"
    assert not [sentence for sentence in user.refusals() if "'activate'" not in sentence]
    user.send("mock", "hold", make.bool(True))
    user.run(0.3)
    user.command("deactivate")
    user.until(lambda: user.mode == "inactive", "the end of the ramp")
    efforts = user.efforts()
    assert len(efforts) > 1000
    assert np.isfinite(efforts).all()
    assert (np.abs(efforts) <= user.model.effort_limits).all()
    assert not efforts[0].any()
