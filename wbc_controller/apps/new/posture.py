"""Nominal posture: the SRDF's if possible, otherwise a computed one."""

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.foot_shape import Foot
from wbc_controller.apps.new.mechanism import usable_ranges
from wbc_controller.apps.new.notes import Draft, Origin
from wbc_controller.apps.new.standing_posture import FeetPlacement, Legs
from wbc_controller.controller.check.preflight import support_margin
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Limits of an acceptable posture: height difference of the feet, m, or tilt of soles, as a sine; distance of the
#: centre of mass from the support's edge, m.
_LEVEL, _INSIDE = 0.008, 0.01
_SRDF_MARGIN = 0.03  # from the limits, rad; above the default of ``limits.position_margin``
#: Distance of a computed posture from the limits: share of the range, and maximum, rad.
_MARGIN, _LARGEST_MARGIN = 0.1, 0.2
_NOTED_CHANGE = 1.0e-3  # smallest noted change, rad
_SAMPLES, _SPREAD = 400, 1.0  # number of sampled arm postures, and largest distance from the middle of a range, rad

Posture = Mapping[str, float]  # joint positions of an SRDF in rad by name
Postures = Mapping[str, Posture]


def srdf_posture(model: RobotModel, postures: Postures) -> tuple[str, Array]:
    """Return name and joint positions, (nj,), of the first SRDF posture, or no name and zeros, off the limits."""
    name = next(iter(postures), "")
    lower, upper = model.position_lower, model.position_upper
    limit_margin = np.minimum(_SRDF_MARGIN, 0.1 * (upper - lower))
    values = [postures.get(name, {}).get(joint, 0.0) for joint in model.joints]
    return name, np.clip(values, lower + limit_margin, upper - limit_margin)


def put_standing(model: RobotModel, feet: Sequence[Foot], postures: Postures, draft: Draft) -> Array:
    """Write the posture of a standing robot; return it, (nj,) in rad."""
    name, reference = srdf_posture(model, postures)
    if not name:
        reference = np.clip(reference, *usable_ranges(model, _MARGIN, _LARGEST_MARGIN))
    legs = Legs(model, feet, reference, keep_feet=bool(name))
    why = _standing_fault(feet, legs.place_feet(reference)) if name else ""
    if name and not why:
        text = f"Posture {name!r} of the SRDF: level feet, centre of mass above them."
        _put(draft, model, reference, text, srdf=postures[name])
        return reference
    searches = [legs, Legs(model, feet, reference, keep_feet=False)] if name else [legs]
    stands = (posture for search in searches if (posture := search.solve()) is not None)
    found = next((posture for posture in stands if not _standing_fault(feet, legs.place_feet(posture))), None)
    if found is None:
        _put(draft, model, reference, "posture: none found with level feet and the centre of mass above them; these "
             "values are " + (f"the SRDF's {name!r}." if name else "zeros."), "missing")  # fmt: skip
        return reference
    text = "Computed: level feet, centre of mass above their middle, bent legs, joints off their limits. "
    text += "Self-collision was not checked."
    if name:
        text = f"Nearest valid posture to {name!r} of the SRDF, in which {why}."
    _put(draft, model, found, text, "guess")
    return found


def put_fixed(model: RobotModel, postures: Postures, draft: Draft) -> Array:
    """Write the posture on a fixed base; return it, (nj,) in rad."""
    name, reference = srdf_posture(model, postures)
    if name:
        _put(draft, model, reference, f"Posture {name!r} of the SRDF.", srdf=postures[name])
        return reference
    found = _dexterous(model)
    text = "Computed: high manipulability of the ends, joints near the middle of their ranges. Collisions with the "
    _put(draft, model, found, f"{text}robot or the table were not checked.", "guess")
    return found


def _put(
    draft: Draft, model: RobotModel, posture: Array, text: str, origin: Origin = "found", srdf: Posture | None = None
) -> None:
    """Write a posture, and note the joints that differ from that of the SRDF."""
    rounded = np.clip(np.round(posture, 4), model.position_lower, model.position_upper)
    draft.put("robot.posture", (rounded + 0.0).tolist(), text, origin)
    changes = zip(model.joints, posture - [srdf.get(name, 0.0) for name in model.joints], strict=True) if srdf else ()
    moved = [name for name, change in changes if abs(change) > _NOTED_CHANGE]
    if moved:
        draft.note("robot.posture", f"Moved off their limits: {', '.join(moved)}.", "guess")


def _standing_fault(feet: Sequence[Foot], placement: FeetPlacement) -> str:
    if not (placement.level_error <= _LEVEL):
        return f"the feet are {1e3 * placement.level_error:.0f} mm or mrad off level"
    shapes = [foot.corners if len(foot.corners) else np.zeros((1, 2)) for foot in feet]
    points = np.vstack([middle[:2] + shape for middle, shape in zip(placement.middles, shapes, strict=True)])
    margin = support_margin(points, placement.com[:2])
    if not (margin >= _INSIDE):
        side = "inside" if margin >= 0.0 else "outside"
        return f"the centre of mass is {1e3 * abs(margin):.0f} mm {side} the edge of the support"
    return ""


def _dexterous(model: RobotModel) -> Array:
    """Return a posture with high manipulability, (nj,) in rad, off the limits."""
    pinocchio, data = model.pinocchio, model.pinocchio.createData()
    ends = [j for j in range(1, pinocchio.njoints) if not list(pinocchio.children[j])]
    lower, upper = usable_ranges(model, 0.0, 0.0)
    middle = 0.5 * (lower + upper)
    spread = np.clip(0.35 * (upper - lower), 1.0e-9, _SPREAD)
    rng = np.random.default_rng(0)

    def score(posture: Array) -> float:
        q = model.configuration(posture)
        gravity = np.abs(model.joint_forces(pin.computeGeneralizedGravity(pinocchio, data, q))) / model.effort_limits
        pin.computeJointJacobians(pinocchio, data, q)
        ease = 0.0
        for end in ends:
            jacobian = pin.getJointJacobian(pinocchio, data, end, pin.LOCAL_WORLD_ALIGNED)
            values = np.linalg.svd(jacobian[:, np.any(jacobian, axis=0)], compute_uv=False)
            ease += float(np.log(max(values[-1] / values[0], 1.0e-6))) / len(ends)
        low = min((float(data.oMi[end].translation[2]) for end in ends), default=0.0)
        deviation = float((((posture - middle) / spread) ** 2).mean())
        return ease - deviation - 4.0 * float(gravity.max()) - (10.0 if low < 0.0 else 0.0)

    tried = [middle, *(middle + spread * rng.uniform(-1.0, 1.0, (_SAMPLES, model.nj)))]
    return max(tried, key=score)
