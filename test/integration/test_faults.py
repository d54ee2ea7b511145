"""Real processes: invalid messages, and an overloaded computer."""

import signal
import time

import numpy as np
import pytest
from busy import busy_processes

from wbc_controller.recording.recording_file import Recording

pytestmark = pytest.mark.live


def test_bad_inputs_over_the_wire_are_refused_and_do_no_harm(processes, dds_user, patient_robot, make, tmp_path):
    user, record = dds_user, tmp_path / "cycles.mcap"
    processes.start("mock", patient_robot)
    controller = processes.start("run", patient_robot, "--record", str(record), "--use-sim-time")
    user.wait_for_service()
    model = user.model
    joints, na = model.joints, model.na
    good = np.array(model.posture)
    still = np.zeros(na)
    nan = good.copy()
    nan[4] = np.nan
    nowhere = make.frame_trajectory([(1.0, [[0, 0, 0.3, 0, 0, 0, 1]])], "laser")
    cases = [
        ("joint_states", "", make.joint_state(joints, nan, still), f"/joint_states: position of '{joints[4]}' is nan"),
        ("joint_states", "", make.joint_state(joints[:5], good[:5], still[:5]), f"/joint_states: {na - 5} of"),
        ("joint_states", "", make.joint_state([], [], []), f"/joint_states: {na} of {na} joints are missing"),
        ("odom", "", make.odom([0, 0, 0.3, 0, 0, 0, 0], child="base"), "/odom: the orientation [0, 0, 0, 0] is not a"),
        ("odom", "", make.odom([0, 0, 0.3, 0, 0, 0, 1], child="torso"), "/odom: child_frame_id is 'torso'"),
        ("setpoint", "com", make.point([0, np.nan, 0]), "tasks/com/setpoint: the point is not finite"),
        ("trajectory", "com", nowhere, "tasks/com/trajectory: frame_id is 'laser'"),
        ("weight", "com", make.float64(-1.0), "tasks/com/weight: weight is -1.0; valid: 0 to 1e6"),
        ("update", "", make.string("{tasks: {comm: {weight: 1}}}"), "/update: unknown task 'comm'; did you mean"),
        ("update", "", make.string("{tasks: {com: "), "/update: not valid YAML"),
        ("command", "", make.string("actvate"), "command 'actvate' is unknown; did you mean 'activate'?"),
        ("command", "", make.string("reset"), "command 'reset' is refused while active"),
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
    assert processes.stop(controller) == 0
    cycles = Recording(record).arrays()
    tau, follows = cycles["tau"], np.diff(cycles["number"]) == 1  # a busy machine drops some
    assert np.count_nonzero(follows) > 100
    for torques in (tau, wire):
        assert np.isfinite(torques).all()
        assert (np.abs(torques) <= model.effort_limits).all()
    step = user.settings.limits.torque_rate / user.settings.control.rate * model.effort_limits
    assert (np.abs(np.diff(tau, axis=0))[follows] <= step + 1e-9).all()
    assert set(cycles["mode"].tolist()) <= {"active", "stopped"}


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
