"""Guard and base estimator of a robot, without their processes."""

from typing import Any

from wbc_controller.controller.build.guard import make_guard_damping
from wbc_controller.controller.build.robot_description import describe
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.topics import NODES, Endpoint, endpoints
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.clock import Clock
from wbc_controller.nodes.estimator_service import EstimatorService
from wbc_controller.nodes.guard_service import GuardService
from wbc_controller.settings import Settings


def topics_of(node: str, settings: Settings, **names: Any) -> list[Endpoint]:
    """Topics of the ``guard``, the ``mock`` or the ``estimator``; `names` as of `endpoints`."""
    name, table = NODES[node]
    return endpoints(table, name, settings, **names)


def make_guard(
    settings: Settings, model: RobotModel, transport: Transport, clock: Clock, namespace: str = "/", **names: Any
) -> GuardService:
    robot, damping = describe(model.urdf, settings.robot), make_guard_damping(settings, model)
    topics = topics_of("guard", settings, namespace=namespace, **names)
    return GuardService(settings, robot, damping, topics, transport, clock, namespace)


def make_estimator(
    settings: Settings, model: RobotModel, transport: Transport, clock: Clock, namespace: str = "/", **names: Any
) -> EstimatorService:
    topics = topics_of("estimator", settings, namespace=namespace, **names)
    return EstimatorService(settings, model, topics, transport, clock, namespace)
