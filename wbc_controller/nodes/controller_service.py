"""The controller as a service."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from wbc_controller.controller.build.estimation import estimates_base, make_estimator
from wbc_controller.controller.controller import Controller
from wbc_controller.controller.report import CycleReport
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.inverse_dynamics.references.ranges import check_change
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, Endpoint, endpoints
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.clock import Clock, MonotonicClock, SimulatedClock
from wbc_controller.nodes.diagnostics.status import walk_values
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.loop import ControlLoop
from wbc_controller.nodes.outputs import Outputs
from wbc_controller.nodes.ownership import Ownership
from wbc_controller.nodes.realtime import apply_realtime, describe_scheduling
from wbc_controller.nodes.takeover import Takeover
from wbc_controller.nodes.urdf import wait_for_urdf
from wbc_controller.nodes.wiring import controller_endpoints, make_vocabulary
from wbc_controller.recording.recorder import NOT_RECORDED, Recorder, RecordingTransport, recording
from wbc_controller.records import ChangeSettings
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.config import Config

_log = logging.getLogger(__name__)

#: Row of the URDF topic, opened before the others.
URDF_TOPIC = [topic for topic in CONTROLLER_TOPICS if topic.key == "robot_description"]
_LONGEST_REASON = 40  # of a recording, characters


def run_controller(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    *,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
    activate: bool = False,
    use_sim_time: bool = False,
    record: Path | None = None,
) -> None:
    """Run the controller until the event is set.

    `record` names a file; None keeps only the last seconds. Other options: `wbc run --help`. Settings that do not fit
    the model raise `ConfigurationError`; a topic that cannot be opened raises `TransportError`.
    """
    with recording(settings, record, name=NODE_NAME) as recorder:  # starts its process before `apply_realtime`
        rows = endpoints(URDF_TOPIC, NODE_NAME, namespace=namespace, remappings=remappings)
        urdf = None if settings.robot.urdf else wait_for_urdf(transport, stop, rows)
        if stop.is_set():
            return
        controller = Controller(Config(settings, "", urdf), preflight=False)
        apply_realtime(settings.control.realtime)
        topics = controller_endpoints(settings, controller.model, namespace=namespace, remappings=remappings)
        full_name = f"{namespace.rstrip('/')}/{NODE_NAME}"
        clock = make_clock(settings, topics, transport, use_sim_time=use_sim_time)
        loop = make_loop(controller, transport, clock, topics, recorder=recorder, node=full_name)
        _log.info("%s: %d joints, waiting for 'activate' on %s/command", NODE_NAME, controller.model.nj, full_name)
        loop.run(stop, activate=activate)


def make_loop(
    controller: Controller,
    transport: Transport,
    clock: Clock,
    topics: Sequence[Endpoint],
    *,
    timer: Callable[[], float] = time.perf_counter,
    observers: Sequence[Callable[[CycleReport], None]] = (),
    recorder: Recorder | None = None,
    node: str = NODE_NAME,
) -> ControlLoop:
    """Connect a controller to its topics; `timer` measures the stages, s. Errors as for `run_controller`."""
    settings, model = controller.config.settings, controller.model
    vocabulary = make_vocabulary(settings, model)
    published = {name: controller.contacts[name] for name in settings.contacts}
    graph = transport
    _subscribe_record(recorder, graph, topics)
    if recorder is not None:
        recorder.stamp = clock.stamp
        transport = RecordingTransport(transport, recorder)
        observers = (*observers, recorder.observe)
    scheduling = describe_scheduling()
    _log.info("scheduling: %s", scheduling or "unknown")
    estimator = make_estimator(settings, model, published) if estimates_base(settings, model) else None

    def prepare(change: Change | ChangeSettings) -> None:
        if isinstance(change, ChangeSettings):
            controller.live.prepare(change.settings, "update")
        else:
            check_change(change, controller.tasks, model)

    inputs = Inputs(settings, model, published, vocabulary, topics, transport, clock, prepare, estimator=estimator)

    def values() -> dict[str, str]:
        recorded = recorder.status() if recorder is not None else {"recorder": NOT_RECORDED}
        return {**inputs.status(), **recorded, **walk_values(controller.walker)}

    outputs = Outputs(controller, vocabulary, topics, transport, node, scheduling, values)
    publishers = settings.safety.torque_publishers
    ownership = Ownership(graph, topics, publishers, node, simulated=isinstance(clock, SimulatedClock))
    takeover = Takeover(model, topics, transport, settings.guard.patience)
    loop = ControlLoop(controller, inputs, outputs, ownership, takeover, clock, timer=timer, observers=observers)
    if recorder is not None:
        recorder.attach(controller, node if node.startswith("/") else f"/{node}", model.name)
    return loop


def _subscribe_record(recorder: Recorder | None, transport: Transport, topics: Sequence[Endpoint]) -> None:
    (endpoint,) = [topic for topic in topics if topic.key == "record"]
    limit = LogLimit()

    def receive(payload: bytes) -> None:
        try:
            if recorder is None:
                raise InputRefused(NOT_RECORDED)
            recorder.request(decode(payload, endpoint.type).data.strip()[:_LONGEST_REASON] or "REQUEST")
        except InputRefused as refusal:
            if limit.passes(endpoint.name):
                _log.warning("%s: refused: %s", endpoint.name, refusal)

    transport.subscribe(endpoint, receive)


def make_clock(
    settings: Settings, topics: Iterable[Endpoint], transport: Transport, *, use_sim_time: bool
) -> MonotonicClock | SimulatedClock:
    """Make the clock of a loop: the computer's, or simulated time from the topic ``clock``."""
    if use_sim_time:
        return SimulatedClock(topics, transport)
    return MonotonicClock(synchronized=settings.safety.synchronized_clocks)
