"""The mock robot as a plain node: the executable `mock_robot`."""

from __future__ import annotations

import threading
from typing import Any

from wbc_controller.nodes.ros2.plain_node import serve_plainly
from wbc_controller.simulation.mock_robot import NODE_NAME
from wbc_controller.simulation.mock_service import run_mock

_PARAMETERS: dict[str, tuple[Any, str]] = {
    "real_time_factor": (1.0, "Simulated seconds per second."),
    "lockstep": (False, "Wait for the controller's answer to each state."),
    "patient": (False, "Let simulated time wait for a controller that is late and uses use_sim_time."),
}


def serve(executor: Any, stop: threading.Event) -> int:
    """Run the node until the event is set, and return the exit status."""
    begins = "the robot of {source}, held: let it go with false on {node}/hold"
    return serve_plainly(executor, stop, NODE_NAME, begins, run_mock, _PARAMETERS)
