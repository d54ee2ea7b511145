"""`wbc view` with a controller and a mock robot on rclpy: display and commands."""

import re
import signal

import pytest
from busy import patience
from forked import fork_node, fork_wbc
from launching import PATIENCE, patient

pytest.importorskip("viser", reason="the page requires viser: pip install 'wbc_controller[view]'")

from browser import Browser

pytestmark = pytest.mark.live


@pytest.fixture
def page(environment, user, tmp_path):
    """A browser on the page of Go2 with permission to command."""
    log = tmp_path / "view.log"
    view = fork_wbc(environment, log, "view", "go2", "--command", "--port", "0")
    browsers = []

    def opened():
        user.until(lambda: "page: " in log.read_text() or view.poll() is not None)
        (port,) = re.findall(r"page: http://\S+?:(\d+)", log.read_text())
        browsers.append(Browser(int(port)))
        return browsers[-1]

    yield opened
    for browser in browsers:
        browser.close()
    view.send_signal(signal.SIGINT)
    assert view.wait(patience(PATIENCE)) == 0, log.read_text()


def test_it_shows_and_commands_nodes_of_ros2(environment, user, page, tmp_path):
    until, states = user.until, user.hear("/wbc_controller/state", latched=True)
    odometry, holds = user.hear("/odom", "nav_msgs/msg/Odometry"), user.hear("/mock_robot/hold", "std_msgs/msg/Bool")
    config = f"config:={patient('go2', tmp_path)}"
    nodes = [
        fork_node(environment, tmp_path / "mock.log", "mock_main", config, "real_time_factor:=0.5"),
        fork_node(environment, tmp_path / "run.log", "main", config, "activate:=true", "use_sim_time:=true"),
    ]
    try:
        until(lambda: states[-1:] == ["active"])
        browser = page()

        def says(text):
            return any(text in str(value) for props in list(browser.controls.values()) for value in props.values())

        until(lambda: says("active") and says("com"))
        until(lambda: "/robot/1" in browser.positions)
        at = odometry[-1].pose.pose.position
        assert browser.positions["/robot/1"] == pytest.approx((at.x, at.y, at.z), abs=5e-3)
        browser.set("Release", True)
        until(lambda: holds == [False])
        until(lambda: abs(browser.positions["/robot/1"][2] - odometry[-1].pose.pose.position.z) < 1e-3)
        browser.set("Hold", True)
        until(lambda: holds == [False, True])
        browser.set("Deactivate", True)
        until(lambda: states[-1] == "inactive")
        until(lambda: says("inactive"))
    finally:
        for each in nodes:
            each.send_signal(signal.SIGINT)
        print(states, [each.wait(patience(PATIENCE)) for each in nodes])  # shown by pytest after a failure
