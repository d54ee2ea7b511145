"""Shapes as visualization_msgs/MarkerArray, for RViz and Foxglove.

Each kind of shape has its own namespace. Markers expire, also after the death of the controller.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Generator, Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.visualization.scene import ARROW, COLORS, LINE_LIST, LINE_STRIP, SPHERE_LIST, Shape, draw
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.middleware.codec import TYPES, header, message, stamp
from wbc_controller.records import References, RobotState, Solution
from wbc_controller.walking.plan import WalkingPlan

WORLD_FRAME = "world"
_KINDS = {ARROW: 0, LINE_STRIP: 4, LINE_LIST: 5, SPHERE_LIST: 7}  # field `type` of a visualization_msgs/Marker


class MarkerScene:
    """Drawing of one state with its references and solution."""

    def __init__(
        self, model: RobotModel, tasks: Mapping[str, Task], contacts: Mapping[str, Contact], lifetime: float
    ) -> None:
        """Create a scene with markers that expire after `lifetime`, s (inf: never)."""
        self._tasks, self._contacts = tasks, contacts
        self._lifetime = _duration(lifetime)
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
        r, g, b, a = COLORS[shape.group]
        size = shape.size
        # Arrows: shaft diameter, head diameter, head length; spheres: three diameters; lines: width.
        x, y, z = {ARROW: (size, 2.0 * size, 2.5 * size), SPHERE_LIST: (size, size, size)}.get(
            shape.kind, (size, 0.0, 0.0)
        )
        return message(
            "visualization_msgs/msg/Marker",
            header=header(time, WORLD_FRAME),
            ns=shape.group,
            id=shape.number,
            type=_KINDS[shape.kind],
            action=0,
            pose=_IDENTITY,
            scale=message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            color=message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a),
            lifetime=self._lifetime,
            frame_locked=False,
            points=[_Point(x, y, z) for x, y, z in shape.points.tolist()],
            colors=[],
            texture_resource="",
            texture=_NO_TEXTURE,
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=_NO_MESH,
            mesh_use_embedded_materials=False,
        )


def read_shapes(content: Any, groups: Collection[str]) -> list[Shape]:
    """Return the shapes of some groups in a visualization_msgs/MarkerArray of this module."""
    kinds = {number: kind for kind, number in _KINDS.items()}
    return [
        Shape(m.ns, m.id, kinds[m.type], m.scale.x, np.array([[p.x, p.y, p.z] for p in m.points]).reshape(-1, 3))
        for m in content.markers
        if m.ns in groups and m.type in kinds
    ]


def _duration(seconds: float) -> Any:
    time = stamp(round(1.0e9 * seconds) if math.isfinite(seconds) else 0)
    return message("builtin_interfaces/msg/Duration", sec=time.sec, nanosec=time.nanosec)


_Point = TYPES.types["geometry_msgs/msg/Point"]
_IDENTITY = message(
    "geometry_msgs/msg/Pose",
    position=message("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
    orientation=message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
)
_NO_TEXTURE = message("sensor_msgs/msg/CompressedImage", header=header(0), format="", data=np.zeros(0, dtype=np.uint8))
_NO_MESH = message("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, dtype=np.uint8))
