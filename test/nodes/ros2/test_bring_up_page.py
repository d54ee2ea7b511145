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
_POINT, _JOINTS = "geometry_msgs/msg/PointStamped", "sensor_msgs/msg/JointState"
TYPES = {
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "/joint_states": _JOINTS,
    "/wbc_controller/tasks/com/reference": _POINT, "/wbc_controller/tasks/com/value": _POINT,
    "/wbc_controller/tasks/posture/reference": _JOINTS,
}  # fmt: skip


@pytest.fixture
def robot(environment, user, tmp_path):
    """Runner of a launch file of the page at half of real time, and the test's view of it."""
    states, started = user.hear("/wbc_controller/state", latched=True), []
    heard = {topic: user.hear(topic, kind) for topic, kind in TYPES.items()}

    def has_time():
        """The controller has received the simulated time."""
        reports = [each for each in heard["/diagnostics"] if "wbc_controller" in each.status[0].name]
        return any(each.header.stamp.sec > 0 or each.header.stamp.nanosec > 0 for each in reports)

    def make(name):
        path = tmp_path / name
        path.write_text(FILES[name], encoding="utf-8")
        started.append(
            launch(environment, f"config:={patient(path, tmp_path)}", "real_time_factor:=0.5", "use_sim_time:=true")
        )  # fmt: skip
        user.until(lambda: states == ["inactive"] and heard["/joint_states"] and has_time())

        def run(words):
            done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=patience(PATIENCE))
            assert done.returncode == 0, done.stdout + done.stderr
            return done.stdout

        return run, user.until, states, heard

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
    run, until, states, heard = robot("anymal.yaml")
    activate, release, forward, push, record, echo = FEET[1:]
    reference, com = (heard[f"/wbc_controller/tasks/com/{kind}"] for kind in ("reference", "value"))
    run(activate)
    until(lambda: states[-1] == "active")
    run(release)
    until(lambda: reference and com)
    before = reference[-1].point.x
    run(forward)
    until(lambda: reference[-1].point.x == pytest.approx(before + 0.02, abs=1e-6))
    until(lambda: com[-1].point.x == pytest.approx(before + 0.02, abs=2e-3))
    calm = com[-1].point.y
    pushing = threading.Thread(target=run, args=(push,))  # the command continues for a second after publishing
    pushing.start()
    until(lambda: abs(com[-1].point.y - calm) > 2e-3)
    pushing.join()
    until(lambda: abs(com[-1].point.y - calm) < 1e-3)
    assert "success=True" in run(record)
    run(echo)
    assert states[-1] == "active"

    def said():
        return [status.message for status in heard["/diagnostics"][-1].status if "wbc_controller" in status.name]

    until(lambda: said() == ["active"])  # the audit reports the push for a while


def test_the_stand(robot):
    run, until, states, heard = robot("stand.yaml")
    reference = heard["/wbc_controller/tasks/posture/reference"]
    run(FEET[1])
    until(lambda: states[-1] == "active" and reference)

    def knee(messages):
        return messages[-1].position[list(messages[-1].name).index("LF_KFE")]

    before = knee(reference)
    run(STAND[0])
    until(lambda: knee(reference) == pytest.approx(before + 0.1, abs=1e-6))
    until(lambda: knee(heard["/joint_states"]) == pytest.approx(before + 0.1, abs=0.02))
    assert states[-1] == "active"
