"""Feasible walking speeds with their limiting quantities."""

from collections.abc import Sequence

import numpy as np

from wbc_controller.controller.build.collision_elements import read_shapes
from wbc_controller.controller.build.footprint import outline
from wbc_controller.controller.build.gait_limits import WAYS, BipedLeg, BipedLimits, QuadrupedLimits
from wbc_controller.controller.build.quadruped_walking import is_quadruped, make_quadruped_gait
from wbc_controller.controller.build.walking import find_feet, make_gait
from wbc_controller.controller.check import Finding
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings

#: Of `WAYS`: names, units, largest speeds of the search, and keys of the settings.
_NAMED = (
    ("forward", "m/s", 2.0, "max_speed"),
    ("sideways", "m/s", 1.0, "max_side_speed"),
    ("turning", "rad/s", 3.0, "max_turn_rate"),
)


def check_walking(settings: Settings, qp: WholeBodyQP) -> list[Finding]:
    """Return the feasible speeds, and for a biped the load of one leg and the smallest distance of the feet.

    `qp` is in the nominal posture with the base upright.
    """
    walking = settings.walking
    if walking is None:
        return []
    if is_quadruped(settings, walking):
        return [_feasible(make_quadruped_gait(settings, walking, qp))]
    found = make_gait(settings, *find_feet(settings, qp.model), qp)
    findings = [_feasible(found)]
    loads = found.single_support()
    for name, load in loads.items():
        if load.share > 1.0:
            findings.append(Finding("warning", f"walking: {name} cannot bear the robot alone; {load.text}"))
    text = ", ".join(f"{name} {100.0 * load.share:.0f} % ({load.text})" for name, load in loads.items())
    findings.append(Finding("single support", f"largest load: {text}"))
    touching = touching_width(settings, qp, found.legs)
    if touching is not None and touching > found.gait.least_width:
        text = (
            f"the shapes of the feet touch at a distance of {touching:.3f} m; larger steps inwards need a larger value"
        )
        findings.append(Finding("warning", f"walking.least_width = {found.gait.least_width:.3f} m: {text}"))
    return findings


def _feasible(found: BipedLimits | QuadrupedLimits) -> Finding:
    speeds, beyond = [], []
    for (name, unit, most, key), way, configured in zip(_NAMED, WAYS, found.gait.speed, strict=True):
        limit = found.feasible(way, most)
        cause = f" ({limit.quantity})" if limit.quantity else ""
        speeds.append(f"{limit.speed:.2f} {unit} {name}{cause}")
        if configured > limit.speed:
            beyond.append(f"walking.{key} = {configured:.2f} {unit} is larger")
    return Finding("walking", "; ".join(["feasible: " + ", ".join(speeds), *beyond]))


def touching_width(settings: Settings, qp: WholeBodyQP, legs: Sequence[BipedLeg]) -> float | None:
    """Return the distance of the soles' centres at which the shapes of the feet touch, m; None without shapes."""
    model, extent = qp.model, 0.0
    try:
        elements = read_shapes(settings, model)
    except ConfigurationError:  # reported by `compare_with_shapes`
        return None
    qp.dynamics.update(model.configuration(model.posture), np.zeros(model.nv))
    for leg in legs:
        joint = model.pinocchio.frames[leg.foot.frame].parentJoint
        body = qp.dynamics.placement(leg.foot.frame) * model.pinocchio.frames[leg.foot.frame].placement.inverse()
        points = [outline(element) for element in elements if element.parentJoint == joint]
        if not points:
            return None
        y = np.vstack(points) @ body.rotation[1] + body.translation[1]
        extent += float((leg.side * (leg.foot.sole(qp.dynamics).place.imag - y)).max())
    return extent
