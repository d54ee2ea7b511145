"""Execution of a demo scenario by topics."""

import threading
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from time import monotonic
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.apps.demo.scenario import Move, Reach, Scenario, Shove, Walk
from wbc_controller.errors import WbcError
from wbc_controller.inverse_dynamics.references.trajectories import Knot, Trajectory
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.middleware import codec
from wbc_controller.middleware.stamps import header_stamp, header_time
from wbc_controller.middleware.states import JointStateReader, OdometryReader
from wbc_controller.middleware.topics import Direction, Endpoint, counterpart
from wbc_controller.middleware.transports.transport import Publish, Transport
from wbc_controller.nodes.wiring import topics_of
from wbc_controller.recording.report.run_data import PHASES, truth_topics
from wbc_controller.records import Array
from wbc_controller.settings import Settings

_TIMEOUT = 20.0  # wall time, s
_START_DELAY = 0.1  # before the start of a trajectory, s
_SETTLING_TIME = 1.5  # s
_COMMAND_PERIOD = 0.1  # between two velocity commands, s

_AT_REST = np.zeros(3)
#: Published and received topics by node and key; the joint states give the time.
_SENT = {("controller", key) for key in ("command", "setpoint", "trajectory", "update", "cmd_vel")}
_SENT |= {("mock", "push"), ("mock", "hold")}
_STATE = ("mock", "joint_states")
_HEARD = (_STATE, ("mock", "odom"), ("controller", "state"))
_STRING = "std_msgs/msg/String"

#: Function that records name and type of a topic, stamp in ns, and message.
Record = Callable[[str, str, int, bytes], None]
Windows = Mapping[str, tuple[float, float]]  # start and end of each measurement, simulated time, s


class DemoFailed(WbcError):
    """The demo could not continue: the robot fell or a process ended."""


class Director:
    """Executes a scenario."""

    def __init__(
        self,
        settings: Settings,
        model: RobotModel,
        scenario: Scenario,
        transport: Transport,
        advance: Callable[[threading.Event], None],
        record: Record,
        report_phase: Callable[[str], None],
    ) -> None:
        """Open the topics.

        `advance` waits for `arrived`, or in lockstep executes one step; `record` receives the messages of
        `truth_topics` and the phases.
        """
        self.arrived = threading.Event()  # set by each joint state, on the transport's thread
        self.windows: dict[str, tuple[float, float]] = {}
        #: Start, s, and trajectory of the centre of mass; None while the robot walks.
        self.references: list[tuple[float, Trajectory | None]] = []
        self.targets: dict[str, tuple[int, Array]] = {}  # frame and its target, (3,) in m, by task
        self._tasks, self._model, self._scenario = settings.tasks, model, scenario
        self._data = model.pinocchio.createData()
        self._joint_reader = JointStateReader(model.joints, "position")
        self._base_reader = OdometryReader(model.base_link)
        self._advance, self._record, self._report_phase = advance, record, report_phase
        self._newest: dict[tuple[str, str], bytes] = {}  # payload by node and key
        self._publish: dict[tuple[str, str, str], Publish] = {}
        self._recorded = {topic.name for topic in truth_topics(settings)}
        for (node, key, subject), topic in topics_of(settings).items():
            if topic.direction is Direction.OUT and (topic.name in self._recorded or (node, key) in _HEARD):
                transport.subscribe(counterpart(topic), partial(self._receive, (node, key), topic))
            elif topic.direction is Direction.IN and (node, key) in _SENT:
                self._publish[node, key, subject] = transport.advertise(counterpart(topic))

    def _receive(self, place: tuple[str, str], topic: Endpoint, payload: bytes) -> None:
        self._newest[place] = payload
        if topic.name in self._recorded:
            self._record(topic.name, topic.type, header_stamp(payload), payload)
        if place == _STATE:
            self.arrived.set()

    def play(self) -> None:
        """Execute the scenario; raise `DemoFailed` if the demo cannot continue."""
        scenario = self._scenario
        self._begin("start")
        self._wait_for("joint state of the mock robot", lambda: _STATE in self._newest)
        self._wait_for("state of the controller", lambda: self._mode() != "")
        self._let_pass(_SETTLING_TIME)  # the base estimator initializes at rest
        self._activate()
        self._run(1.2)
        if self._model.floating_base:
            self._begin("let go")
            self._send("mock", "hold", "", codec.message("std_msgs/msg/Bool", data=False))
            self._run(1.0)
        self._follow(((0.5, (0.0, 0.0, 0.0)),), self.com())
        self._run(1.0)
        self._begin("stand")
        self._measure("stand", scenario.stand)
        for move in scenario.moves:
            self._move(move)
        for reach in scenario.reaches:
            self._reach(reach)
        for shove in scenario.shoves:
            self._shove(shove)
        for walk in scenario.walks:
            self._walk(walk)
        if scenario.walks:
            self._begin("stop")
            self._run(scenario.stop)  # the command times out
            self._measure("stop", 1.0)
            return  # the hoist would pull the robot back to its start
        self._begin("end")
        self._send("mock", "hold", "", codec.message("std_msgs/msg/Bool", data=True))
        self._run(0.5)
        self._send_text("command", "deactivate")
        self._let_pass(1.2)

    @property
    def time(self) -> float:
        """Simulated time of the newest joint state, s; initially 0."""
        return header_time(self._newest[_STATE]) if _STATE in self._newest else 0.0

    def _begin(self, phase: str) -> None:
        self._record(PHASES, _STRING, round(1.0e9 * self.time), codec.encode(codec.message(_STRING, data=phase)))
        self._report_phase(phase)

    def _mode(self) -> str:
        payload = self._newest.get(("controller", "state"))
        return "" if payload is None else str(codec.decode(payload, _STRING).data)

    def _activate(self) -> None:
        # The first request may be lost during discovery, or arrive before the base estimate.
        end = monotonic() + _TIMEOUT
        while monotonic() < end:
            self._send_text("command", "activate")
            for _ in range(50):
                self._advance(self.arrived)
                if self._mode().startswith("active"):
                    return
        raise DemoFailed(f"the controller did not become active; its state is {self._mode()!r}")

    def _send_text(self, key: str, text: str) -> None:
        self._send("controller", key, "", codec.message(_STRING, data=text))

    def _send(self, owner: str, key: str, subject: str, content: Any) -> None:
        self._publish[owner, key, subject](codec.encode(content))

    def _wait_for(self, awaited: str, condition: Callable[[], bool]) -> None:
        end = monotonic() + _TIMEOUT  # wall time
        while monotonic() < end:
            if condition():
                return
            self._advance(self.arrived)
        raise DemoFailed(f"timeout: no {awaited} within {_TIMEOUT:g} s")

    def _run(self, duration: float) -> None:
        """Let time pass; raise `DemoFailed` unless the robot stands upright under control."""
        self._let_pass(duration)
        if not self._mode().startswith("active"):
            raise DemoFailed(f"the controller is no longer active; its state is {self._mode()!r}")
        if self._model.floating_base and pin.XYZQUATToSE3(self.state()[:7]).rotation[2, 2] < 0.5:
            raise DemoFailed("the robot fell")

    def _measure(self, name: str, duration: float) -> None:
        start = self.time
        self._run(duration)
        self.windows[name] = start, self.time

    def _let_pass(self, duration: float) -> None:
        end = self.time + duration
        silent = 0
        while (before := self.time) < end - 1.0e-9:
            self._advance(self.arrived)
            silent = silent + 1 if self.time <= before else 0
            if silent > _TIMEOUT / 0.05:
                raise DemoFailed(f"no joint state from the mock robot for {_TIMEOUT:g} s")

    def state(self) -> Array:
        """Return the newest configuration, (nq,)."""
        model = self._model
        base: tuple[Array, ...] = ()
        if model.floating_base:
            base = self._base_reader.read(self._newest["mock", "odom"])[1:]
        return model.state(self._joint_reader.read(self._newest[_STATE]).position, np.zeros(model.nj), *base)[0]

    def com(self) -> Array:
        """Return the newest centre of mass, (3,) in m."""
        return np.array(pin.centerOfMass(self._model.pinocchio, self._data, self.state()))

    def _follow(self, points: Iterable[tuple[float, tuple[float, float, float]]], origin: Array) -> float:
        start = self.time + _START_DELAY
        knots = [Knot(start, origin, _AT_REST, _AT_REST)]
        knots += [Knot(start + time, origin + np.array(offset), _AT_REST, _AT_REST) for time, offset in points]
        self.references.append((start, Trajectory(knots)))
        if not self._scenario.com:
            return start
        times, positions = [knot.time - start for knot in knots], np.array([knot.position for knot in knots])
        content = codec.com_trajectory(times, positions, task=self._scenario.com, stamp=round(start * 1e9))
        self._send("controller", "trajectory", self._scenario.com, content)
        return start

    def _move(self, move: Move) -> None:
        self._begin(move.name)
        reference = self.references[-1][1]
        start = self._follow(move.points, self.com() if reference is None else reference.sample(self.time).position)
        self._run(move.duration + _START_DELAY)
        self.windows[move.name] = start, self.time
        self._run(0.5)

    def _reach(self, reach: Reach) -> None:
        self._begin("reach")
        pin.framesForwardKinematics(self._model.pinocchio, self._data, self.state())
        frame = self._model.frame_id(self._tasks[reach.task].frame, f"tasks.{reach.task}.frame")  # type: ignore[union-attr]
        pose = self._data.oMf[frame]
        target = pose.translation + np.array(reach.offset)
        self.targets[reach.task] = frame, target
        self._send_text("update", f"{{tasks: {{{reach.task}: {{enabled: true}}}}}}")
        pose_value = np.concatenate([target, quaternion_of(pose.rotation)])
        content = codec.setpoint_message("geometry_msgs/msg/PoseStamped", "frame_pose", pose_value)
        self._send("controller", "setpoint", reach.task, content)
        self._measure(f"reach {reach.task}", reach.duration)
        self._send_text("update", f"{{tasks: {{{reach.task}: {{enabled: false}}}}}}")
        self._run(_SETTLING_TIME)

    def _shove(self, shove: Shove) -> None:
        self._begin(shove.name)
        force = np.array(shove.impulse) / 0.1
        self._send("mock", "push", "", codec.wrench_stamped(force, shove.frame or self._model.base_link))
        self._measure(shove.name, self._scenario.recovery + 0.5)

    def _walk(self, walk: Walk) -> None:
        self._begin(walk.name)
        start = self.time
        self.references.append((start, None))
        while self.time < start + walk.duration:
            self._send("controller", "cmd_vel", "", codec.velocity_message(walk.velocity))
            self._run(_COMMAND_PERIOD)
        self.windows[walk.name] = start + walk.acceleration, self.time
