"""The configuration of diagnostic_aggregator: each status of our nodes is in one group, in every namespace."""

from pathlib import Path

import pytest
import yaml

from wbc_controller.controller.build.guard import make_guard_damping
from wbc_controller.controller.build.robot_description import describe
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import (
    ESTIMATOR_NODE,
    ESTIMATOR_TOPICS,
    GUARD_NODE,
    GUARD_TOPICS,
    counterpart,
    endpoints,
)
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.diagnostics.status import StatusSummary
from wbc_controller.nodes.estimator_service import EstimatorService
from wbc_controller.nodes.guard_service import GuardService
from wbc_controller.settings import NODE_NAME

ROOT = Path(__file__).resolve().parents[3]
PARAMETERS = yaml.safe_load((ROOT / "config/diagnostics/analyzers.yaml").read_text(encoding="utf-8"))
GROUPS = {name: value for name, value in PARAMETERS["analyzers"]["ros__parameters"].items() if isinstance(value, dict)}
#: Types of the parameters that GenericAnalyzer of Jazzy reads (diagnostic_aggregator/src/generic_analyzer.cpp).
TYPES = {"type": str, "path": str, "contains": list, "timeout": float, "num_items": int}


def groups(status):
    return [name for name, group in GROUPS.items() if any(text in status for text in group["contains"])]


def test_the_parameters_are_those_of_the_aggregator():
    settings = PARAMETERS["analyzers"]["ros__parameters"]
    assert {name: type(value) for name, value in settings.items() if name not in GROUPS} == {
        "path": str,
        "pub_rate": float,
    }
    for group in GROUPS.values():
        assert group["type"] == "diagnostic_aggregator/GenericAnalyzer"
        assert {name: type(value) for name, value in group.items()} == {name: TYPES[name] for name in group}


def _controller(settings, model, namespace, bench):
    on = bench("go2")
    on.cycle()
    (status,) = on.received("diagnostics")[0].status
    own = StatusSummary(f"{namespace}/{NODE_NAME}", "")._name
    assert status.name == StatusSummary(f"/{NODE_NAME}", "")._name
    return own


def _status(node, table, settings, model, namespace, make_service):
    bus, topics = MemoryBus(), endpoints(table, node, namespace=namespace, contacts=settings.contacts)
    received = []
    reader = MemoryTransport(bus)
    reader.subscribe(counterpart(next(topic for topic in topics if topic.key == "diagnostics")), received.append)
    make_service(topics, MemoryTransport(bus)).cycle()
    (status,) = decode(received[0], "diagnostic_msgs/msg/DiagnosticArray").status
    return status.name


def _guard(settings, model, namespace, bench):
    robot, damping = describe(model.urdf, settings.robot), make_guard_damping(settings, model)
    return _status(
        GUARD_NODE, GUARD_TOPICS, settings, model, namespace,
        lambda topics, transport: GuardService(
            settings, robot, damping, topics, transport, ManualClock(100.0), namespace
        ),
    )  # fmt: skip


def _base_estimator(settings, model, namespace, bench):
    return _status(
        ESTIMATOR_NODE, ESTIMATOR_TOPICS, settings, model, namespace,
        lambda topics, transport: EstimatorService(settings, model, topics, transport, ManualClock(100.0), namespace),
    )  # fmt: skip


@pytest.mark.parametrize("namespace", ["", "/r1"])
@pytest.mark.parametrize("node", [_controller, _guard, _base_estimator])
def test_the_status_of_each_node_is_in_its_group(node, namespace, robot_of, bench):
    settings, model = robot_of("go2")
    status = node(settings, model, namespace, bench)
    assert groups(status) == [node.__name__.strip("_")]
    assert status.startswith(namespace.strip("/"))
    assert settings.control.diagnostics_rate * GROUPS[groups(status)[0]]["timeout"] > 1.0
