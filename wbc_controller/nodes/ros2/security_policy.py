"""SROS 2 policy with least privilege.

Format: policy schema 0.2.0 (design article "ROS 2 Access Control Policies"), with one enclave per node.
"""

from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree import ElementTree

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware import topics
from wbc_controller.middleware.topics import REQUEST, Direction, Endpoint, endpoints, resolve
from wbc_controller.nodes.ros2.command_outcomes import RECORD, SERVICES
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.settings import NODE_NAME, Settings

OPERATOR = "operator"  # sends the commands, from the ``ros2`` command line or a planner
NODE_PUBLISHES = ("/rosout", "/parameter_events")  # publishers of every rclpy node (Jazzy)
NODE_SERVES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
CLOCK = "/clock"  # subscription of a node with ``use_sim_time``
LIFECYCLE_PUBLISHES = "~/transition_event"  # additional publisher of a lifecycle node
LIFECYCLE_SERVES = (
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
)


def security_policy(
    settings: Settings, model: RobotModel, namespace: str = "/", remappings: Mapping[str, str] | None = None
) -> str:
    """Return the policy of all nodes of one robot as XML."""
    where: dict[str, Any] = {"namespace": namespace, "remappings": remappings}
    opened = {}
    for node, rows in topics.NODES.values():
        if model.floating_base or node != topics.ESTIMATOR_NODE:
            table = endpoints(rows, node, settings, **where)
            ends = controller_endpoints(settings, model, **where) if node == NODE_NAME else table
            opened[node] = [endpoint for endpoint in ends if _is_used(endpoint, node, settings, model)]
    policy = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(policy, "enclaves")
    measured = [end.name for used in opened.values() for end in used if end.key in (*topics.CONTACT_SENSORS, "pose")]
    commanded: list[str] = []
    for node, used in opened.items():
        serves = [f"~/{name}" for name in NODE_SERVES]
        publishes = [endpoint.name for endpoint in used if endpoint.direction is Direction.OUT]
        publishes += NODE_PUBLISHES
        if node == topics.MOCK_NODE:  # represents the robot's drivers
            publishes += measured
        subscribes = [endpoint.name for endpoint in used if endpoint.direction is Direction.IN]
        if node == NODE_NAME:
            serves += [f"~/{name}" for name in (*LIFECYCLE_SERVES, *SERVICES, RECORD)]
            publishes.append(resolve(LIFECYCLE_PUBLISHES, node, namespace))
        served = [resolve(name, node, namespace) for name in serves]
        commanded += served
        _enclave(enclaves, node, namespace, publish=publishes, subscribe=[*subscribes, CLOCK], reply=served)
    everything = [endpoint for used in opened.values() for endpoint in used]
    requested = [end.name for end in everything if end.direction is Direction.IN and end.qos == REQUEST]
    published = [end.name for end in everything if end.direction is Direction.OUT]
    own = [resolve(f"~/{name}", OPERATOR, namespace) for name in NODE_SERVES]
    allowed = {"publish": [*requested, *NODE_PUBLISHES], "subscribe": [*published, "/rosout", CLOCK]}
    _enclave(enclaves, OPERATOR, namespace, **allowed, request=commanded, reply=own)
    ElementTree.indent(policy)
    return ElementTree.tostring(policy, encoding="unicode", xml_declaration=True) + "\n"


def _is_used(endpoint: Endpoint, node: str, settings: Settings, model: RobotModel) -> bool:
    if endpoint.direction is Direction.IN and endpoint.key in ("odom", "imu"):
        return model.floating_base and (node == topics.ESTIMATOR_NODE or endpoint.key == settings.estimation.base_state)
    if endpoint.key in topics.CONTACT_SENSORS and node == NODE_NAME:
        return model.floating_base and settings.estimation.base_state == "imu"
    if endpoint.key == "pose":
        if endpoint.direction is Direction.OUT:
            return settings.mock.pose_rate > 0.0 and model.floating_base
        estimated = node == topics.ESTIMATOR_NODE or settings.estimation.base_state == "imu"
        return settings.estimation.absolute_pose and estimated and model.floating_base
    if endpoint.key in ("odom", "tf"):
        return model.floating_base
    if endpoint.key == "robot_description" and endpoint.direction is Direction.IN:
        return not settings.robot.urdf
    return True


def _enclave(enclaves: ElementTree.Element, node: str, namespace: str, **allowed: Iterable[str]) -> None:
    enclave = ElementTree.SubElement(enclaves, "enclave", path=resolve(node, "", namespace))
    profiles = ElementTree.SubElement(enclave, "profiles")
    profile = ElementTree.SubElement(profiles, "profile", ns=namespace, node=node)
    for qualifier, names in allowed.items():
        kind = "topic" if qualifier in ("publish", "subscribe") else "service"
        group = ElementTree.SubElement(profile, f"{kind}s", {qualifier: "ALLOW"})
        for name in sorted(set(names)):
            ElementTree.SubElement(group, kind).text = name
