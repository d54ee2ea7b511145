"""The process of a node: the main thread waits for a signal, or runs the mock robot (threads: docs/architecture.md)."""

import contextlib
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.waitable import NumberOfEntities, Waitable

from wbc_controller.middleware.transports.ros2 import Ros2Transport
from wbc_controller.nodes.signals import set_by_signals

_log = logging.getLogger(__name__)

_PAUSE = 0.02  # between two waits, s


class Pacer(Waitable):  # type: ignore[misc]  # rclpy has no types
    """Pause of a node's executor: before each wait, rclpy blocks the control loop for half a millisecond."""

    def __init__(self) -> None:
        super().__init__(ReentrantCallbackGroup())
        self._resume = time.monotonic()

    def __enter__(self) -> None:
        """Do nothing: there are no entities to keep. From rclpy 9 (Kilted) the base class raises."""

    def __exit__(self, *error: object) -> None:
        """Do nothing."""

    def get_num_entities(self) -> NumberOfEntities:
        """Return no entities to wait for."""
        return NumberOfEntities()

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Sleep for the rest of the pause; rclpy calls this before each wait."""
        time.sleep(max(0.0, self._resume - time.monotonic()))

    def is_ready(self, wait_set: Any) -> bool:
        """Begin the pause and return False; rclpy calls this after each wait."""
        self._resume = time.monotonic() + _PAUSE
        return False


def run(serve: Callable[[Any, threading.Event, Callable[[int], None]], None]) -> int:
    """Run a service with an executor, a stop event set by signals, and a function to fail; return the exit status."""
    stop = threading.Event()
    status: list[int] = []

    def leave(code: int) -> None:
        status.append(code)
        stop.set()

    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy's errors on invalid arguments have no common base class
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        with set_by_signals(stop):
            serve(SingleThreadedExecutor(), stop, leave)
    finally:
        rclpy.try_shutdown()
    return status[0] if status else 0


@contextlib.contextmanager
def logging_to(node: Any) -> Iterator[None]:
    """Forward this package's log to a node's log."""
    package = logging.getLogger("wbc_controller")
    handler = _RosLog(node.get_logger())
    package.addHandler(handler)
    package.setLevel(logging.INFO)
    package.propagate = False
    try:
        yield
    finally:
        package.removeHandler(handler)


@contextlib.contextmanager
def spinning(executor: Any, node: Any, leave: Callable[[int], None]) -> Iterator[None]:
    """Spin a node on a separate thread, with a pause after each wait."""
    ended = threading.Event()

    def spin() -> None:
        try:
            while not ended.is_set():
                executor.spin_once()
        except (ExternalShutdownException, ShutdownException):  # the regular end of an executor
            pass
        except Exception:
            _log.exception("the executor failed")
            leave(1)

    node.add_waitable(Pacer())
    executor.add_node(node)
    thread = threading.Thread(target=spin, name="executor")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        executor.create_task(lambda: None)  # wakes the executor
        thread.join()
        executor.shutdown()  # after the end of the spinning thread


@contextlib.contextmanager
def node_without_services(name: str, domain: int) -> Iterator[Ros2Transport]:
    """Open a transport on a node with its own context and without an executor."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node(name, context=context)
    transport = Ros2Transport(node)
    try:
        yield transport
    finally:
        transport.close()
        node.destroy_node()
        context.try_shutdown()


class _RosLog(logging.Handler):
    def __init__(self, logger: Any) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # One call per severity: rclpy refuses a call site with a changed severity.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)
