"""The one table of every topic. Both transports, the documentation and the tests are wired from it.

A topic's name is a template: ``~`` is the node's name, ``{task}``, ``{contact}`` and ``{frame}`` are filled from the
robot's configuration. Names resolve and remap as in ROS 2.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from wbc_controller.errors import ConfigurationError


class Direction(str, enum.Enum):
    """Direction of a topic, seen from the node that owns the row."""

    IN = "in"
    OUT = "out"


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service: what ROS 2 calls reliability, durability and history depth."""

    reliable: bool
    latched: bool
    depth: int


#: State in: best effort, so that a publisher of any reliability matches; only the newest counts.
STATE_IN = Qos(reliable=False, latched=False, depth=1)
#: State out of the mock robot: reliable, so that a subscriber of any reliability matches.
STATE_OUT = Qos(reliable=True, latched=False, depth=1)
#: Torques out: reliable, and never more than the newest.
COMMAND_OUT = Qos(reliable=True, latched=False, depth=1)
#: Requests by a user: reliable, and several in a row are all kept.
REQUEST = Qos(reliable=True, latched=False, depth=10)
#: Transforms out: as tf2's own broadcasters offer them.
TF_OUT = Qos(reliable=True, latched=False, depth=100)
#: Latched: a late subscriber is given the last value.
LATCHED = Qos(reliable=True, latched=True, depth=1)


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table.

    Attributes:
        key: short name of the row, by which the code finds it.
        name: template of the topic's name.
        type: message type, such as ``sensor_msgs/msg/JointState``; for `by task` rows, the key of a column of
            `TASK_TYPES`.
        direction: seen from the owner.
        qos: quality of service that the owner asks for or offers.
        meaning: one sentence for the documentation.
    """

    key: str
    name: str
    type: str
    direction: Direction
    qos: Qos
    meaning: str


#: Message type of a task's setpoint and trajectory, by kind of task; what has no derivatives has no trajectory.
TASK_TYPES: Mapping[str, Mapping[str, str]] = {
    "posture": {
        "setpoint": "sensor_msgs/msg/JointState",
        "trajectory": "trajectory_msgs/msg/JointTrajectory",
    },
    "com": {
        "setpoint": "geometry_msgs/msg/PointStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "frame_pose": {
        "setpoint": "geometry_msgs/msg/PoseStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "frame_position": {
        "setpoint": "geometry_msgs/msg/PointStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "frame_orientation": {
        "setpoint": "geometry_msgs/msg/PoseStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "relative_pose": {
        "setpoint": "geometry_msgs/msg/PoseStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "axis_alignment": {
        "setpoint": "geometry_msgs/msg/Vector3Stamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "gaze": {
        "setpoint": "geometry_msgs/msg/PointStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "linear_momentum": {
        "setpoint": "geometry_msgs/msg/Vector3Stamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "angular_momentum": {
        "setpoint": "geometry_msgs/msg/Vector3Stamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "capture_point": {
        "setpoint": "geometry_msgs/msg/PointStamped",
        "trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    },
    "contact_wrench": {"setpoint": "geometry_msgs/msg/WrenchStamped"},
    "torque": {"setpoint": "sensor_msgs/msg/JointState"},
}

_IN, _OUT = Direction.IN, Direction.OUT

# fmt: off
CONTROLLER_TOPICS: tuple[Topic, ...] = (
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "Positions and velocities, matched by joint name; other joints are ignored. A missing joint or a non-finite "
          "value refuses the whole message."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _IN, STATE_IN,
          "Pose of the base in `frame_id`, twist in `child_frame_id` (REP 105). Floating-base robots only."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _IN, LATCHED,
          "The URDF, where the configuration names no file."),
    Topic("clock", "/clock", "rosgraph_msgs/msg/Clock", _IN, STATE_IN,
          "Simulated time: what ages and ramps are measured by where `use_sim_time` is set, and only there."),
    Topic("setpoint", "~/tasks/{task}/setpoint", "setpoint", _IN, REQUEST,
          "One reference, reached along a quintic in the task's `setpoint_duration`."),
    Topic("trajectory", "~/tasks/{task}/trajectory", "trajectory", _IN, REQUEST,
          "Timed positions, velocities and accelerations, interpolated by quintics; velocities and accelerations are "
          "fed forward. A stamp of zero starts now."),
    Topic("weight", "~/tasks/{task}/weight", "std_msgs/msg/Float64", _IN, REQUEST,
          "New weight of a task, reached along a ramp."),
    Topic("task_enable", "~/tasks/{task}/enable", "std_msgs/msg/Bool", _IN, REQUEST,
          "Switches a task on or off, along a ramp of its weight."),
    Topic("contact_enable", "~/contacts/{contact}/enable", "std_msgs/msg/Bool", _IN, REQUEST,
          "Makes or breaks a contact, along a ramp of its largest normal force."),
    Topic("external_wrench", "~/external_wrenches/{frame}", "geometry_msgs/msg/WrenchStamped", _IN, REQUEST,
          "A known external wrench at a frame's origin, world axes; it stays until it is replaced (S4)."),
    Topic("update", "~/update", "std_msgs/msg/String", _IN, REQUEST,
          "YAML with several weights, enables, setpoints, contacts and live settings, applied in one cycle, all or "
          "nothing."),
    Topic("command", "~/command", "std_msgs/msg/String", _IN, REQUEST,
          "One of activate, deactivate, damp, reset, estop."),
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _OUT, COMMAND_OUT,
          "Torques in N·m, in the order of `robot.actuators`, which is that of `robot.joints` where it is not given; "
          "or as `robot.command` says. What ros2_control's effort controllers take."),
    Topic("joint_commands", "~/joint_commands", "sensor_msgs/msg/JointState", _OUT, COMMAND_OUT,
          "The same by joint, with names, stamped with the state it answers, and desired positions and velocities."),
    Topic("contact_wrench", "~/contacts/{contact}/wrench", "geometry_msgs/msg/WrenchStamped", _OUT, COMMAND_OUT,
          "The force that the quadratic program counts on, in the contact frame."),
    Topic("state", "~/state", "std_msgs/msg/String", _OUT, LATCHED,
          "Mode and, in a fault, its code and reason."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "Rates, ages, missed deadlines, stage times, task errors, binding constraints, refused inputs."),
    Topic("markers", "~/markers", "visualization_msgs/msg/MarkerArray", _OUT, COMMAND_OUT,
          "For RViz and Foxglove, in the world frame: contact forces, friction cones, support, centre of mass, capture "
          "point, task errors."),
)

MOCK_TOPICS: tuple[Topic, ...] = (
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _IN, STATE_IN,
          "Torques to apply. A wrong size or a non-finite value is refused and the joints are damped."),
    Topic("joint_commands", "wbc_controller/joint_commands", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "In lockstep, the answer that the next step waits for."),
    Topic("push", "~/push", "geometry_msgs/msg/WrenchStamped", _IN, REQUEST,
          "A force and torque on the body named by `frame_id`, world axes, for `push_duration`."),
    Topic("hold", "~/hold", "std_msgs/msg/Bool", _IN, REQUEST,
          "Hangs the base where it started (true) or lets it go (false)."),
    Topic("grip", "~/contacts/{contact}/grip", "std_msgs/msg/Bool", _IN, REQUEST,
          "Holds the link of a fixed contact where it is (true) or lets it go (false)."),
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _OUT, STATE_OUT,
          "Measured positions, velocities and applied efforts."),
    Topic("clock", "/clock", "rosgraph_msgs/msg/Clock", _OUT, STATE_OUT, "Simulated time, before each state."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _OUT, STATE_OUT, "True pose and twist of the base."),
    Topic("tf", "/tf", "tf2_msgs/msg/TFMessage", _OUT, TF_OUT,
          "Transform from `world` to the base, for viewers: robot_state_publisher sends those of the links."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _OUT, STATE_OUT,
          "Orientation, angular velocity and specific force of the base, in the base frame."),
    Topic("contact_wrench", "~/contacts/{contact}/wrench", "geometry_msgs/msg/WrenchStamped", _OUT, STATE_OUT,
          "True contact wrench in the contact frame."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _OUT, LATCHED, "The robot's URDF."),
)

GUARD_TOPICS: tuple[Topic, ...] = (
    Topic("joint_commands", "wbc_controller/joint_commands", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "The controller's commands: while they come, the guard is silent. As it never writes them, it does not take "
          "its own torques for the controller's."),
    Topic("controller_state", "wbc_controller/state", "std_msgs/msg/String", _IN, LATCHED,
          "The controller's mode. In inactive, stopped and fault commands may end once they are zero."),
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "Velocities to damp, and the states that the controller owes commands to."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _IN, LATCHED,
          "The URDF with the effort limits, where the configuration names no file."),
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _OUT, COMMAND_OUT,
          "Damping torques in N·m, then zero, while the controller's commands are missing; nothing otherwise."),
    Topic("state", "~/state", "std_msgs/msg/String", _OUT, LATCHED,
          "One of idle, watching, damping, zero, released; with the reason, in the last three."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "The same, with ages, the number of takeovers and refused inputs."),
)
# fmt: on


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One topic of one node, resolved: what a transport opens.

    Attributes:
        key: key of the row.
        subject: the task, contact or frame that the topic is about; empty for the others.
        name: fully qualified topic name, such as ``/wbc_controller/state``.
        type: message type, such as ``std_msgs/msg/String``.
        direction: whether the node reads or writes it.
        qos: quality of service.
    """

    key: str
    subject: str
    name: str
    type: str
    direction: Direction
    qos: Qos


def resolve(name: str, node: str, namespace: str = "/", remappings: Mapping[str, str] | None = None) -> str:
    """Resolve a topic name as ROS 2 does: expand ``~`` and the namespace, then apply the remappings.

    Args:
        name: relative, private (``~/…``) or absolute name.
        node: name of the node.
        namespace: namespace of the node, starting with a slash.
        remappings: from name to name; both sides are expanded by the same rules.

    Returns:
        The fully qualified name.
    """
    expanded = _expand(name, node, namespace)
    for source, target in (remappings or {}).items():
        if _expand(source, node, namespace) == expanded:
            return _expand(target, node, namespace)
    return expanded


def _expand(name: str, node: str, namespace: str) -> str:
    prefix = namespace.rstrip("/")
    if name == "~" or name.startswith("~/"):
        return f"{prefix}/{node}{name[1:]}"
    return name if name.startswith("/") else f"{prefix}/{name}"


def endpoints(
    table: Iterable[Topic],
    node: str,
    *,
    task_kinds: Mapping[str, str] | None = None,
    contacts: Iterable[str] = (),
    frames: Iterable[str] = (),
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> Iterator[Endpoint]:
    """Expand a table for one robot.

    Args:
        table: `CONTROLLER_TOPICS` or `MOCK_TOPICS`.
        node: name of the node.
        task_kinds: kind of each task, by its name.
        contacts: names of the contacts.
        frames: names of the frames on which external wrenches are accepted.
        namespace: namespace of the node.
        remappings: as in `resolve`.

    Yields:
        One endpoint per topic.
    """
    kinds = task_kinds or {}
    subjects: dict[str, tuple[str, ...]] = {
        "task": tuple(kinds),
        "contact": tuple(contacts),
        "frame": tuple(frames),
    }
    for topic in table:
        field = next((field for field in subjects if f"{{{field}}}" in topic.name), None)
        for subject in subjects[field] if field else ("",):
            type_name = topic.type
            if topic.type in ("setpoint", "trajectory"):
                if topic.type not in TASK_TYPES[kinds[subject]]:
                    continue
                type_name = TASK_TYPES[kinds[subject]][topic.type]
            name = topic.name.format(**{field: subject}) if field else topic.name
            yield Endpoint(
                topic.key, subject, resolve(name, node, namespace, remappings), type_name, topic.direction, topic.qos
            )


def counterpart(endpoint: Endpoint) -> Endpoint:
    """The other end of a topic, for whoever talks to its node: the direction turned round."""
    turned = Direction.OUT if endpoint.direction is Direction.IN else Direction.IN
    return dataclasses.replace(endpoint, direction=turned)


def parse_remapping(text: str) -> tuple[str, str]:
    """Read one remapping in ROS 2's form ``from:=to``.

    Raises:
        ConfigurationError: where the text has another form.
    """
    source, separator, target = text.partition(":=")
    if not (source and separator and target):
        raise ConfigurationError(f"remapping {text!r} does not have the form from:=to, such as odom:=/estimator/odom")
    return source, target
