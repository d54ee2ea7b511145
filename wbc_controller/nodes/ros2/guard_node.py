"""The guard as a plain node: the executable `guard`."""

from __future__ import annotations

import threading
from typing import Any

from wbc_controller.nodes.guard_service import NODE_NAME, run_guard
from wbc_controller.nodes.ros2.plain_node import serve_plainly


def serve(executor: Any, stop: threading.Event) -> int:
    """Run the node until the event is set, and return the exit status."""
    return serve_plainly(executor, stop, NODE_NAME, "guarding the robot of {source}", run_guard)
