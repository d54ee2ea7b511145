"""Real processes: the controller is killed, and the guard damps the robot until another one takes over."""

import time

import numpy as np
import pytest

pytestmark = pytest.mark.live


@pytest.fixture
def user(processes, dds_user, patient_robot):
    """A user of a mock robot, a controller and a guard, three processes; only the guard's patience is short."""
    user = dds_user
    processes.start("mock", patient_robot)
    user.guard = processes.start("guard", patient_robot)
    user.start = lambda: processes.start("run", patient_robot, "--use-sim-time")
    user.controller = user.start()
    user.wait_for_service()
    return user


def guard_says(user):
    return user.last("guard", "state").data if user.arrivals["guard", "state", ""] else ""


def torques(user, key):
    """Times and torques of every message on one of the controller's command topics."""
    field = {"effort": "data", "joint_commands": "effort"}[key]
    kept = user.timed("controller", key)
    return np.array([when for when, _ in kept]), np.array([getattr(content, field) for _, content in kept])


def test_a_controller_that_dies_is_followed_by_damping_until_another_takes_over(user, processes):
    user.activate_again()
    user.run(1.0)
    user.until(lambda: guard_says(user) == "watching", "the guard to watch")
    user.controller.kill()
    user.until(lambda: guard_says(user).startswith("damping COMMANDS_STOPPED: "), "the guard's damping")
    last = torques(user, "joint_commands")[0][-1]
    user.run(0.5)
    when, tau = torques(user, "effort")
    damping = tau[when > last + 1e-3]
    # Some messages later the torques are damping torques within the rate.
    limits, share = user.model.effort_limits, user.settings.guard.torque
    assert (np.abs(damping[6:]) <= share * limits + 1e-9).all()
    assert len(damping) > 20  # one per period of 2 ms on an idle machine

    # The guard continues until another controller is activated.
    user.arrivals["controller", "state", ""].clear()
    user.controller = user.start()
    user.until(lambda: user.mode == "inactive", "the new controller")
    assert guard_says(user).startswith(("damping", "zero", "released"))
    activated = time.monotonic()
    user.activate()
    user.run(1.0)
    user.until(lambda: guard_says(user) == "watching", "the guard to watch again")
    since = time.monotonic()
    user.run(0.3)
    step = user.settings.limits.torque_rate / user.settings.control.rate * limits
    states = [(when, content.data) for when, content in user.timed("guard", "state", since=activated)]
    again = [(when, said) for when, said in states if said.startswith("damping")]
    if again:
        print(f"this machine kept the controller from its commands, and the guard damped again: {again}")
    # Later, commands of a late controller cross messages of the guard.
    when, tau = torques(user, "effort")
    until = again[0][0] if again else np.inf
    taken_over = tau[(activated - 0.1 < when) & (when < until)]
    assert len(taken_over) > (1 if again else 20)
    assert (np.abs(np.diff(taken_over, axis=0)) <= step + 1e-9).all()
    assert np.isfinite(tau).all()
    commanded = {row.tobytes() for row in torques(user, "joint_commands")[1]}
    if user.arrivals["guard", "state", ""][-1][0] < since:  # no second takeover
        assert all(row.tobytes() in commanded for row in tau[when > since])

    # At its end the controller sends zero torques.
    assert processes.stop(user.controller) == 0
    user.until(lambda: guard_says(user) == "idle", "the guard to rest")
    assert not user.efforts()[-1].any()
    ended = time.monotonic()
    user.run(0.2)
    assert not len(user.efforts(ended))
    assert processes.stop(user.guard) == 0
