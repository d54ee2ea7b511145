"""Takes the messages of raw subscriptions on a separate thread, instead of rclpy's executor."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription

_log = logging.getLogger(__name__)

#: Longest wait before the reader checks whether its context has been shut down, ns.
_LONGEST_WAIT = 200_000_000


class ReaderGroup(MutuallyExclusiveCallbackGroup):  # type: ignore[misc]  # rclpy has no types
    """Excludes the subscriptions of a `Reader` from the executor, which still handles their QoS events."""

    def can_execute(self, entity: Any) -> bool:
        """Whether an executor may wait for an entity."""
        return not isinstance(entity, Subscription) and bool(super().can_execute(entity))


class Reader:
    """Waits for messages, and passes each to its callback, one at a time, on one thread.

    rclpy's executor builds a new wait set of all entities of the node before each callback. With the 150 entities of a
    controller's node that takes longer than the spare time of a control period, and it holds the interpreter lock
    meanwhile. This reader keeps its wait set: a message costs a twentieth of that time.

    Args:
        context: rclpy's context.
    """

    def __init__(self, context: Any) -> None:
        self._context = context
        self._guard = GuardCondition(None, None, context=context)
        self._lock = threading.Lock()
        self._callbacks: dict[Any, Callable[[bytes], None]] = {}
        self._changed = True
        self._closed = False
        self._thread: threading.Thread | None = None

    def add(self, subscription: Any, callback: Callable[[bytes], None]) -> None:
        """Start to read a subscription; the callback must not raise."""
        with self._lock:
            self._callbacks[subscription] = callback
            self._changed = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="reader", daemon=True)
                self._thread.start()
        self._guard.trigger()

    def close(self) -> None:
        """Stop the thread; afterwards no callback runs, except one that called this."""
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
                # Holding the handles keeps them from being destroyed during the wait.
                with contextlib.ExitStack() as held:
                    for entity in (*callbacks, self._guard, self._context):
                        held.enter_context(entity.handle)
                    self._read(callbacks)
        except Exception:
            if self._context.ok():
                _log.exception("reading has failed: no more messages arrive")

    def _read(self, callbacks: dict[Any, Callable[[bytes], None]]) -> None:
        """Read these subscriptions until their list changes or the reader is closed."""
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
