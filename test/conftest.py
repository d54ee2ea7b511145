"""What the tests of the service share: robots built once, messages in one line, and a controller on a bench."""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from busy import pytest_runtest_protocol
from forked import forks
from hypothesis import settings as hypothesis_settings
from peer import Sender

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.controller.controller import Controller
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import (  # noqa: F401 - for benchmarks
    decode,
    encode,
    header,
    message,
    odometry,
    setpoint_message,
    trajectory_message,
)
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import Clock, ManualClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.loop import ControlLoop
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.settings.nesting import merged

__all__ = ["forks", "pytest_runtest_protocol"]

# On a busy computer an example may take longer than Hypothesis's limit of 0.2 s.
hypothesis_settings.register_profile("busy computers", deadline=None)
hypothesis_settings.load_profile("busy computers")


@pytest.fixture(scope="session", autouse=True)
def _recordings_of_faults(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Controllers that the tests start leave their recordings of faults in a folder of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@cache
def shipped(name: str) -> tuple[Settings, RobotModel]:
    settings = load_settings(find_configuration(name))
    return settings, make_model(settings)


@cache
def standing(name: str) -> np.ndarray:
    settings, model = shipped(name)
    made = [contact for contact, spec in settings.contacts.items() if spec.enabled]
    return stance(model, make_qp(settings, model), made)


def _twist(twist: Any) -> Any:
    linear, angular = np.split(np.asarray(twist, dtype=float), [3])
    return message("geometry_msgs/msg/Twist", linear=linear, angular=angular)


def _velocity(key: str, values: Any) -> Any:
    """Make a message of the topic ``cmd_vel`` or ``cmd_vel_stamped``."""
    twist = _twist(values)
    return message("geometry_msgs/msg/TwistStamped", header=header(0), twist=twist) if key != "cmd_vel" else twist


def _pose_array(poses: Any, frame: str = "world") -> Any:
    """Poses are x, y in m and heading in rad."""
    made = [
        _setpoint("PoseStamped", [x, y, 0.0, 0.0, 0.0, np.sin(0.5 * heading), np.cos(0.5 * heading)], frame).pose
        for x, y, heading in poses
    ]
    return message("geometry_msgs/msg/PoseArray", header=header(0, frame), poses=made)


def _transform(pose: Any) -> Any:
    place, turn = np.split(np.asarray(pose, dtype=float), [3])
    return message("geometry_msgs/msg/Transform", translation=place, rotation=turn)


def _joint_state(names: Any, position: Any, velocity: Any = (), effort: Any = (), time: int = 1) -> Any:
    arrays = {"position": position, "velocity": velocity, "effort": effort}
    fields = {field: np.array(values, dtype=float) for field, values in arrays.items()}
    return message("sensor_msgs/msg/JointState", header=header(time), name=list(names), **fields)


def _odom(pose: Any, twist: Any = (0.0,) * 6, child: str = "", time: int = 1, frame: str = "world") -> Any:
    return odometry(time, frame, child, np.asarray(pose, dtype=float), np.asarray(twist, dtype=float))


def _joint_trajectory(names: Any, points: Any, start: int = 0) -> Any:
    """Points are (time, positions, velocities, accelerations); the last two may be left out."""
    times, fields = [time for time, *_ in points], []
    for _, *arrays in points:
        floats = [np.asarray(array, dtype=float) for array in arrays]
        fields.append(dict(zip(("positions", "velocities", "accelerations"), floats, strict=False)))
    return trajectory_message("JointTrajectory", names, times, fields, start)


def _frame_trajectory(points: Any, frame: str = "world", names: Any = ("frame",), start: int = 0) -> Any:
    """Points are (time, list of transforms (7,), list of twists (6,))."""
    times, fields = [time for time, *_ in points], []
    for _, transforms, *twists in points:
        velocities = [_twist(twist) for twist in (twists[0] if twists else ())]
        fields.append({"transforms": [_transform(transform) for transform in transforms], "velocities": velocities})
    content = trajectory_message("MultiDOFJointTrajectory", names, times, fields, start)
    content.header.frame_id = frame
    return content


def _setpoint(kind: str, values: Any, frame: str) -> Any:
    return setpoint_message(f"geometry_msgs/msg/{kind}", "", values, frame=frame)


MAKE = SimpleNamespace(
    joint_state=_joint_state,
    odom=_odom,
    joint_trajectory=_joint_trajectory,
    frame_trajectory=_frame_trajectory,
    string=lambda text: message("std_msgs/msg/String", data=text),
    bool=lambda value: message("std_msgs/msg/Bool", data=value),
    float64=lambda value: message("std_msgs/msg/Float64", data=float(value)),
    point=lambda values, frame="world": _setpoint("PointStamped", values, frame),
    vector=lambda values, frame="world": _setpoint("Vector3Stamped", values, frame),
    pose=lambda position, quaternion=(0.0, 0.0, 0.0, 1.0), frame="world": _setpoint(
        "PoseStamped", [*position, *quaternion], frame
    ),
    pose_array=_pose_array,
    velocity=_velocity,
    wrench=lambda values, frame="world": _setpoint("WrenchStamped", values, frame),
)


class Bench(Sender):
    """A whole controller on the memory transport, with a clock that is set by hand, and its user."""

    def __init__(
        self,
        name: str = "go2",
        changes: Mapping[str, Any] | None = None,
        record: Callable[[Settings], Any] | None = None,
    ) -> None:
        self.settings, self.model = shipped(name)
        if changes:
            self.settings = Settings.model_validate(merged(self.settings.model_dump(), changes))
        self.q = standing(name)
        self.v = np.zeros(self.model.nv)
        self.clock = ManualClock(100.0)
        self.period = 1.0 / self.settings.control.rate
        self.reports: list[Any] = []
        self.topics = controller_endpoints(self.settings, self.model)
        self.bus = MemoryBus()
        self.transport = MemoryTransport(self.bus)
        self.recorder = record(self.settings) if record is not None else None
        self.loop = self.remake(self.clock)
        self._types = {(topic.key, topic.subject): topic.type for topic in self.topics}
        self._payloads: dict[tuple[str, str], list[bytes]] = {key: [] for key in self._types}
        super().__init__(MemoryTransport(self.bus), self.topics)

    def _take(self, topic: Endpoint, payload: bytes) -> None:
        self._payloads[topic.key, topic.subject].append(payload)

    def remake(self, clock: Clock) -> ControlLoop:
        """A loop on another clock."""
        return make_loop(
            Controller(self.settings, preflight=False, model=self.model),
            self.transport,
            clock,
            self.topics,
            observers=(self.reports.append,),
            recorder=self.recorder,
        )

    @property
    def time(self) -> int:
        return round(self.clock.time * 1e9)

    def command(self, word: str) -> None:
        self.say("command", word)

    def joints(self, **changes: Any) -> None:
        q, v = self.q[self.model.q_index], self.v[self.model.v_index]
        fields = {"names": self.model.joints, "position": q, "velocity": v, "time": self.time}
        self.send("joint_states", MAKE.joint_state(**{**fields, **changes}))

    def base(self, **changes: Any) -> None:
        fields = {"pose": self.q[:7], "twist": self.v[:6], "child": self.model.base_link, "time": self.time}
        self.send("odom", MAKE.odom(**{**fields, **changes}))

    def give_state(self, *, joints: bool = True, base: bool = True) -> None:
        """Let a period pass, and send the state."""
        self.clock.time += self.period
        if base:
            self.base()
        if joints:
            self.joints()

    def cycle(self, count: int = 1, **parts: bool) -> Any:
        """Let a period pass, give the state, and run a cycle."""
        for _ in range(count):
            self.give_state(**parts)
            report = self.loop.cycle()
        return report

    def request(self, word: str) -> Any:
        """Send a command, and run a cycle."""
        self.command(word)
        return self.cycle()

    def activate(self) -> Any:
        return self.request("activate")

    def activated(self, cycles: int = 0) -> "Bench":
        """The bench itself, activated some cycles ago."""
        self.activate()
        if cycles:
            self.cycle(cycles)
        return self

    def received(self, key: str, subject: str = "") -> list[Any]:
        """What has come on a topic, with what is still being composed."""
        self.loop._outputs.finish()
        return [decode(payload, self._types[key, subject]) for payload in self._payloads[key, subject]]

    all = received

    def efforts(self) -> np.ndarray:
        return np.array([content.data for content in self.received("effort")]).reshape(-1, self.model.na)


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """Makes messages of each type that the controller reads."""
    return MAKE


@pytest.fixture(scope="session")
def robot_of() -> Callable[[str], tuple[Settings, RobotModel]]:
    """Settings and model of a shipped robot, by name; built once."""
    return shipped


@pytest.fixture(scope="session")
def stance_of() -> Callable[[str], np.ndarray]:
    """Configuration in which a shipped robot stands in its nominal posture."""
    return standing


@pytest.fixture(scope="session")
def changed() -> Callable[[Settings, Mapping[str, Any]], Settings]:
    """Settings with some values changed."""
    return lambda settings, changes: Settings.model_validate(merged(settings.model_dump(), changes))


@pytest.fixture(scope="session")
def bench() -> Callable[..., Bench]:
    """Builds a `Bench` of a robot, with some settings changed."""
    return Bench
