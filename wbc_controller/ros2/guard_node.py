"""The guard as a plain node: the executable `guard`."""

from __future__ import annotations

import threading
from typing import Any

from wbc_controller.ros2.plain_node import serve_plainly
from wbc_controller.service.guard_service import NODE_NAME, run_guard


def serve(executor: Any, stop: threading.Event) -> int:
    """Run the node until the event is set, and return the exit status."""
    return serve_plainly(executor, stop, NODE_NAME, "guarding the robot of {source}", run_guard)
