"""The estimator of the base under test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from wbc_controller.fuzz.contents import ordinary
from wbc_controller.fuzz.target import CYCLE_LIMIT, Broken, fuzzed_robot, incoming, within, writers
from wbc_controller.mock.measurement import STREAMS, measure
from wbc_controller.mock.plant import Plant
from wbc_controller.service.clock import ManualClock
from wbc_controller.service.estimator_service import EstimatorService
from wbc_controller.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.wire.messages import decode, encode
from wbc_controller.wire.topics import ESTIMATOR_NODE, ESTIMATOR_TOPICS, Endpoint, counterpart, endpoints

#: Time for which the robot stands still at the start, s: short, as every episode begins with it.
_SETTLING = 0.1


class EstimatorTarget:
    """The estimator of a robot that stands still, whose sensors go on between the messages."""

    def __init__(self, robot: str) -> None:
        """Build the node, and let it begin its estimate.

        Args:
            robot: name of a shipped robot.
        """
        fuzzed = fuzzed_robot(robot)
        # Every cycle says what was refused.
        control = fuzzed.settings.control.model_copy(update={"diagnostics_rate": 1000.0})
        estimation = fuzzed.settings.estimation.model_copy(update={"settling": _SETTLING})
        settings = fuzzed.settings.model_copy(update={"control": control, "estimation": estimation})
        self._model = fuzzed.model
        topics = list(endpoints(ESTIMATOR_TOPICS, ESTIMATOR_NODE, contacts=settings.contacts))
        self.topics: Mapping[str, Endpoint] = {
            name: topic for name, topic in incoming(topics).items() if topic.key != "robot_description"
        }
        bus, self._clock = MemoryBus(), ManualClock(1.0)
        self._node = EstimatorService(settings, self._model, topics, MemoryTransport(bus), self._clock)
        user = MemoryTransport(bus)
        self._publish = writers(self.topics, user)
        self._heard: dict[str, list[bytes]] = {"odom": [], "diagnostics": []}
        self._types = {topic.key: topic.type for topic in topics}
        for topic in topics:
            if topic.key in self._heard:
                user.subscribe(counterpart(topic), self._heard[topic.key].append)
        self._period = 1.0 / settings.control.rate
        self._names = {topic.key: topic.name for topic in self.topics.values()}
        self._standing = measure(self._model, Plant(self._model, settings), 0, self._node.estimator.imu_frame)
        for _ in range(round(2.0 * _SETTLING / self._period)):
            self._go_on("the start")
        self.alive = self._node.estimator.base is not None
        if not self.alive:
            raise Broken(f"the estimator does not begin: {self._node.estimator.waits_for}")

    def example(self, topic: Endpoint) -> Any:
        """An ordinary message of a topic, valid now."""
        if topic.key in STREAMS:
            return self._sensed(topic.key)
        return ordinary(topic.type, self._model.joints, "", round(1e9 * self._clock.time))

    def take(self, topic: Endpoint, payload: bytes) -> None:
        """Deliver a message between those of the sensors; see `Target`."""
        what = f"a message on {topic.name}"
        self._clock.time += 0.5 * self._period
        self._publish[topic.name](payload)
        answers = self._cycle(what)
        refused = self._refused()
        if refused and answers:
            raise Broken(f"{what} was refused ({refused}), and is answered all the same")
        self._go_on(f"the cycle behind {what}")
        self.alive = self._node.estimator.base is not None

    def finish(self) -> None:
        """Go on once more; see `Target`."""
        self._go_on("the end")

    def _sensed(self, stream: str) -> Any:
        self._standing.stamps = dict.fromkeys(STREAMS, round(1e9 * self._clock.time))
        return self._standing.message(stream)

    def _go_on(self, what: str) -> None:
        """One period of the robot's own sensors."""
        self._clock.time += self._period
        for stream in ("imu", "joint_states"):
            self._publish[self._names[stream]](encode(self._sensed(stream)))
        self._cycle(what)

    def _cycle(self, what: str) -> int:
        """Run a cycle, and look at what it has published; gives the number of estimates."""
        heard = self._heard["odom"]
        heard.clear()
        self._heard["diagnostics"].clear()
        with within(CYCLE_LIMIT, what):
            self._node.cycle()
        for payload in heard:
            odom = decode(payload, self._types["odom"])
            pose, twist = odom.pose.pose, odom.twist.twist
            numbers = [getattr(part, axis) for part in (pose.position, twist.linear, twist.angular) for axis in "xyz"]
            turned = np.array([getattr(pose.orientation, axis) for axis in "xyzw"])
            if not (np.isfinite(numbers).all() and abs(float(turned @ turned) - 1.0) < 1e-6):
                raise Broken(f"{what}: the estimate is no pose with a twist: {numbers}, {turned.tolist()}")
            for covariance in (odom.pose.covariance, odom.twist.covariance):
                variances = covariance.reshape(6, 6).diagonal()
                if not (np.isfinite(covariance).all() and (variances >= 0.0).all()):
                    raise Broken(f"{what}: the covariance of the estimate is none: {variances.tolist()}")
        return len(heard)

    def _refused(self) -> str:
        """What the newest diagnostics say to be refused."""
        if not self._heard["diagnostics"]:
            return ""
        (status,) = decode(self._heard["diagnostics"][-1], self._types["diagnostics"]).status
        return "; ".join(each.value for each in status.values if each.key.startswith("refused/"))
