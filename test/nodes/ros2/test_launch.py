"""Launch files in their own processes: the robot balances, and all processes end correctly."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from busy import patience
from launching import PATIENCE, ROOT, launch, patient
from waiting import until

pytest.importorskip("ros2launch", reason="ros2 launch is not installed")

pytestmark = pytest.mark.live


def end(*processes):
    """End launch files as Ctrl-C does, and return their output."""
    for process in processes:
        process.send_signal(signal.SIGINT)
    outputs = [process.communicate(timeout=patience(PATIENCE))[0] for process in processes]
    print(*outputs)
    return outputs


def test_g1_stands_squats_and_ends_with_zero_torques(environment, user, robot_of):
    states = user.hear("/r1/wbc_controller/state", latched=True)
    torques = user.hear("/r1/effort_controller/commands", "std_msgs/msg/Float64MultiArray")
    odometry = user.hear("/r1/odom", "nav_msgs/msg/Odometry")
    wrenches = [
        user.hear(f"/r1/mock_robot/contacts/{foot}/wrench", "geometry_msgs/msg/WrenchStamped")
        for foot in ("left_foot", "right_foot")
    ]
    command = user.publisher("/r1/wbc_controller/command")
    hold = user.publisher("/r1/mock_robot/hold", "std_msgs/msg/Bool")
    setpoint = user.publisher("/r1/wbc_controller/tasks/com/setpoint", "geometry_msgs/msg/PointStamped")

    def height():
        return odometry[-1].pose.pose.position.z

    # Half of real time, and ages by simulated time, for a busy computer.
    process = launch(environment, "robot:=g1", "namespace:=r1", "real_time_factor:=0.5", "use_sim_time:=true")
    try:
        user.until(lambda: all(publisher.get_subscription_count() for publisher in (command, hold, setpoint)))
        user.until(lambda: states == ["inactive"] and odometry)
        # Refused until joint states arrive.
        user.until(lambda: states[-1] == "active", again=lambda: command.publish(command.msg_type(data="activate")))
        user.until(lambda: torques and max(map(abs, torques[-1])) > 1.0)
        hold.publish(hold.msg_type(data=False))
        weight = 9.81 * robot_of("g1")[1].mass
        user.until(lambda: sum(each[-1].wrench.force.z for each in wrenches if each) == pytest.approx(weight, rel=0.01))
        stood = height()
        target = setpoint.msg_type()
        target.header.frame_id = "world"
        target.point.x, target.point.z = 0.03, 0.60
        setpoint.publish(target)
        user.until(lambda: height() < stood - 0.05)
        assert states[-1] == "active"
    finally:
        (output,) = end(process)
        print(states)
    user.until(lambda: states[-1] == "stopped")
    user.until(lambda: not any(torques[-1]))
    assert process.returncode == 0, output
    assert output.count("process has finished cleanly") == 2, output
    assert "Traceback" not in output, output


def test_a_robot_that_does_not_exist_ends_the_controller_with_the_reason(environment):
    process = launch(environment, "config:=/nowhere/robot.yaml", "mock:=false")
    output, _ = process.communicate(timeout=patience(PATIENCE))
    assert "config = '/nowhere/robot.yaml': file not found" in output
    assert "exit code 2" in output
    assert "Traceback" not in output


def test_the_guard_may_be_launched_too(environment, user, tmp_path):
    said = user.hear("/r2/guard/state", latched=True)
    config = f"config:={patient('go2', tmp_path)}"
    process = launch(environment, config, "namespace:=r2", "guard:=true", "activate:=true")
    try:
        user.until(lambda: "watching" in said)
    finally:
        (output,) = end(process)
    assert set(said) <= {"idle", "watching"}  # a busy computer may discover the latched topic after the first change
    assert output.count("process has finished cleanly") == 3, output


@pytest.mark.parametrize(
    ("file", "arguments"),
    [
        ("wbc.launch.py", ("robot", "config", "mock", "guard", "namespace", "activate", "real_time_factor", "rviz")),
        ("robot.launch.py", ("config", "namespace", "activate", "guard", "joint_states", "odom", "use_sim_time")),
        ("simulation.launch.py", ("config", "controllers", "simulator", "description", "odom", "activate")),
    ],
)
def test_every_argument_is_described(environment, file, arguments):
    done = subprocess.run(
        ["ros2", "launch", "wbc_controller", file, "--show-args"],
        env=environment, capture_output=True, text=True, timeout=patience(PATIENCE), check=True,
    )  # fmt: skip
    for argument in arguments:
        assert f"'{argument}':" in done.stdout
    assert "no description given" not in done.stdout


@pytest.fixture
def stand_in(environment, tmp_path):
    """Install an executable that records its arguments and parameters."""

    def install(package, executable):
        folder = tmp_path / "lib" / package
        folder.mkdir(parents=True, exist_ok=True)
        (tmp_path / "share/ament_index/resource_index/packages" / package).touch()
        notes = tmp_path / f"{executable}.txt"
        script = folder / executable
        script.write_text(
            f"#!{sys.executable}\nimport pathlib, sys\n"
            "files = [word for word, flag in zip(sys.argv[1:], sys.argv) if flag == '--params-file']\n"
            "text = '\\n'.join([*sys.argv[1:], *(pathlib.Path(file).read_text() for file in files)])\n"
            f"pathlib.Path({str(notes)!r}).write_text(text)\n"
        )
        script.chmod(0o755)
        return notes

    return install


def wait_for(files, process):
    until(lambda: all(file.exists() and file.read_text() for file in files), patience=PATIENCE)
    end(process)


def test_rviz_starts_with_the_layout_on_request(environment, stand_in):
    notes = stand_in("rviz2", "rviz2")
    wait_for([notes], launch(environment, "rviz:=true", "mock:=false", "namespace:=r3"))
    words = notes.read_text().split("\n")
    assert Path(words[words.index("-d") + 1]).is_file()
    assert "/wbc_controller/markers:=wbc_controller/markers" in words
    assert "__ns:=/r3" in words


@pytest.mark.parametrize("simulator", ["true", "false"])
def test_a_simulator_behind_ros2_control(environment, stand_in, tmp_path, simulator):
    notes = {
        name: stand_in(package, name)
        for package, name in (
            ("mujoco_ros2_control", "ros2_control_node"),
            ("robot_state_publisher", "robot_state_publisher"),
            ("controller_manager", "spawner"),
            ("wbc_controller", "wbc_controller"),
        )
    }
    xacro = tmp_path / "bin/xacro"
    xacro.parent.mkdir()
    xacro.write_text('#!/bin/sh\necho "<robot name=\\"$1\\"/>"\n')
    xacro.chmod(0o755)
    environment["PATH"] = f"{xacro.parent}:{environment['PATH']}"
    controllers = ROOT / "config/ros2_control/go2.yaml"
    process = launch(
        environment, f"config:={ROOT / 'config/go2.yaml'}", f"controllers:={controllers}", "description:=robot.xacro",
        f"simulator:={simulator}", file="simulation.launch.py",
    )  # fmt: skip
    started = notes if simulator == "true" else {name: notes[name] for name in ("spawner", "wbc_controller")}
    wait_for(started.values(), process)
    words = notes["spawner"].read_text().split("\n")
    assert words[:4] == ["joint_state_broadcaster", "effort_controller", "--param-file", str(controllers)]
    controller = notes["wbc_controller"].read_text()
    assert "odom:=/simulator/floating_base_state" in controller
    assert "use_sim_time: true" in controller
    for name, file in notes.items():
        assert file.exists() == (name in started)
    if simulator == "true":
        assert "use_sim_time: true" in notes["ros2_control_node"].read_text()
        assert "JointGroupEffortController" in notes["ros2_control_node"].read_text()
        assert '<robot name="robot.xacro"/>' in notes["robot_state_publisher"].read_text()


def test_two_robots_in_one_graph(environment, user):
    robots = ("r1", "r2")
    said = [user.hear(f"/{robot}/wbc_controller/state", latched=True) for robot in robots]
    times = [user.hear(f"/{robot}/clock", "rosgraph_msgs/msg/Clock") for robot in robots]
    slow = ("robot:=go2", "real_time_factor:=0.3", "use_sim_time:=true", "activate:=true")
    processes = [launch(environment, f"namespace:={robot}", *slow) for robot in robots]
    try:
        user.until(lambda: all(states[-1:] == ["active"] for states in said) and all(times))
        start = [each[-1].clock.sec for each in times]
        user.until(lambda: all(each[-1].clock.sec >= began + 3 for each, began in zip(times, start, strict=True)))
        assert [states[-1] for states in said] == ["active", "active"]
    finally:
        outputs = end(*processes)
        print(said)
    assert all(output.count("process has finished cleanly") == 2 for output in outputs)


def test_the_launch_file_for_a_real_robot(environment, stand_in):
    notes = [stand_in("wbc_controller", "wbc_controller"), stand_in("wbc_controller", "guard")]
    process = launch(
        environment, "config:=my.yaml", "odom:=/estimator/odom", "effort:=/torques", "guard:=true", "namespace:=r4",
        "use_sim_time:=true", file="robot.launch.py",
    )  # fmt: skip
    wait_for(notes, process)
    controller, guard = (file.read_text() for file in notes)
    for text in (controller, guard):
        assert "effort_controller/commands:=/torques" in text
        assert "__ns:=/r4" in text
        assert "config: my.yaml" in text
    assert "odom:=/estimator/odom" in controller
    assert "use_sim_time: true" in controller
