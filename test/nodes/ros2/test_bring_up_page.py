"""docs/bring-up.md with its ROS 2 commands: launch line, and `ros2 topic` lines."""

import re
import shlex
import signal
import subprocess
import threading

import pytest
from busy import patience
from launching import PATIENCE, launch, patient
from pages import files, page

try:
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PointStamped
    from nav_msgs.msg import Odometry
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String
except ImportError as error:
    pytest.skip(f"rclpy is not importable: {error}", allow_module_level=True)

pytest.importorskip("ros2launch", reason="ros2 launch is not installed")
pytest.importorskip("ros2topic", reason="ros2 topic is not installed")

PAGE = page("bring-up")
FILES = files(PAGE)

pytestmark = pytest.mark.live


def commands(part):
    """Return the ROS 2 commands in the blocks of a part of the page, in order, split into words."""
    blocks = "\n".join(re.findall(r"```bash\n(.*?)```", part, re.DOTALL)).replace("\\\n", " ")
    lines = re.findall(r"^ros2 .*$", blocks, re.MULTILINE)
    return [shlex.split(line, comments=True) for line in lines]


FEET, STAND = (commands(part) for part in PAGE.split("## 5."))


@pytest.fixture
def robot(environment, user, tmp_path):
    """Runner of a launch file of the page at half of real time, and the test's view of it."""
    node, until = user
    states, seen, started = [], {}, []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(String, "/wbc_controller/state", lambda m: states.append(m.data), latched)
    for name, kind in (("/odom", Odometry), ("/diagnostics", DiagnosticArray), ("/joint_states", JointState),
                       ("/wbc_controller/tasks/com/reference", PointStamped),
                       ("/wbc_controller/tasks/com/value", PointStamped),
                       ("/wbc_controller/tasks/posture/reference", JointState)):  # fmt: skip
        node.create_subscription(kind, name, lambda m, name=name: seen.__setitem__(name, m), 1)

    def has_time():
        """The controller has received the simulated time."""
        newest = seen.get("/diagnostics")
        if newest is None or not any("wbc_controller" in status.name for status in newest.status):
            return False
        return newest.header.stamp.sec > 0 or newest.header.stamp.nanosec > 0

    def make(name):
        path = tmp_path / name
        path.write_text(FILES[name], encoding="utf-8")
        started.append(
            launch(environment, f"config:={patient(path, tmp_path)}", "real_time_factor:=0.5", "use_sim_time:=true")
        )  # fmt: skip
        until(lambda: states == ["inactive"] and "/joint_states" in seen and has_time())

        def run(words):
            done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=patience(PATIENCE))
            assert done.returncode == 0, done.stdout + done.stderr
            return done.stdout

        return run, until, states, seen

    yield make
    for process in started:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=patience(PATIENCE))
        print(states, output)  # shown by pytest after a failure
        assert process.returncode == 0
        assert "Traceback" not in output


def test_the_page_has_the_commands():
    assert [words[:3] for words in FEET] == [
        ["ros2", "launch", "wbc_controller"],
        *[["ros2", "topic", "pub"]] * 4,
        ["ros2", "service", "call"],
        ["ros2", "topic", "echo"],
    ]
    assert "config:=anymal.yaml" in FEET[0]
    assert [words[:3] for words in STAND] == [["ros2", "topic", "pub"]]


def test_anymal_on_its_feet(robot):
    run, until, states, seen = robot("anymal.yaml")
    activate, release, forward, push, record, echo = FEET[1:]
    run(activate)
    until(lambda: states[-1] == "active")
    run(release)
    until(lambda: "/wbc_controller/tasks/com/value" in seen)
    before = seen["/wbc_controller/tasks/com/reference"].point.x
    run(forward)
    until(lambda: seen["/wbc_controller/tasks/com/reference"].point.x == pytest.approx(before + 0.02, abs=1e-6))
    until(lambda: seen["/wbc_controller/tasks/com/value"].point.x == pytest.approx(before + 0.02, abs=2e-3))
    calm = seen["/wbc_controller/tasks/com/value"].point.y
    pushing = threading.Thread(target=run, args=(push,))  # the command continues for a second after publishing
    pushing.start()
    until(lambda: abs(seen["/wbc_controller/tasks/com/value"].point.y - calm) > 2e-3)
    pushing.join()
    until(lambda: abs(seen["/wbc_controller/tasks/com/value"].point.y - calm) < 1e-3)
    assert "success=True" in run(record)
    run(echo)
    assert states[-1] == "active"

    def said():
        return [status.message for status in seen["/diagnostics"].status if "wbc_controller" in status.name]

    until(lambda: said() == ["active"])  # the audit reports the push for a while


def test_the_stand(robot):
    run, until, states, seen = robot("stand.yaml")
    run(FEET[1])
    until(lambda: states[-1] == "active")
    until(lambda: "/wbc_controller/tasks/posture/reference" in seen)

    def knee(topic):
        return seen[topic].position[list(seen[topic].name).index("LF_KFE")]

    before = knee("/wbc_controller/tasks/posture/reference")
    run(STAND[0])
    until(lambda: knee("/wbc_controller/tasks/posture/reference") == pytest.approx(before + 0.1, abs=1e-6))
    until(lambda: knee("/joint_states") == pytest.approx(before + 0.1, abs=0.02))
    assert states[-1] == "active"
