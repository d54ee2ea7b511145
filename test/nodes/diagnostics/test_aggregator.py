"""The configuration of diagnostic_aggregator: each status of our nodes is in one group, in every namespace."""

import pytest
import yaml
from pages import ROOT
from peer import Peer
from services import make_estimator, make_guard, topics_of

from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.diagnostics.status import StatusSummary
from wbc_controller.settings import NODE_NAME

FILE = yaml.safe_load((ROOT / "config/diagnostics/analyzers.yaml").read_text(encoding="utf-8"))
PARAMETERS = FILE["analyzers"]["ros__parameters"]
GROUPS = {name: value for name, value in PARAMETERS.items() if isinstance(value, dict)}
#: Types of the parameters that GenericAnalyzer of Jazzy reads (diagnostic_aggregator/src/generic_analyzer.cpp).
TYPES = {"type": str, "path": str, "contains": list, "timeout": float, "num_items": int}


def groups(status):
    return [name for name, group in GROUPS.items() if any(text in status for text in group["contains"])]


def test_the_parameters_are_those_of_the_aggregator():
    others = {name: type(value) for name, value in PARAMETERS.items() if name not in GROUPS}
    assert others == {"path": str, "pub_rate": float}
    for group in GROUPS.values():
        assert group["type"] == "diagnostic_aggregator/GenericAnalyzer"
        assert {name: type(value) for name, value in group.items()} == {name: TYPES[name] for name in group}


def status_name(node, settings, model, namespace, bench):
    if node == "controller":
        robot = bench("go2")
        robot.cycle()
        assert robot.status.name == StatusSummary(f"/{NODE_NAME}", "")._name
        return StatusSummary(f"{namespace}/{NODE_NAME}", "")._name
    bus = MemoryBus()
    peer = Peer(bus, topics_of(node, settings, namespace=namespace))
    make = {"guard": make_guard, "estimator": make_estimator}[node]
    make(settings, model, MemoryTransport(bus), ManualClock(100.0), namespace).cycle()
    return peer.status.name


@pytest.mark.parametrize("namespace", ["", "/r1"])
@pytest.mark.parametrize(
    ("node", "group"), [("controller", "controller"), ("guard", "guard"), ("estimator", "base_estimator")]
)
def test_the_status_of_each_node_is_in_its_group(node, group, namespace, robot_of, bench):
    settings, model = robot_of("go2")
    status = status_name(node, settings, model, namespace, bench)
    assert groups(status) == [group]
    assert status.startswith(namespace.strip("/"))
    assert settings.control.diagnostics_rate * GROUPS[group]["timeout"] > 1.0
