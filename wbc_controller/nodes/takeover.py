"""Torques of the guard after a takeover."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.joint_states import JointStateReader
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.records import Array

_log = logging.getLogger(__name__)


class Takeover:
    """Reader of the torques that the guard sent after the controller's last command."""

    def __init__(self, model: RobotModel, endpoints: Iterable[Endpoint], transport: Transport, patience: float) -> None:
        """Subscribe to the guard's commands; `patience` is the guard's, s."""
        (endpoint,) = [endpoint for endpoint in endpoints if endpoint.key == "guard_commands"]
        self._stream, self._name, self._limit = transport.stream(endpoint, 1), endpoint.name, LogLimit()
        self._reader = JointStateReader(model.joints, "effort")
        self._model, self._patience = model, patience
        self._sent_at, self._stamp = math.inf, 0  # of the last command: wall time, s, and stamp, ns

    def record_command(self, now: float, stamp: int) -> None:
        """Store the wall time, s, and the stamp, ns, of a sent command."""
        self._sent_at, self._stamp = now, stamp

    def torques(self, now: float) -> Array | None:
        """Return the guard's newest torques since the last command, (na,) in N·m, or None; `now` is wall time, s."""
        if not (now - self._sent_at > self._patience):
            return None
        for payload in self._stream.take():
            try:
                command = self._reader.read(payload)
            except InputRefused as refusal:
                if self._limit.passes(self._name):
                    _log.warning("%s refused: %s", self._name, refusal)
                continue
            if command.stamp == self._stamp:
                limits = self._model.effort_limits
                return np.clip(self._model.actuation.from_joints(command.effort), -limits, limits)
        return None
