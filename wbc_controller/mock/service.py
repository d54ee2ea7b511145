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
        stop: event that ends the run.
        namespace: namespace of the node.
        remappings: topic remappings, from name to name.
        real_time_factor: simulated seconds per second.
        lockstep: wait for the controller's command for each state.

    Raises:
        ConfigurationError: if settings and model do not fit together.
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
