"""The process of a node: signals, the executor's thread, the log.

Four threads: the main one waits for a signal; one spins the executor, for services, timers and parameters; the
transport's reads the topics; and one runs the control loop. The mock robot's physics are on the main one.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from wbc_controller.service.signals import set_by_signals

_log = logging.getLogger(__name__)

#: Time without another look after each callback, s.
_PAUSE = 0.02


class PacedExecutor(SingleThreadedExecutor):  # type: ignore[misc]  # rclpy has no types
    """An executor for what is not urgent: services, timers, parameters, and the clock that rclpy keeps for itself.

    rclpy looks through all that a node has before each callback: half a millisecond, in which the control loop cannot
    run. On a simulator's clock that would be a quarter of a processor.
    """

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Do one callback, then nothing for a moment."""
        super().spin_once(timeout_sec)
        time.sleep(_PAUSE)


def run(serve: Callable[[Any, threading.Event], int]) -> int:
    """Set up ROS 2 around a service, and take it down again.

    Args:
        serve: the service; it is given an executor, and the event that a signal sets.

    Returns:
        The exit status.
    """
    stop = threading.Event()
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy has no common base for what a wrong command line or parameter file raises
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        with set_by_signals(stop):
            return serve(PacedExecutor(), stop)
    finally:
        rclpy.try_shutdown()


@contextlib.contextmanager
def logging_to(node: Any) -> Iterator[None]:
    """Let this package's log go to a node's."""
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
    """Spin a node on a thread."""
    ended = threading.Event()

    def spin() -> None:
        try:
            while not ended.is_set():
                executor.spin_once()
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
        ended.set()
        executor.create_task(lambda: None)  # so that it looks
        thread.join()
        executor.shutdown()  # not before: it takes away what the spinning uses


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
