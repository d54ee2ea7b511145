"""The table of every topic, from which the transports, the documentation and the tests are set up.

A topic's name is a template: ``~`` stands for the node's name; ``{task}``, ``{contact}`` and ``{frame}`` are filled in
from the robot's configuration. Names are resolved and remapped as in ROS 2.
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


#: Incoming state: best effort, which matches publishers of any reliability; only the newest message counts.
STATE_IN = Qos(reliable=False, latched=False, depth=1)
#: Outgoing state of the mock robot: reliable, which matches subscribers of any reliability.
STATE_OUT = Qos(reliable=True, latched=False, depth=1)
#: Outgoing torques: reliable, with only the newest message kept.
COMMAND_OUT = Qos(reliable=True, latched=False, depth=1)
#: Requests by a user: reliable, with a history deep enough for several in a row.
REQUEST = Qos(reliable=True, latched=False, depth=1000)
#: Outgoing transforms: the quality of service of tf2's own broadcasters.
TF_OUT = Qos(reliable=True, latched=False, depth=100)
#: Latched (transient local): a late subscriber receives the last message.
LATCHED = Qos(reliable=True, latched=True, depth=1)


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table."""

    key: str  # short name of the row, used in the code
    name: str  # template of the topic's name
    type: str  # message type, such as ``sensor_msgs/msg/JointState``; if it depends on the task, one of `BY_TASK`
    direction: Direction  # direction seen from the node that owns the row
    qos: Qos  # quality of service that the owner requests or offers
    meaning: str  # one sentence for the documentation


_POINT, _VECTOR, _POSE = (f"geometry_msgs/msg/{name}Stamped" for name in ("Point", "Vector3", "Pose"))
_JOINTS = "sensor_msgs/msg/JointState"


def _with_trajectory(setpoint: str, trajectory: str = "MultiDOFJointTrajectory") -> Mapping[str, str]:
    return {"setpoint": setpoint, "trajectory": f"trajectory_msgs/msg/{trajectory}"}


#: Message types of a task's setpoint and trajectory, by kind of task; without reference derivatives, no trajectory.
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
    "contact_wrench": {"setpoint": "geometry_msgs/msg/WrenchStamped"},
    "torque": {"setpoint": _JOINTS},
}

#: Types that depend on the task: a key of `TASK_TYPES`, or the value of a task with a motion, in the setpoint's type.
BY_TASK = ("setpoint", "trajectory", "value")

_IN, _OUT = Direction.IN, Direction.OUT

# fmt: off
CONTROLLER_TOPICS: tuple[Topic, ...] = (
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "Positions and velocities, matched by joint name; other joints are ignored. A message that lacks a joint or "
          "holds a non-finite value is refused as a whole."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _IN, STATE_IN,
          "Pose of the base in `frame_id`, twist in `child_frame_id` (REP 105). Floating-base robots only."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _IN, STATE_IN,
          "Angular velocity and specific force in the axes of `estimation.imu_frame`, read in place of `odom` if "
          "`estimation.base_state` is imu. The orientation is not used."),
    Topic("measured_wrench", "~/contacts/{contact}/measured_wrench", "geometry_msgs/msg/WrenchStamped", _IN, STATE_IN,
          "Wrench on the robot by a force sensor, from which the contact holds, if `estimation.base_state` is imu."),
    Topic("holds", "~/contacts/{contact}/holds", "std_msgs/msg/Bool", _IN, STATE_IN,
          "Whether a contact where no force is measured holds, by a foot switch, if `estimation.base_state` is imu."),
    Topic("pose", "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", _IN, STATE_IN,
          "Absolute pose of `estimation.pose_frame` in the world, from motion capture or SLAM, stamped when it was "
          "measured; read where `estimation.absolute_pose` is set and the base is estimated here."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _IN, LATCHED,
          "The URDF, used if the configuration names no file."),
    Topic("clock", "/clock", "rosgraph_msgs/msg/Clock", _IN, STATE_IN,
          "Simulated time, by which ages and ramps are measured if `use_sim_time` is set; ignored otherwise."),
    Topic("setpoint", "~/tasks/{task}/setpoint", "setpoint", _IN, REQUEST,
          "One reference, in the world or relative (below), reached along a quintic in its `setpoint_duration`."),
    Topic("trajectory", "~/tasks/{task}/trajectory", "trajectory", _IN, REQUEST,
          "Timed positions, velocities and accelerations, interpolated by quintics; velocities and accelerations are "
          "fed forward. With a zero stamp the trajectory starts at once."),
    Topic("weight", "~/tasks/{task}/weight", "std_msgs/msg/Float64", _IN, REQUEST,
          "New weight of a task, reached along a ramp."),
    Topic("task_enable", "~/tasks/{task}/enable", "std_msgs/msg/Bool", _IN, REQUEST,
          "Switches a task on or off, along a ramp of its weight."),
    Topic("contact_enable", "~/contacts/{contact}/enable", "std_msgs/msg/Bool", _IN, REQUEST,
          "Activates or deactivates a contact, along a ramp of its largest normal force."),
    Topic("external_wrench", "~/external_wrenches/{frame}", "geometry_msgs/msg/WrenchStamped", _IN, REQUEST,
          "A known external wrench at a frame's origin, world axes; it holds until it is replaced (S4)."),
    Topic("cmd_vel", "cmd_vel", "geometry_msgs/msg/Twist", _IN, REQUEST,
          "Velocity to walk at, in the robot's heading: `linear.x` forward and `linear.y` to the left, m/s, "
          "`angular.z`, rad/s. Zero, or no message for `walking.command_timeout`, lets the robot stop and stand. Only "
          "robots with the section `walking` have this topic."),
    Topic("cmd_vel_stamped", "cmd_vel_stamped", "geometry_msgs/msg/TwistStamped", _IN, REQUEST,
          "The same with a header, which is not used."),
    Topic("update", "~/update", "std_msgs/msg/String", _IN, REQUEST,
          "YAML with several weights, enables, setpoints, contacts and live settings, applied in one cycle, all or "
          "nothing."),
    Topic("command", "~/command", "std_msgs/msg/String", _IN, REQUEST,
          "One of activate, deactivate, damp, reset, estop."),
    Topic("record", "~/record", "std_msgs/msg/String", _IN, REQUEST,
          "Has the flight recorder write its last seconds to a file, which the text becomes part of the name of."),
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _OUT, COMMAND_OUT,
          "Torques in N·m, in the order of `robot.actuators`, by default that of `robot.joints`; or joint torques, if "
          "`robot.command` says so. The message of ros2_control's effort controllers."),
    Topic("joint_commands", "~/joint_commands", "sensor_msgs/msg/JointState", _OUT, COMMAND_OUT,
          "The same torques by joint name, with desired positions and velocities and the stamp of the latched state."),
    Topic("contact_wrench", "~/contacts/{contact}/wrench", "geometry_msgs/msg/WrenchStamped", _OUT, COMMAND_OUT,
          "Contact force or wrench in the solution of the quadratic program, in the contact frame. Made while somebody "
          "reads it, or all of the run is recorded."),
    Topic("task_reference", "~/tasks/{task}/reference", "setpoint", _OUT, COMMAND_OUT,
          "Where the task is wanted at this moment, while the controller is active, at `control.diagnostics_rate`; "
          "stamped with the state. Made while somebody reads it or the value, or all of the run is recorded."),
    Topic("task_value", "~/tasks/{task}/value", "value", _OUT, COMMAND_OUT,
          "Where the task is, in the same form and at the same time. Its error and weight are on `/diagnostics`."),
    Topic("state", "~/state", "std_msgs/msg/String", _OUT, LATCHED,
          "The mode; in a fault, also its code and reason."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "Rates, ages, missed deadlines, stage times, task errors, binding constraints, refused inputs. "
          "At `control.diagnostics_rate` while somebody reads it, or all of the run is recorded, otherwise once a "
          "second."),
    Topic("markers", "~/markers", "visualization_msgs/msg/MarkerArray", _OUT, COMMAND_OUT,
          "For RViz and Foxglove, in the world frame: contact forces, friction cones, support polygon, centre of mass, "
          "capture point, task errors. Made while somebody reads it, or all of the run is recorded."),
)

#: Rows of the controller that only a robot that walks has.
WALKING_KEYS = ("cmd_vel", "cmd_vel_stamped")

#: Name of the mock robot's node.
MOCK_NODE = "mock_robot"

MOCK_TOPICS: tuple[Topic, ...] = (
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _IN, STATE_IN,
          "Torques to apply. If the size is wrong or a value is not finite, the message is refused and the joints are "
          "damped."),
    Topic("joint_commands", "wbc_controller/joint_commands", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "In lockstep mode, the command that the next step waits for."),
    Topic("push", "~/push", "geometry_msgs/msg/WrenchStamped", _IN, REQUEST,
          "A force and torque on the body named by `frame_id`, world axes, for `push_duration`."),
    Topic("hold", "~/hold", "std_msgs/msg/Bool", _IN, REQUEST,
          "Hangs the base at its initial pose (true) or releases it (false)."),
    Topic("grip", "~/contacts/{contact}/grip", "std_msgs/msg/Bool", _IN, REQUEST,
          "Holds the link of a fixed contact at its present pose (true) or releases it (false)."),
    Topic("fault", "~/fault", "std_msgs/msg/String", _IN, REQUEST,
          "YAML with one fault or a list of them (docs/faults.md), or `clear`."),
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _OUT, STATE_OUT,
          "Measured positions, velocities and applied efforts."),
    Topic("clock", "/clock", "rosgraph_msgs/msg/Clock", _OUT, STATE_OUT, "Simulated time, sent before each state."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _OUT, STATE_OUT, "True pose and twist of the base."),
    Topic("tf", "/tf", "tf2_msgs/msg/TFMessage", _OUT, TF_OUT,
          "Transform from `world` to the base, for viewers; robot_state_publisher sends the links' transforms."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _OUT, STATE_OUT,
          "Orientation, angular velocity and specific force of `estimation.imu_frame`, or else of the base link."),
    Topic("pose", "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", _OUT, STATE_OUT,
          "Absolute pose of `estimation.pose_frame`, `mock.pose_rate` times a second, as late and as noisy as the "
          "settings beside it say; nothing by default."),
    Topic("contact_wrench", "~/contacts/{contact}/wrench", "geometry_msgs/msg/WrenchStamped", _OUT, STATE_OUT,
          "True contact wrench in the contact frame."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _OUT, LATCHED, "The robot's URDF."),
)

GUARD_TOPICS: tuple[Topic, ...] = (
    Topic("joint_commands", "wbc_controller/joint_commands", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "The controller's commands: while they arrive, the guard is silent. The guard never publishes on this topic, "
          "so it cannot mistake its own torques for the controller's."),
    Topic("controller_state", "wbc_controller/state", "std_msgs/msg/String", _IN, LATCHED,
          "The controller's mode. In inactive, stopped and fault the commands may end once they are zero."),
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "Joint velocities for the damping. A triggered controller must answer each joint state with a command."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _IN, LATCHED,
          "The URDF with the effort limits, used if the configuration names no file."),
    Topic("effort", "effort_controller/commands", "std_msgs/msg/Float64MultiArray", _OUT, COMMAND_OUT,
          "Damping torques in N·m, then zero, while the controller's commands are missing; nothing otherwise."),
    Topic("state", "~/state", "std_msgs/msg/String", _OUT, LATCHED,
          "One of idle, watching, damping, zero, released; the last three with the reason."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "The guard's state, with message ages, the number of takeovers, and refused inputs."),
)

#: Name of the node that estimates the base.
ESTIMATOR_NODE = "base_estimator"

ESTIMATOR_TOPICS: tuple[Topic, ...] = (
    Topic("joint_states", "joint_states", "sensor_msgs/msg/JointState", _IN, STATE_IN,
          "Positions and velocities of the joints: each message is answered by an estimate."),
    Topic("imu", "imu", "sensor_msgs/msg/Imu", _IN, STATE_IN,
          "Angular velocity and specific force in the axes of `estimation.imu_frame`. The orientation is not used."),
    Topic("pose", "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", _IN, STATE_IN,
          "Absolute pose of `estimation.pose_frame` in the world, from motion capture or SLAM, stamped when it was "
          "measured; read where `estimation.absolute_pose` is set."),
    Topic("holds", "~/contacts/{contact}/holds", "std_msgs/msg/Bool", _IN, STATE_IN,
          "Whether a contact holds, from a foot switch or another controller, where no force is measured; until the "
          "first one, as below."),
    Topic("measured_wrench", "~/contacts/{contact}/measured_wrench", "geometry_msgs/msg/WrenchStamped", _IN, STATE_IN,
          "Wrench on the robot by a force sensor, from which the contact holds."),
    Topic("contact_wrench", "wbc_controller/contacts/{contact}/wrench", "geometry_msgs/msg/WrenchStamped", _IN,
          STATE_IN, "The contacts for which the controller sends forces hold; while it sends none, those hold that are "
          "enabled in the configuration."),
    Topic("robot_description", "robot_description", "std_msgs/msg/String", _IN, LATCHED,
          "The URDF, used if the configuration names no file."),
    Topic("odom", "odom", "nav_msgs/msg/Odometry", _OUT, STATE_OUT,
          "Pose of the base in `odom`, where the robot began, and twist in the base's axes (REP 105), with "
          "covariances; nothing while there is no estimate."),
    Topic("tf", "/tf", "tf2_msgs/msg/TFMessage", _OUT, TF_OUT,
          "Transform from `odom` to the base, 50 times a second; with absolute poses also that from `map` to `odom`."),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _OUT, REQUEST,
          "Whether the base is estimated, or what that waits for; contacts that hold, and those that slip; refused "
          "inputs."),
)
# fmt: on


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One topic of one node with its resolved name, as a transport opens it."""

    key: str  # key of the row in the topic table
    subject: str  # the task, contact or frame that the topic belongs to; empty for the other topics
    name: str  # fully qualified topic name, such as ``/wbc_controller/state``
    type: str
    direction: Direction  # whether the node subscribes or publishes
    qos: Qos


def resolve(name: str, node: str, namespace: str = "/", remappings: Mapping[str, str] | None = None) -> str:
    """Resolve a topic name as ROS 2 does: expand ``~`` and the namespace, then apply the remappings.

    Args:
        name: relative, private (``~/…``) or absolute name.
        namespace: namespace of the node, starting with a slash.
        remappings: from name to name; both names are expanded by the same rules.

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
        table: `CONTROLLER_TOPICS`, `MOCK_TOPICS` or `GUARD_TOPICS`.
        task_kinds: kind of each task, by its name.
        frames: names of the frames that accept external wrenches.

    Yields:
        One endpoint per topic.
    """
    kinds = task_kinds or {}
    subjects: dict[str, tuple[str, ...]] = {"task": tuple(kinds), "contact": tuple(contacts), "frame": tuple(frames)}
    for topic in table:
        field = next((field for field in subjects if f"{{{field}}}" in topic.name), None)
        for subject in subjects[field] if field else ("",):
            type_name = topic.type
            if topic.type in BY_TASK:
                types = TASK_TYPES[kinds[subject]]
                if topic.type != "setpoint" and "trajectory" not in types:  # forces and torques do not move
                    continue
                type_name = types["trajectory" if topic.type == "trajectory" else "setpoint"]
            name = topic.name.format(**{field: subject}) if field else topic.name
            yield Endpoint(
                topic.key, subject, resolve(name, node, namespace, remappings), type_name, topic.direction, topic.qos
            )


def counterpart(endpoint: Endpoint) -> Endpoint:
    """The opposite end of a topic, with the direction reversed: for a participant that talks to its node."""
    turned = Direction.OUT if endpoint.direction is Direction.IN else Direction.IN
    return dataclasses.replace(endpoint, direction=turned)


def parse_remapping(text: str) -> tuple[str, str]:
    """Read one remapping in ROS 2's form ``from:=to``.

    Raises:
        ConfigurationError: if the text does not have this form.
    """
    source, separator, target = text.partition(":=")
    if not (source and separator and target):
        raise ConfigurationError(f"remapping {text!r} does not have the form from:=to, such as odom:=/estimator/odom")
    return source, target
