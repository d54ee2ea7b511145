"""Processes on simulated time on an overloaded computer."""

import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.live

#: Number and duration of busy processes, s.
BUSY, LONGEST = 2, 300


@pytest.fixture
def busy():
    """A computer with a load average above `BUSY`."""
    compute = f"import time\nend = time.monotonic() + {LONGEST}\nwhile time.monotonic() < end:\n    pass"
    processes = [subprocess.Popen([sys.executable, "-c", compute]) for _ in range(BUSY)]
    yield
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.parametrize(("factor", "duration"), [(1.0, 2.0), (0.05, 0.2)])
def test_on_a_busy_computer_a_controller_stays_active(processes, dds_user, busy, factor, duration):
    user = dds_user
    mock = processes.start("mock", "go2", "--patient", "--real-time-factor", str(factor))
    controller = processes.start("run", "go2", "--activate", "--use-sim-time")
    user.until(lambda: user.mode not in ("", "inactive"), "activation", patience=120.0)
    user.run(duration)
    for paused, seconds in ((mock, 0.5), (controller, 1.0)):
        paused.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        paused.send_signal(signal.SIGCONT)
        user.run(0.5 * duration)
    assert [content.data for content in user.all("controller", "state")][-1] == "active"
    assert not any(content.data.startswith("damping") for content in user.all("controller", "state"))
