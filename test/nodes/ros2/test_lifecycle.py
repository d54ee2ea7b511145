"""The controller's node in this process: transitions, parameters, services."""

import logging
import re
import threading
import time

import pytest
from busy import slowness
from domains import own_domain
from ros2_user import Ros2User
from waiting import until

try:
    from builtin_interfaces.msg import Time
    from nav_msgs.msg import Odometry
    from rclpy.lifecycle import TransitionCallbackReturn
    from rclpy.parameter import Parameter
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String
    from std_srvs.srv import Trigger
except ImportError as error:
    pytest.skip(f"rclpy is not importable: {error}", allow_module_level=True)

from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.nodes.ros2.controller_node import ControllerNode
from wbc_controller.nodes.ros2.node_parameters import values
from wbc_controller.nodes.ros2.parameters import settings_from
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Mode
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

pytestmark = pytest.mark.live

DOMAIN = own_domain()
#: Timeouts for a busy computer.
PATIENT = {"safety__state_timeout": 1.0}
SUCCESS, FAILURE, ERROR = (getattr(TransitionCallbackReturn, name) for name in ("SUCCESS", "FAILURE", "ERROR"))


@pytest.fixture
def graph(participants):
    """Nodes on a spun executor."""
    return participants(DOMAIN)


@pytest.fixture
def log():
    """Collect the node's log; caplog does not, since the pytest plugin of launch disables log propagation."""
    records, handler = [], logging.Handler()
    handler.emit = records.append
    loggers = [logging.getLogger(f"wbc_controller.nodes.ros2.{name}") for name in ("controller_node", "lifecycle_gate")]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    yield records
    for logger in loggers:
        logger.removeHandler(handler)
        logger.setLevel(logging.NOTSET)


def text_of(records):
    return "\n".join(f"{record.getMessage()} {record.exc_info}" for record in records)


@pytest.fixture
def make_node(graph):
    nodes = []

    def make_node(words=(), **overrides):
        parameters = [Parameter(name.replace("__", "."), value=value) for name, value in overrides.items()]
        options = {"cli_args": ["--ros-args", *words]} if words else {}
        nodes.append(ControllerNode(arguments=[], context=graph.context, parameter_overrides=parameters, **options))
        return nodes[-1]

    yield make_node
    graph.stop()
    for node in nodes:
        node.finish()
        node.destroy_node()


@pytest.fixture
def robot(graph):
    """Node that publishes the state of a hanging G1."""
    settings = load_settings(find_configuration("g1"))
    node = graph.node("robot")
    joints = JointState(name=settings.robot.joints, position=settings.robot.posture)
    joints.velocity = [0.0] * len(joints.name)
    base = Odometry(child_frame_id="pelvis")
    base.pose.pose.position.z, base.pose.pose.orientation.w = 0.8, 1.0
    odom = node.create_publisher(Odometry, "odom", 1)
    joint_states = node.create_publisher(JointState, "joint_states", 1)

    def publish(stamp=None):
        joints.header.stamp = base.header.stamp = stamp or node.get_clock().now().to_msg()
        odom.publish(base)
        joint_states.publish(joints)

    node.publish = publish
    node.timer = node.create_timer(0.005, publish)
    return node


def on_executor(executor, function):
    task = executor.create_task(function)
    until(task.done, patience=20)
    return task.result()


@pytest.fixture
def bring_up(make_node, graph):
    """Spin a controller's node and a user's; return them, and a function that runs transitions of the first."""

    def bring_up(*transitions, **overrides):
        node, user = make_node(robot="g1", **overrides), Ros2User(graph.node("user"))
        graph.executor.add_node(node)

        def run(*names):
            for name in names:
                assert on_executor(graph.executor, getattr(node, f"trigger_{name}")) == SUCCESS

        run(*transitions)
        return node, user, run

    return bring_up


def caller(user, name):
    """Return a function that calls a service of the controller and returns success and message."""
    client = user.node.create_client(Trigger, f"/wbc_controller/{name}")

    def call():
        assert client.wait_for_service(10 * slowness())
        future = client.call_async(Trigger.Request())
        until(future.done, patience=10)
        return future.result().success, future.result().message

    return call


def test_transitions_there_and_back_twice(make_node, log):
    node = make_node(robot="g1")
    for _ in range(2):
        assert node.trigger_configure() == SUCCESS
        for _ in range(2):
            assert node.trigger_activate() == SUCCESS
            assert node.trigger_deactivate() == SUCCESS
        assert node.trigger_cleanup() == SUCCESS
    assert not [thread for thread in threading.enumerate() if thread.name == "control loop"]
    prefix = "lifecycle transition: "
    logged = [record.getMessage() for record in log if record.getMessage().startswith(prefix)]
    states = {"activate": "active", "deactivate": "inactive", "configure": "inactive", "clean up": "unconfigured"}
    there = ["configure", "activate", "deactivate", "activate", "deactivate", "clean up"]
    assert logged == [f"{prefix}{what}; the node is {states[what]}" for what in 2 * there]


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ({"robot": "g1", "tasks__com__weight": -1.0}, "tasks.com.weight = -1.0: "),
        ({"robot": "g1", "robot__posture": [0.0]}, "posture has 1 values for 29 joints"),
        ({"robot": "g1", "tasks__torso__frame": "trunk"}, "trunk"),
        ({}, "has no robot: pass -p robot:="),
    ],
)
def test_bad_parameters_fail_the_transition_with_the_reason_and_can_be_mended(make_node, log, overrides, said):
    node = make_node(**overrides)
    assert node.trigger_configure() == FAILURE
    (record,) = [record for record in log if record.levelno == logging.ERROR]
    assert said in record.getMessage()
    assert record.exc_info is None
    repaired = {"tasks.com.weight": 1.0, "tasks.torso.frame": "torso_link"}
    node.set_parameters([Parameter("robot", value="g1"), *[Parameter(k, value=v) for k, v in repaired.items()]])
    if "robot__posture" in overrides:
        node.undeclare_parameter("robot.posture")
    assert node.trigger_configure() == SUCCESS


def test_topics_are_remapped_and_their_qos_overridden_as_always(make_node):
    words = ["-r", "odom:=/estimator/odom", "-r", "__ns:=/r1", "-p", "robot:=g1"]
    for key, value in (("reliability", "reliable"), ("depth", 7)):
        words += ["-p", f"qos_overrides./r1/joint_states.subscription.{key}:={value}"]
    node = make_node(words)
    assert node.trigger_configure() == SUCCESS
    until(lambda: node.count_publishers("/diagnostics"), patience=20)  # the graph lags behind
    (odom,) = node.get_subscriptions_info_by_topic("/estimator/odom")
    assert (odom.node_namespace, odom.qos_profile.reliability) == ("/r1", ReliabilityPolicy.BEST_EFFORT)
    (joint_states,) = node.get_subscriptions_info_by_topic("/r1/joint_states")
    assert joint_states.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert node.get_parameter("qos_overrides./r1/joint_states.subscription.depth").value == 7
    assert node.count_publishers("/r1/wbc_controller/state") == 1
    assert node.count_publishers("/diagnostics") == 1


def set_one(node, name, value):
    (result,) = node.set_parameters([Parameter(name, value=value)])
    return result.successful or result.reason


def test_parameters_are_changed_live_or_refused_with_the_reason(make_node):
    node = make_node(robot="g1", tasks__com__weight=3.0)
    assert node.trigger_configure() == SUCCESS
    tuner = node._loop.controller.live
    for name, value in (
        ("tasks.com.weight", 4),
        ("tasks.com.stiffness", [50.0, 50.0, 80.0]),
        ("limits.acceleration", 90.0),
    ):
        assert set_one(node, name, value) is True
        assert node.get_parameter(name).value == value
    com = tuner.settings.tasks["com"]
    assert (com.weight, com.stiffness, tuner.settings.limits.acceleration) == (4.0, [50.0, 50.0, 80.0], 90.0)
    for name, value, said in (
        ("tasks.com.weight", -1.0, "tasks.com.weight = -1.0: input should be greater than or equal to 0"),
        ("tasks.com.wieght", 1.0, "tasks.com.wieght: unknown key; did you mean 'weight'?"),
        ("tasks.com.stiffness", "stiff", "should be a valid number"),
        ("robot.joints", ["a"], "robot.posture has"),
        ("control.rate", 100.0, "control.rate: read only when the controller is configured"),
        ("robot", "talos", "robot: not live; configure the node again to change it"),
        ("use_sim_time", True, "use_sim_time: not live; configure the node again to change it"),
    ):
        before = node.get_parameter_or(name).value
        assert said in str(set_one(node, name, value))
        assert node.get_parameter_or(name).value == before
    assert tuner.settings.tasks["com"] == com
    assert set_one(node, "activate", True) is True


def test_the_whole_configuration_is_shown_as_parameters_while_there_is_one(make_node):
    node = make_node(robot="g1", tasks__com__weight=3.0)
    assert not node.has_parameter("limits.acceleration")
    assert node.trigger_configure() == SUCCESS
    assert node.get_parameter("limits.acceleration").value == node._loop.controller.live.settings.limits.acceleration
    described = node.describe_parameter("limits.acceleration").description
    assert described.startswith("Largest joint acceleration, rad/s²")
    assert described.endswith("May be changed live.")
    assert node.describe_parameter("tasks.com.weight").description.startswith("Weight in the cost.")
    assert set_one(node, "tasks.com.stiffness", 70.0) is True
    assert node.trigger_cleanup() == SUCCESS
    assert not node.has_parameter("limits.acceleration")
    assert set_one(node, "robot", "talos") is True  # the set value stays, as if set at the start
    assert node.trigger_configure() == SUCCESS
    com = node._loop.controller.live.settings.tasks["com"]
    assert (com.weight, com.stiffness) == (3.0, 70.0)


@pytest.mark.parametrize("given", [{"robot": "go2"}, {"config": str(find_configuration("go2"))}])
def test_declared_parameters_can_be_dumped_and_read_again(make_node, given):
    node = make_node(**given, tasks__com__weight=3.0)
    assert node.trigger_configure() == SUCCESS
    dumped = values(node)
    names = set(dumped)
    assert len(names) > 60
    assert not [name for name in names for upper in names if name.startswith(f"{upper}.")]
    assert settings_from(dumped, "/wbc_controller", [], node._own)[0] == Settings.model_validate(
        node._loop.controller.live.settings.model_dump()
    )


def test_a_command_sent_before_activation_is_not_obeyed_later(bring_up, log):
    _, user, run = bring_up("configure")
    publish, said = user.publisher("/wbc_controller/command"), user.hear("/wbc_controller/state")
    until(lambda: publish.get_subscription_count() == 1, patience=10)
    for _ in range(6):  # one of them is logged per second
        publish.publish(String(data="estop"))
    until(lambda: "/wbc_controller/command ignored: the node is not active" in text_of(log), patience=10)
    assert text_of(log).count("/wbc_controller/command ignored") == 1
    run("activate")
    until(lambda: said, patience=10)
    publish.publish(String(data="estop"))
    until(lambda: len(said) == 2, patience=10)
    assert said == ["inactive", "fault ESTOP: emergency stop by command"]


def test_services_return_the_outcome_and_a_fault_outlives_the_loop(bring_up):
    node, user, run = bring_up()
    activate, stop, reset = (caller(user, name) for name in ("activate", "stop", "reset"))
    success, text = activate()
    assert not success
    assert "not active" in text
    run("configure", "activate")
    success, text = activate()
    assert not success
    assert "joint_states" in text

    publish = user.publisher("/wbc_controller/update")
    until(lambda: publish.get_subscription_count() == 1, patience=10)
    publish.publish(String(data="{tasks: {com: {stiffness: 33.0}}}"))
    until(lambda: node.get_parameter("tasks.com.stiffness").value == 33.0, patience=10)
    assert not node.has_parameter("robot.joints")  # together with robot

    assert stop() == (True, "fault ESTOP: emergency stop by command")
    assert activate() == (False, "command 'activate' is refused in fault (ESTOP); send 'reset' first")
    run("deactivate", "activate")
    supervisor = node._loop.controller.supervisor
    assert supervisor.fault.code == "ESTOP"
    assert supervisor.mode is not Mode.INACTIVE
    assert reset() == (True, "inactive")


def test_the_last_seconds_are_recorded_on_request_and_deactivating_in_mid_run_is_no_fault(bring_up, robot, tmp_path):
    node, user, run = bring_up(recorder__folder=str(tmp_path), **PATIENT)
    call = caller(user, "record")
    assert call() == (False, "the node is not active; check its state with ros2 lifecycle get")
    run("configure", "activate")
    supervisor = node._loop.controller.supervisor
    for _ in range(2):
        until(lambda: supervisor.mode is Mode.ACTIVE, patience=10, again=lambda: node._gate.command("activate"))
        run("deactivate")
        assert (supervisor.mode, supervisor.fault) == (Mode.STOPPED, None)
        run("activate")
    time.sleep(0.2)  # of cycles
    assert list(tmp_path.iterdir()) == []
    assert call() == (True, f"the last seconds are written to {tmp_path}")
    until(lambda: list(tmp_path.glob("*REQUEST*.mcap")), patience=20)
    run("deactivate", "cleanup")  # closes the file
    (file,) = tmp_path.glob("*.mcap")
    assert Recording(file).count > 0


def test_a_service_waits_without_keeping_joint_states_from_the_loop(bring_up, robot):
    node, user, _ = bring_up("configure", "activate", **PATIENT)
    activate = caller(user, "activate")
    until(lambda: max(node._loop._inputs.ages().values()) < 0.5, patience=20)
    answers = [activate() for _ in range(10)]
    assert answers[0] == (True, "active")
    assert set(answers[1:]) == {(False, "command 'activate' has no effect: the controller is active already")}
    assert node._loop.controller.supervisor.mode is Mode.ACTIVE
    assert caller(user, "deactivate")() == (True, "inactive")
    assert node._loop.controller.supervisor.mode is Mode.INACTIVE


def test_simulated_time_is_honoured(bring_up, robot, graph):
    node, user, _ = bring_up("configure", "activate", use_sim_time=True)
    clock = user.publisher("/clock", "rosgraph_msgs/msg/Clock")
    activate = caller(user, "activate")
    times = [7_000_000_000]

    def time_goes_on():
        times.append(times[-1] + 5_000_000)
        at = Time(sec=times[-1] // 10**9, nanosec=times[-1] % 10**9)
        clock.publish(Clock(clock=at))
        robot.publish(at)

    assert "no time was received on /clock" in activate()[1]
    robot.timer.cancel()
    timer = user.node.create_timer(0.005, time_goes_on)
    until(lambda: node._loop._clock.now() > 7.0 and activate()[0], patience=20)
    on_executor(graph.executor, timer.cancel)  # no more states, and no more time
    time.sleep(0.2)
    assert node._loop.controller.supervisor.mode is Mode.ACTIVE
    end = times[-1] + 80_000_000
    clock.publish(Clock(clock=Time(sec=end // 10**9, nanosec=end % 10**9)))
    until(lambda: node._loop.controller.supervisor.mode is Mode.DAMPING, patience=10)
    assert re.search(r"joint_states is (80|85) ms old", node._loop.controller.supervisor.fault.sentence)
    until(lambda: node.get_clock().now().nanoseconds == end, patience=10)


def test_a_loop_that_fails_sends_zeros_and_ends_in_error_processing(bring_up, log):
    node, user, run = bring_up("configure")
    torques, loop = user.hear("/effort_controller/commands", "std_msgs/msg/Float64MultiArray"), node._loop
    until(lambda: node.count_subscribers("/effort_controller/commands"), patience=10)
    time.sleep(0.5)  # until the writer has discovered the reader
    loop.controller.supervisor.torques_sent = loop.controller.supervisor.torques_sent + 1.0  # as with active torques

    def broken():
        raise OSError("broken on purpose")

    loop._guarded_cycle = broken  # around a cycle: an error inside a cycle leads to damping
    run("activate")
    until(lambda: "error processing" in text_of(log), patience=10)
    assert "broken on purpose" in text_of(log)
    until(lambda: torques, patience=5)
    assert not any(torques[-1])
    until(lambda: node._loop is None, patience=10)
    del loop._guarded_cycle
    run("configure")


def test_a_description_that_is_too_long_is_refused_before_it_is_decoded(make_node, graph, log):
    node, user = make_node(robot="g1", robot__urdf=""), graph.node("user")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = user.create_publisher(String, "/robot_description", latched)
    assert node.trigger_configure() == FAILURE
    publisher.publish(String(data="x" * 5_000_000))
    until(lambda: "bytes (limit 4000000)" in text_of(log), patience=20)
    assert node.trigger_configure() == FAILURE
    publisher.publish(String(data=read_urdf(load_settings(find_configuration("g1")).robot.urdf)))
    until(lambda: node.trigger_configure() == SUCCESS, patience=20)
