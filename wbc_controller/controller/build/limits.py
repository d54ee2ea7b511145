"""Construction of torque-speed curve and self-collision limit."""

import logging

from wbc_controller.controller.build.collision_model import build_collision_model
from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.limits import SelfCollisionLimit, TorqueSpeedCurve
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF
from wbc_controller.records import frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.resources import folder_of, locate, read_text

_log = logging.getLogger(__name__)


def make_torque_speed(settings: Settings, model: RobotModel) -> TorqueSpeedCurve | None:
    """Build the torque-speed curve of the motors; None if it is disabled."""
    curve = settings.limits.torque_speed
    if not curve.enabled:
        return None
    require_known(curve.actuators, model.actuators, "limits.torque_speed.actuators: unknown actuator")
    limits = dict(zip(model.joints, model.velocity_limits.tolist(), strict=True))
    corner, no_load = [], []
    for name in model.actuators:
        own = curve.actuators.get(name)
        if own is None and name in settings.robot.transmission:
            reason = "requires corner and no_load, as the URDF has no velocity limit for it"
            raise ConfigurationError(f"limits.torque_speed.actuators: {name!r} of robot.transmission {reason}")
        corner.append(own.corner if own is not None else curve.corner * limits[name])
        no_load.append(own.no_load if own is not None else curve.no_load * limits[name])
    return TorqueSpeedCurve(frozen(corner), frozen(no_load))


def make_self_collision(settings: Settings, model: RobotModel) -> SelfCollisionLimit:
    """Build the self-collision limit, and log the excluded pairs of links."""
    own, key = settings.limits.self_collision, "limits.self_collision.srdf"
    srdf = read_text(locate(own.srdf, key), f"{key} = {own.srdf!r}", LARGEST_URDF) if own.srdf else None
    collision = build_collision_model(
        model, margin=own.margin, srdf=srdf, pairs=own.pairs, visual=own.visual, folder=folder_of(settings.robot.urdf)
    )
    _log.info("self-collision: %s", collision.summary)
    values = own.model_dump(include={"margin", "acceleration", "horizon", "max_pairs"})
    return SelfCollisionLimit(model, collision.geometry, summary=collision.summary, **values)
