"""Processes on simulated time on an overloaded computer."""

import signal
import time

import pytest
from busy import busy_processes

pytestmark = pytest.mark.live


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
