"""Real processes: the controller is stopped or killed, and the guard damps the robot until another takes over.

A busy machine only adds delays, so that the fastest of several repetitions counts.
"""

import re
import signal
import time

import numpy as np
import pytest

from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import GUARD_NODE, GUARD_TOPICS, endpoints

pytestmark = pytest.mark.live

#: Number of stops of the controller.
STOPS = 4
#: Patiences from the last command to damping torque, in the fastest case: 1.2 on an idle machine, up to 2.6 at load 15.
AT_MOST = 4.0


@pytest.fixture
def user(processes, dds_user, patient_robot):
    """A user of a mock robot, a controller and a guard, three processes; only the guard's patience is short."""
    user = dds_user
    (state,) = endpoints([topic for topic in GUARD_TOPICS if topic.key == "state"], GUARD_NODE)
    user.open("guard", state, user.transport)
    processes.start("mock", patient_robot)
    user.guard = processes.start("guard", patient_robot)
    user.start = lambda: processes.start("run", patient_robot, "--use-sim-time")
    user.controller = user.start()
    user.wait_for_service()
    return user


def guard_says(user):
    return user.last("guard", "state").data if user.arrivals["guard", "state", ""] else ""


def guard_states(user):
    """Return times and texts of the guard's states."""
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


def takeover_after(user, last):
    """Return the time from the last command to the guard's first torque, s, observed by this process.

    The controller may have been stopped between the torques of a cycle and its command.
    """
    soon = 0.5 * user.settings.guard.patience
    commanded = {row.tobytes() for row in torques(user, "joint_commands")[1]}
    when, tau = torques(user, "effort")
    return (
        next(at for at, row in zip(when, tau, strict=True) if at > last + soon and row.tobytes() not in commanded)
        - last
    )


def test_a_controller_that_stands_still_or_dies_is_followed_by_damping(user, processes, record_property):
    patience = user.settings.guard.patience
    user.activate_again()
    user.run(1.3)
    delays, said = [], []
    for _ in range(STOPS):
        user.until(lambda: guard_says(user) == "watching", "the guard to watch")
        user.controller.send_signal(signal.SIGSTOP)
        stopped = time.monotonic()
        user.until(lambda: guard_says(user).startswith("damping COMMANDS_STOPPED: "), "the guard's damping")
        user.run(0.1)
        delays.append(
            takeover_after(user, max(at for at in torques(user, "joint_commands")[0] if at < stopped + patience))
        )
        said += [text for when, text in guard_states(user) if when > stopped and text.startswith("damping")]
        user.controller.send_signal(signal.SIGCONT)
    silences = [1e-3 * int(re.search(r"the last command came (\d+) ms ago", text)[1]) for text in said]
    record_property("damping_after_last_command_ms", [round(1e3 * delay, 1) for delay in delays])
    print(f"the guard's record: {silences} s; damping torque on the topic after {np.round(delays, 4)} s")
    assert patience <= min(silences) <= AT_MOST * patience
    assert min(delays) <= AT_MOST * patience

    user.until(lambda: guard_says(user) == "watching", "the guard to watch")
    user.controller.kill()
    user.until(lambda: guard_says(user).startswith("damping COMMANDS_STOPPED: "), "the guard's damping")
    last = torques(user, "joint_commands")[0][-1]
    user.run(0.5)
    when, tau = torques(user, "effort")
    damping = [i for i, time_ in enumerate(when) if time_ > last + 1e-3]
    # Some messages later the torques are damping torques within the rate.
    limits, share = user.model.effort_limits, user.settings.guard.torque
    assert (np.abs(tau[damping[6:]]) <= share * limits + 1e-9).all()
    assert len(damping) > 20  # one per period of 2 ms on an idle machine

    # The guard continues until another controller is activated.
    user.arrivals["controller", "state", ""].clear()
    user.controller = user.start()
    user.until(lambda: user.mode == "inactive", "the new controller")
    assert guard_says(user).startswith(("damping", "zero", "released"))
    activated = time.monotonic()
    user.activate()
    user.run(1.3)
    user.until(lambda: guard_says(user) == "watching", "the guard to watch again")
    since = time.monotonic()
    user.run(0.3)
    step = user.settings.limits.torque_rate / user.settings.control.rate * limits
    again = [(when_, said) for when_, said in guard_states(user) if when_ > activated and said.startswith("damping")]
    if again:
        print(f"this machine kept the controller from its commands, and the guard damped again: {again}")
    # Later, commands of a late controller cross messages of the guard.
    when, tau = torques(user, "effort")
    until = again[0][0] if again else np.inf
    taken_over = np.array([row for time_, row in zip(when, tau, strict=True) if activated - 0.1 < time_ < until])
    assert len(taken_over) > (1 if again else 20)
    assert (np.abs(np.diff(taken_over, axis=0)) <= step + 1e-9).all()
    assert np.isfinite(tau).all()
    commanded = {row.tobytes() for row in torques(user, "joint_commands")[1]}
    if user.arrivals["guard", "state", ""][-1][0] < since:  # no second takeover
        assert all(row.tobytes() in commanded for time_, row in zip(when, tau, strict=True) if time_ > since)

    # At its end the controller sends zero torques.
    assert processes.stop(user.controller) == 0
    user.until(lambda: guard_says(user) == "idle", "the guard to rest")
    assert not user.efforts()[-1].any()
    ended = time.monotonic()
    user.run(0.2)
    assert not len(user.efforts(ended))
    assert processes.stop(user.guard) == 0
