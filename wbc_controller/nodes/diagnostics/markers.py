"""Shapes as visualization_msgs/MarkerArray, for RViz and Foxglove.

Each kind of shape has its own namespace. Markers expire, also after the death of the controller.
"""

import copy
import math
from collections.abc import Collection, Generator, Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.visualization.scene import ARROW, COLORS, LINE_LIST, LINE_STRIP, SPHERE_LIST, Shape, draw
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.middleware.codec import TYPES, header, message, time_fields
from wbc_controller.records import References, RobotState, Solution
from wbc_controller.walking.plan import WalkingPlan

WORLD_FRAME = "world"
_KINDS = {ARROW: 0, LINE_STRIP: 4, LINE_LIST: 5, SPHERE_LIST: 7}  # field `type` of a visualization_msgs/Marker
_Point = TYPES.types["geometry_msgs/msg/Point"]


class MarkerScene:
    """Drawing of one state with its references and solution; the markers expire after `lifetime`, s (inf: never)."""

    def __init__(
        self, model: RobotModel, tasks: Mapping[str, Task], contacts: Mapping[str, Contact], lifetime: float
    ) -> None:
        self._tasks, self._contacts = tasks, contacts
        lasting = time_fields(round(1.0e9 * lifetime) if math.isfinite(lifetime) else 0)
        self._template = message("visualization_msgs/msg/Marker", lifetime=lasting)
        # The controller's dynamics belong to its last solution.
        self._dynamics = Dynamics(model)

    def compose(
        self,
        state: RobotState,
        references: References | None,
        solution: Solution | None,
        plan: WalkingPlan | None = None,
    ) -> Generator[None, None, Any]:
        """Compose and return the message of a cycle; yield after each piece."""
        self._dynamics.update(state.q, state.v)
        yield
        forces = solution.forces if solution is not None else {}
        markers = []
        for shape in draw(self._dynamics, self._tasks, self._contacts, references, forces, plan):
            markers.append(self._marker(state.stamp, shape))
            yield
        return message("visualization_msgs/msg/MarkerArray", markers=markers)

    def _marker(self, time: int, shape: Shape) -> Any:
        size = shape.size
        # Arrows: shaft diameter, head diameter, head length; spheres: three diameters; lines: width.
        scales = {ARROW: (size, 2.0 * size, 2.5 * size), SPHERE_LIST: (size, size, size)}
        marker = copy.copy(self._template)
        marker.header, marker.type = header(time, WORLD_FRAME), _KINDS[shape.kind]
        marker.ns, marker.id = shape.group, shape.number
        marker.scale = TYPES.types["geometry_msgs/msg/Vector3"](*scales.get(shape.kind, (size, 0.0, 0.0)))
        marker.color = TYPES.types["std_msgs/msg/ColorRGBA"](*COLORS[shape.group])
        marker.points = [_Point(*point) for point in shape.points.tolist()]
        return marker


def read_shapes(content: Any, groups: Collection[str]) -> list[Shape]:
    """Return the shapes of some groups in a visualization_msgs/MarkerArray of this module."""
    kinds = {number: kind for kind, number in _KINDS.items()}
    return [
        Shape(m.ns, m.id, kinds[m.type], m.scale.x, np.array([[p.x, p.y, p.z] for p in m.points]).reshape(-1, 3))
        for m in content.markers
        if m.ns in groups and m.type in kinds
    ]
