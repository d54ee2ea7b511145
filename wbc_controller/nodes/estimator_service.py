"""The base estimator as a service; with `estimation.base_state: imu` the controller estimates its base itself."""

import gc
import logging
import math
import threading
import time
from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.controller.build.contacts import make_contact
from wbc_controller.controller.build.estimation import make_estimator
from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import OK, WARN, diagnostics, encode, odometry, transform
from wbc_controller.middleware.topics import ESTIMATOR_NODE, ESTIMATOR_TOPICS, Direction, Endpoint, endpoints
from wbc_controller.middleware.transports.transport import Publish, Transport
from wbc_controller.nodes.clock import Clock, MonotonicClock
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.urdf import find_urdf
from wbc_controller.nodes.wiring import make_vocabulary
from wbc_controller.settings import Settings

FRAME, MAP = "odom", "map"  # REP 105: continuous, drifting odometry, and absolute poses
_FRESH = 0.1  # validity of a contact force of the controller, s
_TRANSFORMS = 0.02  # period, s
_WAIT = 0.1  # for joint states between diagnostics, s

_log = logging.getLogger(__name__)


class EstimatorService:
    """Base estimator that answers each joint state, on the thread that calls `cycle`.

    A fixed base, an IMU without frame, or missing contacts raise `ConfigurationError`.
    """

    def __init__(
        self,
        settings: Settings,
        model: RobotModel,
        topics: Sequence[Endpoint],
        transport: Transport,
        clock: Clock,
        namespace: str = "/",
    ) -> None:
        contacts = {name: make_contact(name, spec, model) for name, spec in settings.contacts.items()}
        self.estimator = make_estimator(settings, model, contacts)
        self._enabled = frozenset(name for name, spec in settings.contacts.items() if spec.enabled)
        self._base, self._clock = model.base_link, clock
        self._name, self._hardware = f"{namespace.strip('/')}/{ESTIMATOR_NODE}: base".strip("/"), model.name
        self._force_arrivals: dict[str, float] = {}  # s, by contact
        self._publish: dict[str, Publish] = {
            topic.key: transport.advertise(topic) for topic in topics if topic.direction is Direction.OUT
        }
        self._forces = {topic.subject: transport.stream(topic, 1) for topic in topics if topic.key == "contact_wrench"}
        sensors = [topic for topic in topics if topic.key != "contact_wrench"]  # of the controller
        words = make_vocabulary(settings, model)
        self._inputs = Inputs(settings, model, contacts, words, sensors, transport, clock, estimator=self.estimator)
        self._stamp = -math.inf
        self._transform_due = self._diagnostics_due = -math.inf
        self._diagnostics_period = 1.0 / settings.control.diagnostics_rate
        self._refused: dict[str, str] = {}  # newest reason, by topic
        self._published_text = ""

    def active_contacts(self) -> frozenset[str]:
        """Return the contacts with recent contact forces of the controller; without any, the enabled contacts."""
        now = self._clock.now()
        # On the thread of the states, so that forces and states have the same delay.
        for name, stream in self._forces.items():
            if stream.take():
                self._force_arrivals[name] = now
        return frozenset(name for name, at in self._force_arrivals.items() if now - at <= _FRESH) or self._enabled

    def cycle(self) -> None:
        """Read the messages, and publish a new estimate."""
        latched = self._inputs.latch(self.active_contacts())
        for sentence in latched.refused:
            topic, named, reason = sentence.partition(": ")
            if named:  # without a topic: a slipping contact, already in the diagnostics
                self._refused[topic] = reason
        estimator, found = self.estimator, self.estimator.odometry
        if found is not None and estimator.stamp > self._stamp:
            self._stamp, stamp = estimator.stamp, self._inputs.joints.newest.stamp
            pose, twist = found
            content = odometry(stamp, FRAME, self._base, pose, twist, estimator.covariance)
            self._publish["odom"](encode(content))
            now = self._clock.now()
            if now >= self._transform_due:
                self._transform_due = now + _TRANSFORMS
                self._publish["tf"](encode(transform(stamp, FRAME, self._base, pose)))
                poses = estimator.poses
                if poses is not None and poses.aligned:
                    self._publish["tf"](encode(transform(stamp, MAP, FRAME, poses.map_to_odometry)))
        elif found is None:
            self._stamp = -math.inf  # the next estimate may have another clock
        self._publish_diagnostics(latched.estimate)

    def _publish_diagnostics(self, about: Mapping[str, str]) -> None:
        estimator, now = self.estimator, self._clock.now()
        text = estimator.waits_for if estimator.odometry is None else "the base is estimated"
        if estimator.odometry is not None and estimator.waits_for:
            text += f"; no estimate in {MAP}: {estimator.waits_for}"
        if estimator.slipping:
            text += f"; contact {', '.join(estimator.slipping)} slips and is ignored"
        changed = text.partition(":")[0] != self._published_text.partition(":")[0]
        if not changed and now < self._diagnostics_due:
            return
        if changed:
            _log.info("%s", text)
        self._published_text, self._diagnostics_due = text, now + self._diagnostics_period
        refused, self._refused = self._refused, {}
        values: dict[str, str] = {"holding": ", ".join(sorted(self._inputs.holding)) or "none"}
        values |= {f"age/{name}": f"{age:.4f} s" for name, age in self._inputs.ages().items()} | self._inputs.status()
        found = estimator.covariance
        if found is not None:
            tilt, speed = np.sqrt(np.diag(found[0])[3:5].max()), np.sqrt(np.diag(found[1])[:3].max())
            values["tilt"] = f"standard deviation {tilt:.5f} rad"
            values["velocity"] = f"standard deviation {speed:.5f} m/s"
        values |= {f"note/{name}": note for name, note in self._inputs.notes().items()} | dict(about)
        values |= {f"refused/{topic}": reason for topic, reason in refused.items()}
        level = WARN if estimator.base is None or estimator.slipping or refused else OK
        content = diagnostics(time.time_ns(), level, self._name, text, self._hardware, values)
        self._publish["diagnostics"](encode(content))

    def run(self, stop: threading.Event) -> None:
        """Run until stopped."""
        gc.collect()
        gc.freeze()  # shortens later collections
        self._inputs.discard_pending()
        while not stop.is_set():
            self._inputs.wait(_WAIT)
            self.cycle()


def run_estimator(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    *,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> None:
    """Run the estimator until the event is set; arguments as for `run_controller`, errors as for `EstimatorService`."""
    topics = endpoints(ESTIMATOR_TOPICS, ESTIMATOR_NODE, settings, namespace=namespace, remappings=remappings)
    urdf = find_urdf(settings, transport, stop, topics)
    if stop.is_set():
        return
    model = make_model(settings, urdf)
    EstimatorService(settings, model, topics, transport, MonotonicClock(), namespace).run(stop)
