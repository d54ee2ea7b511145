"""Readers of raw subscriptions without rclpy's executor."""

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation

from wbc_controller.errors import TransportError
from wbc_controller.middleware.transports.transport import require_open

_log = logging.getLogger(__name__)

_LONGEST_WAIT = 200_000_000  # ns, then a check for a shutdown


class ReaderGroup(ReentrantCallbackGroup):  # type: ignore[misc]  # rclpy has no types
    """Callback group that excludes the subscriptions of a `Reader` from the executor."""

    def can_execute(self, entity: Any) -> bool:
        """Return False for all entities."""
        return False


class Reader:
    """Thread that passes messages to callbacks, one at a time; its lasting wait set is faster than rclpy's executor."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._guard = GuardCondition(None, None, context=context)
        self._lock = threading.Lock()
        self._callbacks: dict[Any, Callable[[bytes], None]] = {}
        self._changed = True
        self._closed = False
        self._thread: threading.Thread | None = None

    def add(self, subscription: Any, callback: Callable[[bytes], None]) -> None:
        """Add a subscription; the callback must not raise."""
        with self._lock:
            self._callbacks[subscription] = callback
            self._changed = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="reader", daemon=True)
                self._thread.start()
        self._guard.trigger()

    def close(self) -> None:
        """Stop the thread and all other callbacks."""
        with self._lock:
            self._closed = True
            thread = self._thread
        self._guard.trigger()
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        try:
            while not self._closed and self._context.ok():
                with self._lock:
                    callbacks, self._changed = dict(self._callbacks), False
                # Held handles are not destroyed during the wait.
                with contextlib.ExitStack() as held:
                    for entity in (*callbacks, self._guard, self._context):
                        held.enter_context(entity.handle)
                    self._read(callbacks)
        except Exception:
            if self._context.ok():
                _log.exception("the reader thread failed: no more messages will arrive")

    def _read(self, callbacks: dict[Any, Callable[[bytes], None]]) -> None:
        by_pointer = {subscription.handle.pointer: (subscription, call) for subscription, call in callbacks.items()}
        handles = [subscription.handle for subscription in callbacks]
        wait_set = rclpy_implementation.WaitSet(len(handles), 1, 0, 0, 0, 0, self._context.handle)
        while not self._changed and not self._closed and self._context.ok():
            wait_set.clear_entities()
            for handle in handles:
                wait_set.add_subscription(handle)
            wait_set.add_guard_condition(self._guard.handle)
            wait_set.wait(_LONGEST_WAIT)
            for pointer in wait_set.get_ready_entities("subscription"):
                subscription, callback = by_pointer[pointer]
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is not None and not self._closed:
                    callback(taken[0])


class RawStream:
    """Subscription with the newest `depth` messages taken by hand; none arrive after the shutdown of the context."""

    def __init__(self, topic: str, depth: int, subscription: Any, context: Any) -> None:
        self._topic, self._depth = topic, depth
        self._subscription, self._context = subscription, context
        self._guard = GuardCondition(None, None, context=context)
        with context.handle:
            self._wait_set = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, 0, context.handle)
        self._closed = False

    def take(self) -> list[bytes]:
        """See `Stream`."""
        taken: list[bytes] = []
        handle = self._subscription.handle
        with self._translated(), handle:
            while len(taken) < self._depth:
                message = handle.take_message(self._subscription.msg_type, True)
                if message is None:
                    break
                taken.append(message[0])
        return taken

    def wait(self, seconds: float) -> bool:
        """See `Stream`."""
        triggered = None
        handle, guard = self._subscription.handle, self._guard.handle
        # Held handles are not destroyed during the wait.
        with self._translated(), self._context.handle, handle, guard:
            self._wait_set.clear_entities()
            self._wait_set.add_subscription(handle)
            self._wait_set.add_guard_condition(guard)
            self._wait_set.wait(round(1e9 * seconds))
            triggered = any(self._wait_set.get_ready_entities(kind) for kind in ("subscription", "guard_condition"))
        if triggered is None:
            time.sleep(seconds)
        return bool(triggered)

    def wake(self) -> None:
        """See `Stream`."""
        if not self._closed and self._context.ok():
            self._guard.trigger()

    def close(self) -> None:
        """End the present wait; refuse reads."""
        self.wake()
        self._closed = True

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        """Translate rclpy's errors into `TransportError`; ignore them after the shutdown of the context."""
        require_open(self._closed, "read", self._topic)
        try:
            yield
        except Exception as error:  # rclpy's errors have no common base class
            if self._context.ok():
                raise TransportError(f"cannot read {self._topic}: {error}") from error
