"""Base estimator as a target."""

from typing import Any

import numpy as np

from wbc_controller.estimation.absolute_pose import AGREEMENT_TIME
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import ESTIMATOR_NODE, ESTIMATOR_TOPICS, Endpoint, endpoints
from wbc_controller.nodes.estimator_service import EstimatorService
from wbc_controller.simulation.measurement import STREAMS, measure
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.fuzz.examples import valid_message
from wbc_controller.validation.fuzz.target import (
    CYCLE_LIMIT,
    InvariantViolation,
    Target,
    fuzzed_robot,
    time_limit,
    with_all_diagnostics,
)

_SETTLING = 0.1  # of the estimator, s; short for short episodes
#: Time between two states during the first absolute poses, s; below IMU gaps.
_POSE_PERIOD = 0.05


class EstimatorTarget(Target):
    """Estimator of a standing robot with continuous sensors between the messages."""

    def __init__(self, robot: str) -> None:
        fuzzed = fuzzed_robot(robot)
        estimation = fuzzed.settings.estimation.model_copy(update={"settling": _SETTLING, "absolute_pose": True})
        settings = with_all_diagnostics(fuzzed.settings).model_copy(update={"estimation": estimation})
        self._model = fuzzed.model
        topics = list(endpoints(ESTIMATOR_TOPICS, ESTIMATOR_NODE, contacts=settings.contacts))
        super().__init__(topics, ("odom", "diagnostics"))
        self._node = EstimatorService(settings, self._model, topics, self.transport(), self.clock)
        self._period = 1.0 / settings.control.rate
        self._standing = measure(self._model, Plant(self._model, settings), 0, self._node.estimator.imu_frame)
        for _ in range(round(2.0 * _SETTLING / self._period)):
            self._advance("the start")
        for _ in range(round(AGREEMENT_TIME / _POSE_PERIOD) + 2):
            self.clock.time += _POSE_PERIOD - self._period
            self.send("pose", self._sensed("pose"))
            self._advance("the start of poses")
        self.alive = self._node.estimator.base is not None
        if not self.alive:
            raise InvariantViolation(f"no estimate: {self._node.estimator.waits_for}")

    def example(self, topic: Endpoint) -> Any:
        """See `Target`."""
        if topic.key in STREAMS:
            return self._sensed(topic.key)
        return valid_message(topic.type, self._model.joints, "", round(1e9 * self.clock.time))

    def deliver(self, topic: Endpoint, payload: bytes) -> None:
        """Deliver a message between the sensors' messages."""
        what = f"a message on {topic.name}"
        self.clock.time += 0.5 * self._period
        self.publish(topic, payload)
        answers = self._cycle(what)
        refused = "; ".join(self.refused().values())
        if refused and answers:
            raise InvariantViolation(f"{what} was refused ({refused}), but an estimate was published")
        self._advance(f"the cycle after {what}")
        self.alive = self._node.estimator.odometry is not None

    def finish(self) -> None:
        """Execute one more period."""
        self._advance("the end")

    def _sensed(self, stream: str) -> Any:
        self._standing.stamps = dict.fromkeys(STREAMS, round(1e9 * self.clock.time))
        return self._standing.message(stream)

    def _advance(self, what: str) -> None:
        self.clock.time += self._period
        for stream in ("imu", "joint_states"):
            self.send(stream, self._sensed(stream))
        self._cycle(what)

    def _cycle(self, what: str) -> int:
        self.clear_outputs()
        with time_limit(CYCLE_LIMIT, what):
            self._node.cycle()
        for payload in self.outputs["odom"]:
            odom = decode(payload, self.types["odom"])
            pose, twist = odom.pose.pose, odom.twist.twist
            numbers = [getattr(part, axis) for part in (pose.position, twist.linear, twist.angular) for axis in "xyz"]
            turned = np.array([getattr(pose.orientation, axis) for axis in "xyzw"])
            if not (np.isfinite(numbers).all() and abs(float(turned @ turned) - 1.0) < 1e-6):
                raise InvariantViolation(f"{what}: invalid pose or twist of the estimate: {numbers}, {turned.tolist()}")
            for covariance in (odom.pose.covariance, odom.twist.covariance):
                variances = covariance.reshape(6, 6).diagonal()
                if not (np.isfinite(covariance).all() and (variances >= 0.0).all()):
                    raise InvariantViolation(
                        f"{what}: invalid covariance of the estimate: variances {variances.tolist()}"
                    )
        return len(self.outputs["odom"])
