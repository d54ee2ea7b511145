"""Service of the mock robot."""

import logging
import threading
from pathlib import Path
from typing import Any

from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.middleware.transports.graph_watch import GraphWatch, OtherPublishers
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.settings import Settings
from wbc_controller.settings.resources import read_text
from wbc_controller.simulation.faults.catalogue import read_faults
from wbc_controller.simulation.mock_robot import MockRobot

_LARGEST_SCRIPT = 1_000_000  # largest file of faults, characters

_log = logging.getLogger(__name__)


def run_mock(
    settings: Settings, transport: Transport, stop: threading.Event, *, faults: Path | None = None, **options: Any
) -> None:
    """Run the mock robot until the event is set; `options` of `MockRobot`.

    `faults` is a file with faults, each with the simulated time ``at`` of its start, s.
    """
    script = read_faults(read_text(faults, str(faults), _LARGEST_SCRIPT), str(faults), script=True) if faults else []
    robot = MockRobot(make_model(settings), settings, transport, **options)
    try:
        robot.plan(script)
    except InputRefused as error:
        raise ConfigurationError(f"{faults}: {error}") from error
    joint_states = robot.joint_states

    def warn(others: OtherPublishers) -> None:
        names = ", ".join(others["joint_states"])
        if names:
            _log.warning("%s has another publisher, %s: two robots on one topic", joint_states.name, names)

    watch = GraphWatch(transport, [joint_states], warn)
    watch.start()
    try:
        robot.run(stop)
    finally:
        watch.stop()
    if robot.rebased:
        speed = 100.0 * robot.speed.mean(robot.plant.time)
        _log.warning("fell behind real time %d times; mean speed %.0f %% of real time", robot.rebased, speed)
