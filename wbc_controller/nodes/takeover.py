"""Torques of the guard after a takeover."""

import logging
import math
from collections.abc import Iterable

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.states import JointStateReader
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.records import Array

_log = logging.getLogger(__name__)


class Takeover:
    """Reader of the guard's torques after the last command; `patience` is the guard's, s."""

    def __init__(self, model: RobotModel, endpoints: Iterable[Endpoint], transport: Transport, patience: float) -> None:
        (endpoint,) = [endpoint for endpoint in endpoints if endpoint.key == "guard_commands"]
        self._stream, self._name = transport.stream(endpoint, 1), endpoint.name
        self._reader = JointStateReader(model.joints, "effort")
        self._model, self._patience = model, patience
        self._sent_at, self._stamp = math.inf, 0  # wall time, s, and stamp, ns, of the last command

    def record_command(self, now: float, stamp: int) -> None:
        """Store wall time, s, and stamp, ns, of a command."""
        self._sent_at, self._stamp = now, stamp

    def torques(self, now: float) -> Array | None:
        """Return the guard's torques since the last command, (na,) in N·m, or None; `now` is wall time, s."""
        newest = self._stream.take() if now - self._sent_at > self._patience else []
        try:
            command = self._reader.read(newest[-1]) if newest else None
        except InputRefused as refusal:
            _log.warning("%s refused: %s", self._name, refusal)
            return None
        if command is None or command.stamp != self._stamp:
            return None
        limits = self._model.effort_limits
        return np.clip(self._model.actuation.from_joints(command.effort), -limits, limits)
