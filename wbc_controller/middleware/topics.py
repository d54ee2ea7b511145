"""Table of all topics.

In the name templates ``~`` is the node's name; ``{task}``, ``{contact}`` and ``{frame}`` come from the configuration.
"""

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from wbc_controller.errors import ConfigurationError
from wbc_controller.settings import NODE_NAME, Settings


class Direction(str, enum.Enum):
    """Direction of a topic, seen from the node of the row."""

    IN = "in"
    OUT = "out"


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service; latched: transient local."""

    reliable: bool
    latched: bool
    depth: int


#: Incoming state: best effort (matches all publishers), newest message only.
STATE_IN = Qos(reliable=False, latched=False, depth=1)
#: Outgoing states and torques: reliable (matches all subscribers), newest message only.
NEWEST_OUT = Qos(reliable=True, latched=False, depth=1)
REQUEST = Qos(reliable=True, latched=False, depth=1000)  # by a user: deep history
TF_OUT = Qos(reliable=True, latched=False, depth=100)  # outgoing transforms, as of tf2's broadcasters
LATCHED = Qos(reliable=True, latched=True, depth=1)


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table."""

    key: str  # row in the code
    name: str  # template of the topic's name
    type: str  # such as ``sensor_msgs/msg/JointState``, or task-dependent by `BY_TASK`
    direction: Direction
    qos: Qos
    meaning: str


_POINT, _VECTOR, _POSE = (f"geometry_msgs/msg/{name}Stamped" for name in ("Point", "Vector3", "Pose"))
_STRING, _BOOL, _FLOAT = (f"std_msgs/msg/{name}" for name in ("String", "Bool", "Float64"))
_WRENCH, _JOINTS = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"


def _with_trajectory(setpoint: str, trajectory: str = "MultiDOFJointTrajectory") -> Mapping[str, str]:
    return {"setpoint": setpoint, "trajectory": f"trajectory_msgs/msg/{trajectory}"}


#: Message types of setpoint and trajectory, by kind of task; no trajectory without reference derivatives.
TASK_TYPES: Mapping[str, Mapping[str, str]] = {
    "posture": _with_trajectory(_JOINTS, "JointTrajectory"),
    "com": _with_trajectory(_POINT),
    "frame_pose": _with_trajectory(_POSE),
    "frame_position": _with_trajectory(_POINT),
    "frame_orientation": _with_trajectory(_POSE),
    "relative_pose": _with_trajectory(_POSE),
    "axis_alignment": _with_trajectory(_VECTOR),
    "gaze": _with_trajectory(_POINT),
    "linear_momentum": _with_trajectory(_VECTOR),
    "angular_momentum": _with_trajectory(_VECTOR),
    "capture_point": _with_trajectory(_POINT),
    "contact_wrench": {"setpoint": _WRENCH},
    "torque": {"setpoint": _JOINTS},
}

BY_TASK = ("setpoint", "trajectory", "value")  # task-dependent types; ``value`` of motion tasks has the setpoint's type

_IN, _OUT = Direction.IN, Direction.OUT

# fmt: off
CONTROLLER_TOPICS: tuple[Topic, ...] = (
    Topic("joint_states", "joint_states", _JOINTS, _IN, STATE_IN,
          "Positions and velocities by joint name; additional joints are ignored. A message with a missing joint or a "
          "non-finite value is refused."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _IN, STATE_IN,
          "Pose of the base in `frame_id`, twist in `child_frame_id` (REP 105); floating-base robots only."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _IN, STATE_IN,
          "Angular velocity and specific force in the axes of `estimation.imu_frame`, instead of `odom` if "
          "`estimation.base_state` is imu."),
    Topic("measured_wrench", "~/contacts/{contact}/measured_wrench", _WRENCH, _IN, STATE_IN,
          "Wrench on the robot by a force sensor, for contact detection if `estimation.base_state` is imu."),
    Topic("holds", "~/contacts/{contact}/holds", _BOOL, _IN, STATE_IN,
          "State of a foot switch, for contacts without a force sensor, if `estimation.base_state` is imu."),
    Topic("pose", "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", _IN, STATE_IN,
          "Absolute pose of `estimation.pose_frame` in the world (motion capture, SLAM) at the time of measurement, if "
          "`estimation.absolute_pose` is set and the controller estimates the base."),
    Topic("robot_description", "robot_description", _STRING, _IN, LATCHED,
          "The URDF, if the configuration names no file."),
    Topic("clock", "/clock", "rosgraph_msgs/msg/Clock", _IN, STATE_IN,
          "Simulated time for ages and ramps, if `use_sim_time` is set."),
    Topic("guard_commands", "guard/joint_commands", _JOINTS, _IN, STATE_IN,
          "Torques of the guard, from which a returning controller continues."),
    Topic("setpoint", "~/tasks/{task}/setpoint", "setpoint", _IN, REQUEST,
          "Reference in the world or relative (see below), reached along a quintic in `setpoint_duration`."),
    Topic("trajectory", "~/tasks/{task}/trajectory", "trajectory", _IN, REQUEST,
          "Timed positions with feed-forward velocities and accelerations, interpolated by quintics. A zero stamp "
          "starts at once."),
    Topic("weight", "~/tasks/{task}/weight", _FLOAT, _IN, REQUEST, "New weight of a task, along a ramp."),
    Topic("task_enable", "~/tasks/{task}/enable", _BOOL, _IN, REQUEST,
          "Switches a task on or off, along a ramp of its weight."),
    Topic("contact_enable", "~/contacts/{contact}/enable", _BOOL, _IN, REQUEST,
          "Activates or deactivates a contact, along a ramp of its force."),
    Topic("external_wrench", "~/external_wrenches/{frame}", _WRENCH, _IN, REQUEST,
          "Known external wrench at a frame's origin in world axes, until replaced (S4)."),
    Topic("cmd_vel", "cmd_vel", "geometry_msgs/msg/Twist", _IN, REQUEST,
          "Walking velocity in the robot's heading, m/s and rad/s. Zero, or no message for `walking.command_timeout`, "
          "stops it. Only with the section `walking` (docs/walking.md)."),
    Topic("cmd_vel_stamped", "cmd_vel_stamped", "geometry_msgs/msg/TwistStamped", _IN, REQUEST,
          "As `cmd_vel`, with an ignored header."),
    Topic("walk_goal", "~/walk/goal", _POSE, _IN, REQUEST, "Walk to x, y and heading in the world."),
    Topic("walk_footsteps", "~/walk/footsteps", "geometry_msgs/msg/PoseArray", _IN, REQUEST,
          "Walk by poses of the soles in the world (x, y, heading), left and right in turn, then stop."),
    Topic("update", "~/update", _STRING, _IN, REQUEST,
          "YAML with weights, enables, setpoints, contacts and live settings, applied at once, all or nothing."),
    Topic("command", "~/command", _STRING, _IN, REQUEST, "One of activate, deactivate, damp, reset, estop."),
    Topic("record", "~/record", _STRING, _IN, REQUEST,
          "Reason of a recording of the last seconds, part of the file's name."),
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _OUT, NEWEST_OUT,
          "Torques for ros2_control's effort controllers, N·m, in the order of `robot.actuators` (default "
          "`robot.joints`), or joint torques by `robot.command`."),
    Topic("joint_commands", "~/joint_commands", _JOINTS, _OUT, NEWEST_OUT,
          "The torques by joint name, with desired positions and velocities and the stamp of the latched state."),
    Topic("contact_wrench", "~/contacts/{contact}/wrench", _WRENCH, _OUT, NEWEST_OUT,
          "Contact force or wrench of the solution in the contact frame (on demand)."),
    Topic("task_reference", "~/tasks/{task}/reference", "setpoint", _OUT, NEWEST_OUT,
          "Present reference of an active controller, at `control.diagnostics_rate`, with the stamp of the state "
          "(on demand)."),
    Topic("task_value", "~/tasks/{task}/value", "value", _OUT, NEWEST_OUT, "Present value, likewise."),
    Topic("state", "~/state", _STRING, _OUT, LATCHED, "The mode, with code and reason of a fault."),
    Topic("walk_footsteps_left", "~/walk/footsteps_left", "std_msgs/msg/Int32", _OUT, LATCHED,
          "Number of planned footsteps without a touchdown."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "Status of the control loop (docs/diagnostics.md), at `control.diagnostics_rate` on demand, else "
          "once per second."),
    Topic("markers", "~/markers", "visualization_msgs/msg/MarkerArray", _OUT, NEWEST_OUT,
          "For RViz and Foxglove in the world frame (docs/diagnostics.md, on demand)."),
)

#: Rows of the contact sensors.
CONTACT_SENSORS = ("measured_wrench", "holds")
#: Rows of walking robots only.
WALKING_KEYS = ("cmd_vel", "cmd_vel_stamped", "walk_goal", "walk_footsteps", "walk_footsteps_left")

MOCK_NODE, GUARD_NODE, ESTIMATOR_NODE = "mock_robot", "guard", "base_estimator"

MOCK_TOPICS: tuple[Topic, ...] = (
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _IN, STATE_IN,
          "Torques to apply. After a message of wrong size or with a non-finite value the joints are damped."),
    Topic("joint_commands", "wbc_controller/joint_commands", _JOINTS, _IN, STATE_IN,
          "In lockstep mode, the command that triggers the next step."),
    Topic("push", "~/push", _WRENCH, _IN, REQUEST, "Wrench on the body `frame_id` in world axes, for `push_duration`."),
    Topic("hold", "~/hold", _BOOL, _IN, REQUEST, "Holds the base at its initial pose (true) or releases it (false)."),
    Topic("grip", "~/contacts/{contact}/grip", _BOOL, _IN, REQUEST,
          "Holds the link of a fixed contact at its present pose (true) or releases it (false)."),
    Topic("fault", "~/fault", _STRING, _IN, REQUEST,
          "YAML with one fault or a list of them (docs/faults.md), or `clear`."),
    Topic("joint_states", "joint_states", _JOINTS, _OUT, NEWEST_OUT,
          "Measured positions, velocities and applied efforts."),
    Topic("clock", "/clock", "rosgraph_msgs/msg/Clock", _OUT, NEWEST_OUT, "Simulated time, before each state."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _OUT, NEWEST_OUT, "True pose and twist of the base."),
    Topic("tf", "/tf", "tf2_msgs/msg/TFMessage", _OUT, TF_OUT,
          "Transform from `world` to the base, for viewers; robot_state_publisher publishes the links."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _OUT, NEWEST_OUT,
          "Orientation, angular velocity and specific force of `estimation.imu_frame` (default: base link)."),
    Topic("pose", "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", _OUT, NEWEST_OUT,
          "Absolute pose of `estimation.pose_frame` at `mock.pose_rate` (default 0), with the delay and noise of the "
          "section `mock`."),
    Topic("contact_wrench", "~/contacts/{contact}/wrench", _WRENCH, _OUT, NEWEST_OUT,
          "True contact wrench in the contact frame."),
    Topic("robot_description", "robot_description", _STRING, _OUT, LATCHED, "The robot's URDF."),
)

GUARD_TOPICS: tuple[Topic, ...] = (
    Topic("joint_commands", "wbc_controller/joint_commands", _JOINTS, _IN, STATE_IN,
          "The controller's commands, which keep the guard passive."),
    Topic("controller_state", "wbc_controller/state", _STRING, _IN, LATCHED,
          "The controller's mode. In inactive, stopped and fault, commands may end after zero torques."),
    Topic("joint_states", "joint_states", _JOINTS, _IN, STATE_IN,
          "Joint velocities for the damping. A triggered controller must answer each joint state with a command."),
    Topic("robot_description", "robot_description", _STRING, _IN, LATCHED,
          "The URDF with the effort limits, if the configuration names no file."),
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _OUT, NEWEST_OUT,
          "Damping torques, N·m, then zero, only while the controller's commands are missing."),
    Topic("guard_commands", "~/joint_commands", _JOINTS, _OUT, NEWEST_OUT,
          "The same by joint name, with the stamp of the last command."),
    Topic("state", "~/state", _STRING, _OUT, LATCHED,
          "One of idle, watching, damping, zero, released; the last three with the reason."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "The guard's state, message ages, number of takeovers, and refused inputs."),
)

ESTIMATOR_TOPICS: tuple[Topic, ...] = (
    Topic("joint_states", "joint_states", _JOINTS, _IN, STATE_IN,
          "Joint positions and velocities; each message triggers an estimate."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _IN, STATE_IN,
          "Angular velocity and specific force in the axes of `estimation.imu_frame`."),
    Topic("pose", "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", _IN, STATE_IN,
          "As of the controller, if `estimation.absolute_pose` is set."),
    Topic("holds", "~/contacts/{contact}/holds", _BOOL, _IN, STATE_IN,
          "State of a foot switch, or contact of another controller."),
    Topic("measured_wrench", "~/contacts/{contact}/measured_wrench", _WRENCH, _IN, STATE_IN,
          "Wrench on the robot by a force sensor, for contact detection."),
    Topic("contact_wrench", "wbc_controller/contacts/{contact}/wrench", _WRENCH, _IN, STATE_IN,
          "Forces of the controller's active contacts; without any, the configured ones are active."),
    Topic("robot_description", "robot_description", _STRING, _IN, LATCHED,
          "The URDF, if the configuration names no file."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _OUT, NEWEST_OUT,
          "Pose of the base in `odom` (origin: the start) and twist in the base's axes (REP 105), with covariances; "
          "only while an estimate exists."),
    Topic("tf", "/tf", "tf2_msgs/msg/TFMessage", _OUT, TF_OUT,
          "Transform from `odom` to the base at 50 Hz, and from `map` to `odom` with absolute poses."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "State of the estimate, active and slipping contacts, refused inputs."),
)
# fmt: on

#: Node name and topics by node.
NODES: Mapping[str, tuple[str, tuple[Topic, ...]]] = {
    "controller": (NODE_NAME, CONTROLLER_TOPICS),
    "mock": (MOCK_NODE, MOCK_TOPICS),
    "guard": (GUARD_NODE, GUARD_TOPICS),
    "estimator": (ESTIMATOR_NODE, ESTIMATOR_TOPICS),
}


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One topic of one node."""

    key: str  # row of the topic table
    subject: str  # task, contact, frame, or empty
    name: str  # such as ``/wbc_controller/state``
    type: str
    direction: Direction
    qos: Qos


def resolve(name: str, node: str, namespace: str = "/", remappings: Mapping[str, str] | None = None) -> str:
    """Return the full name of a relative, private (``~/…``) or absolute name, remapped, by the rules of ROS 2."""
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
    settings: Settings | None = None,
    *,
    frames: Iterable[str] = (),
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> list[Endpoint]:
    """Return the endpoints of a table for the tasks and contacts of one robot, and `frames` of external wrenches."""
    tasks, contacts = ({}, {}) if settings is None else (settings.tasks, settings.contacts)
    subjects: dict[str, tuple[str, ...]] = {"task": tuple(tasks), "contact": tuple(contacts), "frame": tuple(frames)}
    opened = []
    for topic in table:
        field = next((field for field in subjects if f"{{{field}}}" in topic.name), None)
        for subject in subjects[field] if field else ("",):
            type_name = topic.type
            if topic.type in BY_TASK:
                types = TASK_TYPES[tasks[subject].type]
                if topic.type != "setpoint" and "trajectory" not in types:  # forces and torques have no motion
                    continue
                type_name = types["trajectory" if topic.type == "trajectory" else "setpoint"]
            name = topic.name.format(**{field: subject}) if field else topic.name
            full_name = resolve(name, node, namespace, remappings)
            opened.append(Endpoint(topic.key, subject, full_name, type_name, topic.direction, topic.qos))
    return opened


def counterpart(endpoint: Endpoint) -> Endpoint:
    """Return the endpoint with the reversed direction."""
    return replace(endpoint, direction=Direction.OUT if endpoint.direction is Direction.IN else Direction.IN)


def parse_remapping(text: str) -> tuple[str, str]:
    """Parse ``from:=to``; raises `ConfigurationError` otherwise."""
    source, separator, target = text.partition(":=")
    if not (source and separator and target):
        raise ConfigurationError(f"invalid remapping {text!r}; valid: from:=to, such as odom:=/estimator/odom")
    return source, target
