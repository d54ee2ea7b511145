"""The managed lifecycle node `wbc_controller`."""

import contextlib
import logging
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.task import Future
from std_srvs.srv import Trigger

from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, InputRefused, WbcError
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import endpoints
from wbc_controller.middleware.transports.ros2 import Ros2Transport
from wbc_controller.nodes.controller_service import URDF_TOPIC, make_clock, make_loop
from wbc_controller.nodes.loop import ControlLoop
from wbc_controller.nodes.realtime import apply_realtime
from wbc_controller.nodes.ros2.command_outcomes import RECORD, SERVICES, CommandOutcomes
from wbc_controller.nodes.ros2.lifecycle_gate import LifecycleGate
from wbc_controller.nodes.ros2.node_parameters import FROM_OVERRIDES, LiveParameters, declare, values
from wbc_controller.nodes.ros2.parameters import own_values, settings_from
from wbc_controller.nodes.ros2.process import logging_to, spinning
from wbc_controller.nodes.urdf import decode_urdf
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.recording.recorder import NOT_RECORDED, Recorder, recording, recording_folder
from wbc_controller.records import Mode
from wbc_controller.settings import NODE_NAME
from wbc_controller.settings.config import Config

_log = logging.getLogger(__name__)

_REMINDER = 5.0  # of a missing URDF, s
_TIMEOUT = 5.0  # of the shutdown on a possibly failed executor, s
_NOT_ACTIVE = "the node is not active; check its state with ros2 lifecycle get"
_PARAMETERS: dict[str, tuple[Any, str]] = {
    "autostart": (True, "Configure and activate the node at start-up; the process ends on a failure."),
    "activate": (False, "Activate the controller without a command when its inputs are fresh."),
}


class ControllerNode(LifecycleNode):  # type: ignore[misc]  # rclpy has no types
    """The controller as a managed node (docs/ros2.md). `leave` receives the status of a failed autostart."""

    def __init__(
        self,
        leave: Callable[[int], None] = lambda status: None,
        arguments: list[str] | None = None,
        context: Any = None,
        **options: Any,
    ) -> None:
        super().__init__(NODE_NAME, context=context, **FROM_OVERRIDES, **options)
        self._leave = leave
        self._arguments = arguments if arguments is not None else sys.argv
        self._own = declare(self, _PARAMETERS)
        self._live = LiveParameters(self, self._own)
        self._gate: LifecycleGate | None = None
        self._loop: ControlLoop | None = None
        self._recorder: Recorder | None = None
        self._opened = contextlib.ExitStack()  # of gate and recorder
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._failed = False
        self._outcomes = CommandOutcomes()
        self._urdf: str | None = None
        self._urdf_transport: Any = None
        self._starting = False
        self._finalized = False
        group = ReentrantCallbackGroup()
        for name, (word, _) in SERVICES.items():
            self.create_service(Trigger, f"~/{name}", partial(self._on_trigger, word), callback_group=group)
        self.create_service(Trigger, f"~/{RECORD}", self._on_record, callback_group=group)

    def start(self) -> None:
        """Configure and activate on the executor's thread, if the parameter `autostart` is true."""
        try:
            autostart = self._value("autostart")
        except ConfigurationError as error:
            _log.error("cannot start: %s", error)
            self._leave(2)
            return
        if not autostart:
            return
        self._starting = self.trigger_configure() != TransitionCallbackReturn.SUCCESS
        if self._starting and self._urdf_transport is not None:
            return  # it starts when the URDF arrives
        if self._starting or self.trigger_activate() != TransitionCallbackReturn.SUCCESS:
            self._leave(2)

    def finish(self) -> None:
        """Shut down once from any state, on the executor's thread or after its end."""
        if not self._finalized:
            self.trigger_shutdown()

    def on_configure(self, state: Any) -> Any:
        """Read and check the parameters; build the model, the topics and the loop."""
        return self._attempt("configure", self._configure, "inactive")

    def on_activate(self, state: Any) -> Any:
        """Start the loop."""
        return self._attempt("activate", self._activate, "active")

    def on_deactivate(self, state: Any) -> Any:
        """End the loop, with zero torques."""
        return self._attempt("deactivate", self._deactivate, "inactive")

    def on_cleanup(self, state: Any) -> Any:
        """Close the topics and delete the model."""
        return self._attempt("clean up", self._clean_up, "unconfigured")

    def on_shutdown(self, state: Any) -> Any:
        """End the loop, with zero torques, and close the topics."""
        self._finalized = True
        return self._attempt("shut down", self._clean_up, "finalized")

    def on_error(self, state: Any) -> Any:
        """Close everything and return to unconfigured."""
        _log.error("error processing: topics and loop are closed, the node is unconfigured; configure it again")
        return self._attempt("process the error", self._clean_up, "unconfigured")

    def _value(self, name: str) -> Any:
        return own_values(values(self), {name: _PARAMETERS[name][0]}, self.get_fully_qualified_name())[name]

    def _attempt(self, what: str, transition: Callable[[], None], state: str) -> Any:
        try:
            transition()
        except WbcError as error:
            _log.error("cannot %s: %s", what, error)
            return TransitionCallbackReturn.FAILURE
        except Exception:
            _log.exception("cannot %s", what)
            return TransitionCallbackReturn.ERROR
        _log.info("lifecycle transition: %s; the node is %s", what, state)
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        node, namespace, full_name = self.get_name(), self.get_namespace(), self.get_fully_qualified_name()
        settings, source = settings_from(values(self), full_name, self._arguments, self._own)
        if not settings.robot.urdf and self._urdf is None:
            self._await_urdf()
            raise ConfigurationError("robot.urdf is empty, and no URDF was received on robot_description yet")
        try:
            with contextlib.ExitStack() as opened:
                recorder = opened.enter_context(recording(settings, name=node))  # before `apply_realtime`
                transport = Ros2Transport(self)
                gate = opened.enter_context(contextlib.closing(LifecycleGate(transport)))
                urdf = None if settings.robot.urdf else self._urdf
                controller = Controller(Config(settings, "", urdf), preflight=False)
                apply_realtime(settings.control.realtime)
                topics = controller_endpoints(settings, controller.model, node=node, namespace=namespace)
                use_sim_time = bool(self.get_parameter("use_sim_time").value)
                clock = make_clock(settings, topics, transport, use_sim_time=use_sim_time)
                observe = (self._outcomes.observe,)
                loop = make_loop(controller, gate, clock, topics, observers=observe, recorder=recorder, node=full_name)
                self._live.declare_settings(controller.live)
                self._opened = opened.pop_all()
        except ConfigurationError as error:
            raise ConfigurationError(f"{source}: {error}") from error
        self._gate, self._loop, self._recorder = gate, loop, recorder
        _log.info("configured from %s: %d joints, %.0f Hz", source, controller.model.nj, settings.control.rate)

    def _await_urdf(self) -> None:
        if self._urdf_transport is not None:
            return
        (endpoint,) = endpoints(URDF_TOPIC, self.get_name(), namespace=self.get_namespace())
        limit = LogLimit()

        def receive(payload: bytes) -> None:
            try:
                self._urdf = decode_urdf(payload, endpoint)
            except InputRefused as refusal:
                if limit.passes(endpoint.name):
                    _log.warning("refused %s: %s", endpoint.name, refusal)
                return
            if self._starting and self.executor is not None:
                self.executor.create_task(self.start)

        def remind() -> None:
            if self._urdf is None:
                _log.warning("robot.urdf is empty: still waiting for the URDF on %s", endpoint.name)

        self._urdf_transport = Ros2Transport(self)
        self._urdf_transport.subscribe(endpoint, receive)
        self.create_timer(_REMINDER, remind)

    def _activate(self) -> None:
        if self._loop is None or self._gate is None:
            raise ConfigurationError("the node is not configured")
        controller = self._loop.controller
        if controller.mode is Mode.STOPPED and controller.fault is None:
            controller.supervisor.request("reset", 0.0, None)  # a fault stays latched
        run = partial(self._run, self._loop, self._value("activate"))
        self._stop = threading.Event()
        self._failed = False
        self._thread = threading.Thread(target=run, name="control loop")
        self._gate.open = True
        self._thread.start()
        _log.info("waiting for 'activate' on %s/command", self.get_fully_qualified_name())

    def _run(self, loop: ControlLoop, activate: bool) -> None:
        try:
            loop.run(self._stop, activate=activate)
        except Exception:
            _log.exception("the control loop has failed")
            self._failed = True
            executor = self.executor
            if executor is not None:
                executor.create_task(self._after_failure)
        finally:
            self._outcomes.end("the control loop has ended")

    def _after_failure(self) -> None:
        if self._gate is not None and self._gate.open:
            self.trigger_deactivate()

    def _deactivate(self) -> None:
        self._stop.set()
        if self._thread is not None and self._loop is not None:
            self._loop.wake()  # without joint states it waits until they are stale
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
        self._opened.close()
        self._live.undeclare_settings()
        self._gate, self._loop, self._recorder = None, None, None

    async def _on_trigger(self, word: str, request: Any, response: Any) -> Any:
        gate = self._gate
        if gate is None or not gate.open:
            return _set_response(response, False, _NOT_ACTIVE)
        future = Future(executor=self.executor)
        future.add_done_callback(lambda done: None)  # a done callback wakes the executor
        self._outcomes.submit(word, lambda: gate.command(word), lambda *answer: future.set_result(answer))
        return _set_response(response, *await future)

    def _on_record(self, request: Any, response: Any) -> Any:
        gate, recorder = self._gate, self._recorder
        if recorder is None and gate is not None:
            return _set_response(response, False, NOT_RECORDED)
        if recorder is None or gate is None or not gate.open or self._loop is None:
            return _set_response(response, False, _NOT_ACTIVE)
        recorder.request()
        folder = recording_folder(self._loop.controller.config.settings)
        return _set_response(response, True, f"the last seconds are written to {folder}")


def _set_response(response: Any, success: bool, text: str) -> Any:
    response.success, response.message = success, text
    return response


def serve(executor: Any, stop: threading.Event, leave: Callable[[int], None]) -> None:
    """Run the node until the event is set."""
    node = ControllerNode(leave)
    with logging_to(node):
        with spinning(executor, node, leave):
            executor.create_task(node.start)
            stop.wait()
            finished = threading.Event()
            # On the executor, so that the loop has its inputs until its end.
            executor.create_task(node.finish).add_done_callback(lambda task: finished.set())
            finished.wait(_TIMEOUT)
        node.finish()
    node.destroy_node()
