"""Collision elements of a URDF."""

import re
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.bare_mechanism import shapes_only
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.resources import PACKAGE_SCHEME, folder_of, share_folder

_MESHES = coal.CachedMeshLoader()  # cache of meshes by file, scale and modification time


def mesh_packages(urdf: str) -> list[str]:
    """Return the packages of mesh files in a URDF."""
    return sorted(set(re.findall(re.escape(PACKAGE_SCHEME) + r"([^/\"']+)/", urdf)))


def read_collision_elements(
    model: RobotModel, urdf: str, key: str, folder: Path | None = None
) -> list[pin.GeometryObject]:
    """Read the collision elements of a URDF, in their joints' frames; `folder` is that of relative mesh paths."""
    shapes = shapes_only(urdf, "collision")
    packages = mesh_packages(shapes)
    folders = [str(share_folder(package).parent) for package in packages] + ([str(folder)] if folder else [])
    try:
        read = pin.buildGeomFromUrdfString(model.pinocchio, shapes, pin.COLLISION, None, folders, _MESHES)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).rpartition("message:")[2].split()).rstrip(".")
        remedy = "correct the file name, or remove the element"
        raise ConfigurationError(f"{key}: a collision element cannot be read: {reason}; {remedy}") from error
    return list(read.geometryObjects)


def read_shapes(settings: Settings, model: RobotModel) -> list[pin.GeometryObject]:
    """Read the collision elements of a robot."""
    return read_collision_elements(model, model.urdf, "collision shapes", folder_of(settings.robot.urdf))


def enclosing_points(element: pin.GeometryObject) -> Array:
    """Return mesh vertices or corners of the bounding box, (n, 3) in m in the joint's frame."""
    geometry = element.geometry
    if isinstance(geometry, coal.BVHModelBase):
        points = np.array(geometry.vertices())
    else:
        geometry.computeLocalAABB()
        low, high = np.array(geometry.aabb_local.min_), np.array(geometry.aabb_local.max_)
        corners = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T
        points = low + corners * (high - low)
    return np.asarray(points @ element.placement.rotation.T + element.placement.translation)
