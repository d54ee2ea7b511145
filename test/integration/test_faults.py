"""Real processes: a robot that dies during a run, invalid messages, and an overloaded computer."""

import re
import signal
import time

import numpy as np
import pytest
from busy import busy_processes

from wbc_controller.recording.recording_file import Recording

pytestmark = pytest.mark.live

#: Number of stops of the robot.
STOPS = 4
#: Largest delay of the detecting cycle in the fastest case, s.
LATE = 0.01


@pytest.fixture
def start(processes, dds_user, tmp_path):
    """Starts a mock robot and a controller that records every command; gives their user."""

    def start(robot, *words):
        user = dds_user
        user.record = tmp_path / "cycles.mcap"
        user.mock = processes.start("mock", robot)
        user.controller = processes.start("run", robot, "--record", str(user.record), *words)
        user.wait_for_service()
        return user

    return start


def recorded(user, processes):
    """Return the recorded commands of the controller; a busy machine drops some."""
    assert processes.stop(user.controller) == 0
    return Recording(user.record).arrays()


def assert_bounded(user, cycles):
    tau, follows = cycles["tau"], np.diff(cycles["number"]) == 1
    assert np.count_nonzero(follows) > 100  # a busy machine sends fewer
    assert np.isfinite(tau).all()
    assert (np.abs(tau) <= user.model.effort_limits).all()
    step = user.settings.limits.torque_rate / user.settings.control.rate * user.model.effort_limits
    assert (np.abs(np.diff(tau, axis=0))[follows] <= step + 1e-9).all()


def test_a_robot_that_dies_is_damped_and_can_come_back(start, processes, record_property):
    """The fastest of several detections counts, by the controller's clock."""
    user = start("go2")
    noticed = []
    for _ in range(STOPS):
        user.activate_again()
        user.mock.send_signal(signal.SIGSTOP)
        user.until(lambda: user.mode.startswith("damping"), "damping")
        said = user.mode
        assert said.startswith("damping STALE_INPUT: ")
        ages = {name: 1e-3 * float(age) for name, age in re.findall(r"(\w+) is (\d+) ms old \(limit 50 ms\)", said)}
        assert ages, said
        assert set(ages) <= {"joint_states", "odom"}
        noticed.append(max(ages.values()))
        user.mock.send_signal(signal.SIGCONT)
    record_property("ages_at_damping_ms", [round(1e3 * age) for age in noticed])
    print(f"ages at damping: {noticed} s")
    timeout, cycle = user.settings.safety.state_timeout, 1.0 / user.settings.control.rate
    assert timeout <= min(noticed) <= timeout + cycle + LATE

    user.activate_again()
    user.mock.kill()
    killed = time.monotonic()
    user.mock.wait()
    user.until(lambda: user.mode.startswith("damping"), "damping")

    # Without velocities the torques ramp to zero; zero is still sent.
    start = time.monotonic()
    user.until(lambda: len(user.efforts(start)) > 20, "torques while damping")
    assert not user.efforts(start)[10:].any()
    after = user.efforts(killed)
    assert np.isfinite(after).all()
    assert (np.abs(after[-1]) == 0.0).all()

    user.command("activate")
    user.until(lambda: any("'activate' is refused in damping" in said for said in user.refusals()), "the refusal")
    assert user.mode.startswith("damping")

    user.mock = processes.start("mock", "go2")
    user.arrivals["mock", "joint_states", ""].clear()
    user.until(lambda: user.time > 0.0, "the states of the new robot")

    user.activate_again()  # after the killed robot has left the graph
    user.run(1.2)
    cycles = recorded(user, processes)
    assert_bounded(user, cycles)
    assert {"active", "damping"} <= set(cycles["mode"].tolist())
    # The shutdown command follows the last cycle.
    user.until(lambda: not user.efforts()[-1].any(), "the last command of a controller that was told to end")
    user.until(lambda: user.mode.startswith("stopped"), "its last mode")


def test_bad_inputs_over_the_wire_are_refused_and_do_no_harm(start, processes, patient_robot, make):
    user = start(patient_robot, "--use-sim-time")
    model = user.model
    joints, na = model.joints, model.na
    good = np.array(model.posture)
    still = np.zeros(na)
    nan = good.copy()
    nan[4] = np.nan
    nowhere = make.frame_trajectory([(1.0, [[0, 0, 0.3, 0, 0, 0, 1]])], "laser")
    cases = [
        ("joint_states", "", make.joint_state(joints, nan, still), f"/joint_states: position of '{joints[4]}' is nan"),
        ("odom", "", make.odom([0, 0, 0.3, 0, 0, 0, 0], child="base"), "/odom: the orientation [0, 0, 0, 0] is not a"),
        ("setpoint", "com", make.point([0, np.nan, 0]), "tasks/com/setpoint: the point is not finite"),
        ("trajectory", "com", nowhere, "tasks/com/trajectory: frame_id is 'laser'"),
        ("weight", "com", make.float64(-1.0), "tasks/com/weight: weight must be from 0 to 1e+06, not -1.0"),
        ("update", "", make.string("{tasks: {comm: {weight: 1}}}"), "/update: unknown task 'comm'; did you mean"),
        ("command", "", make.string("actvate"), "command 'actvate' is unknown; did you mean 'activate'?"),
    ]
    user.activate()
    user.run(1.2)
    for key, subject, content, said in cases:
        # Good states may overwrite a bad one: repeat it.
        user.until(
            lambda said=said: any(said in sentence for sentence in user.refusals()),
            f"a refusal with {said!r}",
            lambda key=key, content=content, subject=subject: user.send("controller", key, content, subject),
        )
        assert user.mode == "active", said
    user.run(0.5)
    assert user.mode == "active"
    assert [content.data for content in user.all("controller", "state")] == ["inactive", "active"]
    wire = user.efforts()
    cycles = recorded(user, processes)
    assert_bounded(user, cycles)
    assert set(cycles["mode"].tolist()) <= {"active", "stopped"}
    assert np.isfinite(wire).all()
    assert (np.abs(wire) <= model.effort_limits).all()


@pytest.mark.parametrize(("factor", "duration"), [(1.0, 1.0), (0.05, 0.1)])
def test_on_a_busy_computer_a_controller_stays_active(processes, dds_user, factor, duration):
    user = dds_user
    mock = processes.start("mock", "go2", "--patient", "--real-time-factor", str(factor))
    controller = processes.start("run", "go2", "--activate", "--use-sim-time")
    user.wait_for_service()
    with busy_processes(2):
        user.until(lambda: user.mode not in ("", "inactive"), "activation", patience=120.0)
        user.run(duration)
        for paused, seconds in ((mock, 0.5), (controller, 1.0)):
            paused.send_signal(signal.SIGSTOP)
            time.sleep(seconds)
            paused.send_signal(signal.SIGCONT)
            user.run(0.5 * duration)
    assert [content.data for content in user.all("controller", "state")][-1] == "active"
    assert not any(content.data.startswith("damping") for content in user.all("controller", "state"))
