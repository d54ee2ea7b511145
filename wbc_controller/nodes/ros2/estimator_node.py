"""The estimator of the base as a plain node: the executable `base_estimator`."""

from __future__ import annotations

import threading
from typing import Any

from wbc_controller.middleware.topics import ESTIMATOR_NODE
from wbc_controller.nodes.estimator_service import run_estimator
from wbc_controller.nodes.ros2.plain_node import serve_plainly


def serve(executor: Any, stop: threading.Event) -> int:
    """Run the node until the event is set, and return the exit status."""
    return serve_plainly(executor, stop, ESTIMATOR_NODE, "estimating the base of the robot of {source}", run_estimator)
