"""The mock robot's service, on any transport."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping

from wbc_controller.assembly.robot import make_model
from wbc_controller.mock.robot import MockRobot
from wbc_controller.settings import Settings
from wbc_controller.transports.transport import Transport

_log = logging.getLogger(__name__)


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
        ConfigurationError: where settings and model do not fit.
    """
    model = make_model(settings)
    robot = MockRobot(
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
