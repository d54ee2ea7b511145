"""The three executables on a real graph: topics as in the security policy, and the guard on rclpy."""

import signal
from importlib.util import find_spec

import pytest
from busy import slowness
from forked import fork_node
from policies import read_policy

from wbc_controller.nodes.ros2.security_policy import CLOCK, security_policy

pytestmark = pytest.mark.live

NODES = {"wbc_controller": "main", "mock_robot": "mock_main", "guard": "guard_main"}


@pytest.fixture
def start(environment, user, tmp_path):
    """Start an executable on Go2 with timeouts for a busy computer."""
    started = []
    values = ("robot:=go2", "guard.patience:=0.2", "mock.command_timeout:=1.0", "safety.state_timeout:=1.0")

    def make(name, *more):
        started.append(fork_node(environment, tmp_path / f"{name}.log", NODES[name], *values, *more))
        return started[-1]

    yield make
    for process in started:
        process.send_signal(signal.SIGINT)
    for process in started:
        process.wait(20 * slowness())
    for log in tmp_path.glob("*.log"):
        print(log.read_text())  # shown after a failure


def test_they_open_what_the_policy_allows_and_the_guard_follows_a_killed_controller(user, start, robot_of):
    until, graph = user.until, user.node
    states, guard_states = (user.hear(f"/{name}/state", latched=True) for name in ("wbc_controller", "guard"))
    torques = user.hear("/effort_controller/commands", "std_msgs/msg/Float64MultiArray")
    start("mock_robot", "real_time_factor:=0.3")  # fast enough on a busy computer
    start("guard")
    controller = start("wbc_controller", "activate:=true")
    until(lambda: states[-1:] == ["active"] and guard_states[-1:] == ["watching"], "an active controller")

    # The policy of this configuration, with markers_rate.
    allowed = read_policy(security_policy(*robot_of("go2")))
    until(lambda: set(NODES) <= set(graph.get_node_names()), "all nodes in the graph")
    for name in NODES:
        opened = {
            "publish": graph.get_publisher_names_and_types_by_node,
            "subscribe": graph.get_subscriber_names_and_types_by_node,
            "reply": graph.get_service_names_and_types_by_node,
        }
        for qualifier, look in opened.items():
            permitted, unused = allowed[f"/{name}"][qualifier], {CLOCK} if qualifier == "subscribe" else set()
            if (name, qualifier) == ("mock_robot", "subscribe"):
                unused |= {"/wbc_controller/joint_commands"}  # in lockstep joint commands, otherwise torques
            if (name, qualifier) == ("mock_robot", "publish"):  # foot sensors, as from drivers
                unused |= {topic for topic in permitted if topic.endswith(("/holds", "/measured_wrench"))}
                if find_spec("tf2_msgs") is None:
                    unused.add("/tf")
            expected = permitted - unused
            # The graph becomes known endpoint by endpoint, after the first messages.
            until(
                lambda: {topic for topic, _ in look(name, "/")} == expected,  # noqa: B023 - called in this round only
                f"what {name} may {qualifier} to be what it does: {sorted(expected)}",
            )

    controller.kill()
    controller.wait()
    until(lambda: guard_states[-1].startswith("damping COMMANDS_STOPPED: "), "the guard's damping")
    count = len(torques)
    until(lambda: len(torques) > count + 20, "the guard's torques")
    start("wbc_controller", "activate:=true")
    until(lambda: guard_states[-1] == "watching", "the guard to watch another controller")
