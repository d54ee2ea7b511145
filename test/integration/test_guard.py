"""Real processes: the controller is killed, and the guard damps the robot until another one takes over."""

from __future__ import annotations

import time

import numpy as np
import pytest

from wbc_controller.service.guard_service import NODE_NAME
from wbc_controller.wire.messages import decode
from wbc_controller.wire.topics import GUARD_TOPICS, endpoints

pytestmark = pytest.mark.live

#: Time from the first missed command to damping torque on the topic, s, on a machine that is never late itself.
WITHIN = 0.02


@pytest.fixture
def user(processes, dds_user):
    """A user of a mock robot, a controller and a guard, three processes."""
    user = dds_user
    (state,) = endpoints([topic for topic in GUARD_TOPICS if topic.key == "state"], NODE_NAME)
    user.open("guard", state, user.transport)
    processes.start("mock", "go2")
    user.guard = processes.start("guard", "go2")
    user.controller = processes.start("run", "go2")
    user.wait_for_service()
    return user


def guard_says(user):
    return user.last("guard", "state").data if user.arrivals["guard", "state", ""] else ""


def guard_states(user):
    """Times and texts of everything that the guard has said."""
    return [
        (when, decode(payload, "std_msgs/msg/String").data) for when, payload in user.arrivals["guard", "state", ""]
    ]


def torques(user, key):
    """Times and torques of every message on one of the controller's command topics."""
    kept = list(user.arrivals["controller", key, ""])
    kind, field = {
        "effort": ("std_msgs/msg/Float64MultiArray", "data"),
        "joint_commands": ("sensor_msgs/msg/JointState", "effort"),
    }[key]
    return [when for when, _ in kept], np.array([getattr(decode(payload, kind), field) for _, payload in kept])


def test_a_killed_controller_is_followed_by_damping_and_another_one_takes_over(user, processes, record_property):
    user.activate()
    user.until(lambda: guard_says(user) == "watching", "the guard to watch")
    user.run(1.3)
    assert user.efforts()[-1].any()

    user.controller.kill()
    user.until(lambda: guard_says(user).startswith("damping COMMANDS_STOPPED: "), "the guard's damping")
    times, _ = torques(user, "joint_commands")
    last = times[-1]
    user.run(0.5)
    when, tau = torques(user, "effort")
    damping = [i for i, time_ in enumerate(when) if time_ > last + 1e-3]
    missed = last + 1.0 / user.settings.control.rate
    delay = when[damping[0]] - missed
    # How late this machine was meanwhile, by the robot, whose states should come once in a period.
    states = [time_ for time_, _ in user.arrivals["mock", "joint_states", ""] if last - 0.1 < time_ < last + 0.1]
    lateness = max(np.diff(states)) - 1.0 / user.settings.control.rate
    record_property("damping_after_first_missed_command_ms", round(1e3 * delay, 1))
    print(f"damping {1e3 * delay:.1f} ms after the first missed command; the machine was {1e3 * lateness:.1f} ms late")
    # Two processes stand between the two: the guard, and this one, which dates what arrives. Each may be as late.
    assert delay <= WITHIN + 2.0 * lateness
    # Three messages later the torques are those of the damping, as far as they may be.
    limits, share = user.model.effort_limits, user.settings.guard.torque
    assert (np.abs(tau[damping[3:]]) <= share * limits + 1e-9).all()
    assert len(damping) > 150  # about one in each period

    # Another controller: it waits, and the guard goes on; it is activated, and the guard is silent.
    user.arrivals["controller", "state", ""].clear()
    user.controller = processes.start("run", "go2")
    user.until(lambda: user.mode == "inactive", "the new controller")
    assert guard_says(user).startswith(("damping", "zero", "released"))
    activated = time.monotonic()
    user.activate()
    user.run(1.3)
    user.until(lambda: guard_says(user) == "watching", "the guard to watch again")
    since = time.monotonic()
    user.run(0.3)
    step = user.settings.limits.torque_rate / user.settings.control.rate * limits
    taken_over = user.efforts(activated - 0.1)
    again = [said for when_, said in guard_states(user) if when_ > activated and said.startswith("damping")]
    if again:  # back from a mere gap, the torques are the controller's at once
        print(f"this machine kept the controller from its commands, and the guard damped again: {again}")
    else:
        assert (np.abs(np.diff(taken_over, axis=0)) <= step + 1e-9).all()
    assert np.isfinite(taken_over).all()
    when, tau = torques(user, "effort")
    commanded = {row.tobytes() for row in torques(user, "joint_commands")[1]}
    if user.arrivals["guard", "state", ""][-1][0] < since:  # this machine was not so late that it damped again
        assert all(row.tobytes() in commanded for time_, row in zip(when, tau, strict=True) if time_ > since)

    # Told to end, the controller leaves zero torques, and there is nothing to guard.
    assert processes.stop(user.controller) == 0
    user.until(lambda: guard_says(user) == "idle", "the guard to rest")
    assert not user.efforts()[-1].any()
    ended = time.monotonic()
    user.run(0.2)
    assert not len(user.efforts(ended))
    assert processes.stop(user.guard) == 0
