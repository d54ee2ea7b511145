"""The ROS 2 executables: `wbc_controller`, a managed lifecycle node, and `mock_robot`, a plain one.

Besides ``transports/ros2.py``, the only importer of rclpy. Three threads: the main one waits for a signal, one spins
the executor, and one runs the control loop (or the mock robot's physics).
"""

from __future__ import annotations

import contextlib
import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from wbc_controller.build import controller_endpoints, make_loop, make_model
from wbc_controller.clock import MonotonicClock
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.interface import CONTROLLER_TOPICS, REQUEST, Endpoint, endpoints
from wbc_controller.loop import ControlLoop
from wbc_controller.messages import decode, encode, message
from wbc_controller.records import CycleReport, Mode
from wbc_controller.ros2_parameters import CONFIG, ROBOT, is_of_the_robot, settings_from
from wbc_controller.service import run_mock
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.transports.transport import Publish, Transport

_MISSING: ImportError | None = None
try:
    import rclpy
    from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.executors import ExternalShutdownException, ShutdownException
    from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
    from rclpy.task import Future
    from std_srvs.srv import Trigger

    from wbc_controller.transports.ros2 import Ros2Transport, StreamsFirstExecutor
except ImportError as _error:  # the entry points say so: an import must not
    _MISSING = _error
    LifecycleNode = object

_log = logging.getLogger(__name__)

MOCK_NAME = "mock_robot"
#: Time between two reminders that the URDF has not come yet, s.
_REMINDER = 5.0
#: Longest time for shutting down on an executor that may have failed, s.
_PATIENCE = 5.0
#: Parameters of the nodes themselves, with their defaults.
_CONTROLLER_PARAMETERS: dict[str, tuple[Any, str]] = {
    "autostart": (True, "Configure and activate the node at start-up; where that fails, the process ends."),
    "activate": (False, "Activate the controller as soon as its inputs are fresh, without a command."),
}
_MOCK_PARAMETERS: dict[str, tuple[Any, str]] = {
    "real_time_factor": (1.0, "Simulated seconds per second."),
    "lockstep": (False, "Wait for the controller's answer to each state."),
}
_FILE_PARAMETERS: dict[str, tuple[Any, str]] = {
    ROBOT: ("", "Name of a robot that is shipped; other parameters are put over its configuration."),
    CONFIG: ("", "Path of a robot's configuration; other parameters are put over it."),
}
#: Command of each service, and the modes that mean that it was obeyed (none: every one).
_SERVICES: dict[str, tuple[str, frozenset[Mode]]] = {
    "activate": ("activate", frozenset({Mode.ACTIVE, Mode.HOLDING})),
    "deactivate": ("deactivate", frozenset()),
    "reset": ("reset", frozenset({Mode.INACTIVE})),
    "stop": ("estop", frozenset({Mode.FAULT})),
}


class _Gate:
    """A transport through which messages come only while the node is active, as a managed node promises."""

    def __init__(self, transport: Transport) -> None:
        self.open = False
        self._transport = transport
        self._command: Callable[[bytes], None] = lambda payload: None

    def advertise(self, endpoint: Endpoint) -> Publish:
        return self._transport.advertise(endpoint)

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        if endpoint.key == "command":
            self._command = callback

        def deliver(payload: bytes) -> None:
            if self.open:
                callback(payload)
            elif endpoint.qos == REQUEST:
                _log.warning("message on %s ignored: the node is not active", endpoint.name)

        self._transport.subscribe(endpoint, deliver)

    def command(self, word: str) -> None:
        """Leave a command where those of the command topic arrive."""
        self._command(encode(message("std_msgs/msg/String", data=word)))

    def close(self) -> None:
        self.open = False
        self._transport.close()


class _Answers:
    """Finds out what became of a command that a service left in the command's mailbox."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[_Waiting] = []

    def ask(self, word: str, send: Callable[[], None], answer: Callable[[bool, str], None]) -> None:
        """Send a command, and have `answer` called with whether it was obeyed and what happened."""
        # Under the lock, so that of the next two reports the second is of a cycle that began after the sending.
        with self._lock:
            self._waiting.append(_Waiting(word, answer))
            send()

    def observe(self, report: CycleReport) -> None:
        """Look at a cycle, on the loop's thread."""
        if not self._waiting:
            return
        with self._lock:
            self._waiting = [waiting for waiting in self._waiting if not waiting.observe(report)]

    def end(self, reason: str) -> None:
        """Answer all who wait: there are no more cycles."""
        with self._lock:
            ended, self._waiting = self._waiting, []
        for waiting in ended:
            waiting.answer(False, reason)


class _Waiting:
    """One who waits for the end of a command."""

    def __init__(self, word: str, answer: Callable[[bool, str], None]) -> None:
        self.answer = answer
        self._word = word
        self._refusals: list[str] = []
        self._cycles = 0

    def observe(self, report: CycleReport) -> bool:
        """Look at a cycle; whether that was the last one to look at."""
        self._refusals += [text for text in report.refused if text.startswith(f"command {self._word!r}")]
        self._cycles += 1
        if self._cycles < 2:
            return False
        if self._refusals:
            self.answer(False, self._refusals[-1])
            return True
        said = report.mode.value
        if report.fault is not None:
            said += f" {report.fault.code}: {report.fault.sentence}"
        expected = next(modes for word, modes in _SERVICES.values() if word == self._word)
        self.answer(not expected or report.mode in expected, said)
        return True


class ControllerNode(LifecycleNode):  # type: ignore[misc]  # rclpy has no types
    """The controller as a managed node.

    Configuring builds the model, the topics and the loop; activating starts the loop, whose supervisor still waits for
    the command ``activate``; deactivating ends the loop, with zero torques.

    Args:
        leave: called with an exit status when the node cannot do what it was started for.
        arguments: the command line.
        context: of rclpy; the default one where None.
        options: for ``rclpy.node.Node``, such as ``parameter_overrides``.
    """

    def __init__(
        self,
        leave: Callable[[int], None] = lambda status: None,
        arguments: list[str] | None = None,
        context: Any = None,
        **options: Any,
    ) -> None:
        super().__init__(
            NODE_NAME,
            context=context,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
            **options,
        )
        self._leave = leave
        self._arguments = arguments if arguments is not None else sys.argv
        self._own = _declare(self, _CONTROLLER_PARAMETERS)
        self._settings: Settings | None = None
        self._gate: _Gate | None = None
        self._loop: ControlLoop | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._failed = False
        self._answers = _Answers()
        self._urdf: str | None = None
        self._urdf_transport: Any = None
        self._starting = False
        self._changeable = True
        self._finalized = False
        self.add_on_set_parameters_callback(self._on_set_parameters)
        group = ReentrantCallbackGroup()
        for name, (word, _) in _SERVICES.items():
            self.create_service(Trigger, f"~/{name}", partial(self._on_trigger, word), callback_group=group)

    def start(self) -> None:
        """Configure and activate, where the parameter `autostart` says so; on the executor's thread."""
        if not self.get_parameter("autostart").value:
            return
        self._starting = self.trigger_configure() != TransitionCallbackReturn.SUCCESS
        if not self._starting:
            self.trigger_activate()
        elif self._urdf_transport is None:
            self._leave(2)

    def finish(self) -> None:
        """Shut down, from any state; on the executor's thread, or after it has ended. A second call does nothing."""
        if not self._finalized:
            self.trigger_shutdown()

    def on_configure(self, state: Any) -> Any:
        """Read and check the parameters; build the model, the topics and the loop."""
        return self._attempt("configure", self._configure)

    def on_activate(self, state: Any) -> Any:
        """Start the loop."""
        return self._attempt("activate", self._activate)

    def on_deactivate(self, state: Any) -> Any:
        """End the loop, with zero torques."""
        return self._attempt("deactivate", self._deactivate)

    def on_cleanup(self, state: Any) -> Any:
        """Close the topics and forget the model."""
        return self._attempt("clean up", self._clean_up)

    def on_shutdown(self, state: Any) -> Any:
        """End the loop, with zero torques, and close the topics."""
        self._finalized = True
        return self._attempt("shut down", self._clean_up)

    def on_error(self, state: Any) -> Any:
        """Back to unconfigured, with nothing left running."""
        _log.error("error processing: everything is closed, the node is unconfigured; configure it again")
        return self._attempt("process the error", self._clean_up)

    def _attempt(self, what: str, transition: Callable[[], None]) -> Any:
        """Do a transition; its errors go to the log, since rclpy drops them."""
        try:
            transition()
        except WbcError as error:
            _log.error("cannot %s: %s", what, error)
            return TransitionCallbackReturn.FAILURE
        except Exception:
            _log.exception("cannot %s", what)
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        node, namespace = self.get_name(), self.get_namespace()
        settings, source = settings_from(_values(self), self.get_fully_qualified_name(), self._arguments, self._own)
        if not settings.robot.urdf and self._urdf is None:
            self._await_urdf()
            raise ConfigurationError("robot.urdf is empty, and the topic robot_description has brought no URDF yet")
        gate = _Gate(Ros2Transport(self))
        try:
            model = make_model(settings, None if settings.robot.urdf else self._urdf)
            topics = controller_endpoints(settings, model, node=node, namespace=namespace)
            self._loop = make_loop(settings, model, gate, MonotonicClock(), topics, observers=(self._answers.observe,))
        except Exception as error:
            gate.close()
            if isinstance(error, ConfigurationError):
                raise ConfigurationError(f"{source}: {error}") from error
            raise
        self._settings, self._gate, self._changeable = settings, gate, False
        _log.info("configured from %s: %d joints, %.0f Hz", source, model.na, settings.control.rate)

    def _await_urdf(self) -> None:
        if self._urdf_transport is not None:
            return
        rows = [topic for topic in CONTROLLER_TOPICS if topic.key == "robot_description"]
        (endpoint,) = endpoints(rows, self.get_name(), namespace=self.get_namespace())

        def receive(payload: bytes) -> None:
            self._urdf = str(decode(payload, endpoint.type).data)
            if self._starting:
                self.start()

        self._urdf_transport = Ros2Transport(self)
        self._urdf_transport.subscribe(endpoint, receive)
        self.create_timer(_REMINDER, lambda: self._remind(endpoint.name))

    def _remind(self, topic: str) -> None:
        if self._urdf is None:
            _log.warning("robot.urdf is empty: still waiting for the URDF on %s", topic)

    def _activate(self) -> None:
        if self._loop is None or self._gate is None or self._settings is None:
            raise ConfigurationError("the node is not configured")
        if self._loop.supervisor.mode is Mode.STOPPED and self._loop.supervisor.fault is None:
            self._loop.supervisor.request("reset", 0.0, None)  # as after a fresh start; a fault stays latched
        self._stop = threading.Event()
        self._failed = False
        self._thread = threading.Thread(target=self._run, args=(self._loop, self._settings), name="control loop")
        self._gate.open = True
        self._thread.start()
        _log.info("active: waiting for 'activate' on %s/command", self.get_fully_qualified_name())

    def _run(self, loop: ControlLoop, settings: Settings) -> None:
        try:
            loop.run(
                self._stop,
                1.0 / settings.control.rate,
                triggered=settings.control.trigger == "joint_states",
                activate=bool(self.get_parameter("activate").value),
            )
        except Exception:
            _log.exception("the control loop has failed")
            self._failed = True
            executor = self.executor
            if executor is not None:
                executor.create_task(self._after_failure)
        finally:
            self._answers.end("the control loop has ended")

    def _after_failure(self) -> None:
        """Leave the active state, by way of error processing."""
        if self._gate is not None and self._gate.open:
            self.trigger_deactivate()

    def _deactivate(self) -> None:
        self._stop.set()
        if self._thread is not None and self._loop is not None:
            # This thread is also the one that brings joint states: the loop would wait for them until they are stale.
            self._loop.wake()
            self._thread.join()
            self._thread = None
        if self._gate is not None:
            self._gate.open = False
        if self._failed:
            self._failed = False
            raise RuntimeError("the control loop had failed")

    def _clean_up(self) -> None:
        self._failed = False
        self._deactivate()
        if self._gate is not None:
            self._gate.close()
        self._settings, self._gate, self._loop, self._changeable = None, None, None, True

    def _on_set_parameters(self, parameters: list[Any]) -> Any:
        names = [parameter.name for parameter in parameters]
        fixed = [name for name in names if name in (ROBOT, CONFIG) or is_of_the_robot(name, self._own)]
        if fixed and not self._changeable:
            return SetParametersResult(
                successful=False,
                reason=f"{', '.join(fixed)}: read when the node is configured; deactivate and clean up first",
            )
        return SetParametersResult(successful=True)

    async def _on_trigger(self, word: str, request: Any, response: Any) -> Any:
        gate = self._gate
        if gate is None or not gate.open:
            response.success = False
            response.message = "the node is not active; ros2 lifecycle says how it is"
            return response
        future = Future(executor=self.executor)
        future.add_done_callback(lambda done: None)  # what wakes the executor, so that it looks again
        self._answers.ask(word, lambda: gate.command(word), lambda *answer: future.set_result(answer))
        response.success, response.message = await future
        return response


class _RosLog(logging.Handler):
    """Passes this package's log on to the node's."""

    def __init__(self, logger: Any) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # One line of code for each severity: rclpy refuses a call that changes it.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)


def main() -> None:
    """Run the controller's node: the executable `wbc_controller`."""
    sys.exit(_serve("wbc run g1", _controller))


def mock_main() -> None:
    """Run the mock robot's node: the executable `mock_robot`."""
    sys.exit(_serve("wbc mock g1", _mock))


def _controller(executor: Any, stop: threading.Event) -> int:
    status: list[int] = []

    def leave(code: int) -> None:
        status.append(code)
        stop.set()

    node = ControllerNode(leave)
    with _logging(node):
        with _spinning(executor, node, leave):
            executor.create_task(node.start)
            stop.wait()
            finished = threading.Event()
            # On the executor, so that the loop never runs without its inputs.
            executor.create_task(node.finish).add_done_callback(lambda task: finished.set())
            finished.wait(_PATIENCE)
        node.finish()
    node.destroy_node()
    return status[0] if status else 0


def _mock(executor: Any, stop: threading.Event) -> int:
    node = Node(MOCK_NAME, allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True)
    own = _declare(node, _MOCK_PARAMETERS)
    transport = Ros2Transport(node)
    status: list[int] = []

    def leave(code: int) -> None:
        status.append(code)
        stop.set()

    with _logging(node), _spinning(executor, node, leave):
        try:
            name = node.get_fully_qualified_name()
            settings, source = settings_from(_values(node), name, sys.argv, own)
            _log.info("the robot of %s, held: let it go with false on %s/hold", source, name)
            run_mock(
                settings,
                transport,
                stop,
                namespace=node.get_namespace(),
                real_time_factor=float(node.get_parameter("real_time_factor").value),
                lockstep=bool(node.get_parameter("lockstep").value),
            )
        except WbcError as error:
            _log.error("%s", error)
            status.append(2)
    transport.close()
    node.destroy_node()
    return status[0] if status else 0


def _declare(node: Any, parameters: dict[str, tuple[Any, str]]) -> tuple[str, ...]:
    """Declare a node's own parameters, where the command line has not done so."""
    for name, (default, description) in (parameters | _FILE_PARAMETERS).items():
        descriptor = ParameterDescriptor(description=description, dynamic_typing=True)
        if node.has_parameter(name):
            node.set_descriptor(name, descriptor)
        else:
            node.declare_parameter(name, default, descriptor)
    return tuple(parameters)


def _values(node: Any) -> dict[str, Any]:
    """The values of a node's parameters by name, without those that have none."""
    parameters = node.get_parameters_by_prefix("").items()
    return {name: parameter.value for name, parameter in parameters if parameter.value is not None}


def _serve(without: str, serve: Callable[[Any, threading.Event], int]) -> int:
    """Set up ROS 2 around a service, and take it down again.

    Args:
        without: what to run where there is no ROS 2.
        serve: the service; it is given an executor, and the event that a signal sets.

    Returns:
        The exit status.
    """
    if _MISSING is not None:
        version = ".".join(map(str, sys.version_info[:2]))
        print(
            f"error: this Python ({version}) finds no ROS 2: {_MISSING}\n"
            f"Source it first (. /opt/ros/jazzy/setup.bash), with the Python it was made for; see docs/ros2.md.\n"
            f"Without ROS 2 the same runs as: {without}",
            file=sys.stderr,
        )
        return 2
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stop.set())
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy has no common base for what a wrong command line or parameter file raises
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        return serve(StreamsFirstExecutor(), stop)
    finally:
        rclpy.try_shutdown()


@contextlib.contextmanager
def _logging(node: Any) -> Iterator[None]:
    """Let this package's log go to a node's."""
    package = logging.getLogger(__package__)
    handler = _RosLog(node.get_logger())
    package.addHandler(handler)
    package.setLevel(logging.INFO)
    package.propagate = False
    try:
        yield
    finally:
        package.removeHandler(handler)


@contextlib.contextmanager
def _spinning(executor: Any, node: Any, leave: Callable[[int], None]) -> Iterator[None]:
    """Spin a node on a thread."""

    def spin() -> None:
        try:
            executor.spin()
        except (ExternalShutdownException, ShutdownException):  # this is how an executor ends
            pass
        except Exception:
            _log.exception("the executor has failed")
            leave(1)

    executor.add_node(node)
    thread = threading.Thread(target=spin, name="executor")
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
