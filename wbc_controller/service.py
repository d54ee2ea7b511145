"""The two services, on any transport: the controller, and the mock robot."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

from wbc_controller.build import controller_endpoints, make_loop, make_model
from wbc_controller.clock import MonotonicClock, SimulatedClock
from wbc_controller.diagnostics.recorder import CycleRecorder
from wbc_controller.errors import ConfigurationError
from wbc_controller.interface import CONTROLLER_TOPICS, Endpoint
from wbc_controller.messages import decode, nanoseconds
from wbc_controller.robot_description import wait_for_urdf
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.transports.transport import Transport

_log = logging.getLogger(__name__)


def run_controller(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    *,
    node: str = NODE_NAME,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
    activate: bool = False,
    use_sim_time: bool = False,
    record: Path | None = None,
) -> None:
    """Run the controller until stopped.

    Args:
        settings: the robot's settings.
        transport: carries the messages.
        stop: ends the run.
        node: name of the node.
        namespace: namespace of the node.
        remappings: of topic names.
        activate: activate as soon as the inputs are fresh, without a command.
        use_sim_time: measure ages and durations by the topic of the clock.
        record: file for torques and cycle times.

    Raises:
        ConfigurationError: where settings and model do not fit.
        TransportError: where a topic cannot be opened.
    """
    urdf = None
    if not settings.robot.urdf:
        urdf = wait_for_urdf(transport, stop, CONTROLLER_TOPICS, node, namespace, remappings)
    if stop.is_set():
        return
    model = make_model(settings, urdf)
    topics = controller_endpoints(settings, model, node=node, namespace=namespace, remappings=remappings)
    recorder = CycleRecorder() if record is not None else None
    loop = make_loop(
        settings,
        model,
        transport,
        clock_of(topics, transport) if use_sim_time else MonotonicClock(),
        topics,
        observers=(recorder.add,) if recorder is not None else (),
        node=f"{namespace.rstrip('/')}/{node}",
    )
    _log.info("%s: %d joints, waiting for 'activate' on %s", node, model.nj, f"{namespace.rstrip('/')}/{node}/command")
    try:
        loop.run(
            stop,
            1.0 / settings.control.rate,
            triggered=settings.control.trigger == "joint_states",
            activate=activate,
        )
    finally:
        if recorder is not None and record is not None:
            recorder.save(record)


def clock_of(topics: Iterable[Endpoint], transport: Transport) -> SimulatedClock:
    """A simulator's clock, by the topic of it.

    Args:
        topics: of the node.
        transport: carries the messages; those of the clock come in every mode and state of the node.
    """
    clock = SimulatedClock()
    (endpoint,) = [topic for topic in topics if topic.key == "clock"]
    transport.subscribe(endpoint, lambda payload: clock.set(nanoseconds(decode(payload, endpoint.type).clock)))
    return clock


def run_mock(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    *,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
    real_time_factor: float = 1.0,
    lockstep: bool = False,
) -> None:
    """Run the mock robot until stopped.

    Args:
        settings: the robot's settings.
        transport: carries the messages.
        stop: ends the run.
        namespace: namespace of the node.
        remappings: of topic names.
        real_time_factor: simulated seconds per second.
        lockstep: wait for the controller's answer to each state.

    Raises:
        ConfigurationError: where the simulator is not installed, or settings and model do not fit.
    """
    model = make_model(settings)
    robot = _mock_robot_class()(
        model,
        settings,
        transport,
        real_time_factor=real_time_factor,
        lockstep=lockstep,
        namespace=namespace,
        remappings=remappings,
    )
    robot.run(stop)
    if robot.rebased:
        _log.warning("fell behind real time %d times", robot.rebased)


def _mock_robot_class() -> type:
    """The mock robot's class; the simulator is an extra."""
    try:
        from wbc_controller.mock.robot import MockRobot
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"the mock robot needs MuJoCo ({error}); install it with: pip install 'wbc_controller[mock]'"
        ) from error
    return MockRobot
