"""The nominal posture: an SRDF's if the robot stands in it, otherwise a computed one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.foot_shape import Foot
from wbc_controller.apps.new.mechanism import pose_of, usable_ranges
from wbc_controller.apps.new.notes import Draft
from wbc_controller.apps.new.standing_posture import Legs, Stand
from wbc_controller.controller.check.preflight import support_margin
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Largest height difference of the feet, m, and tilt of soles, as a sine, and smallest distance of the centre of mass
#: from the edge of the support, m, of a posture that is taken as it is.
_LEVEL, _INSIDE = 0.008, 0.01
#: Distance that an SRDF's posture keeps from the limits, rad: above the default of ``limits.position_margin``.
_KEPT = 0.03
#: Smallest distance from a joint's limits, as a share of its range, and rad at most: an arm's, in a computed posture.
_MARGIN, _LARGEST_MARGIN = 0.1, 0.2
#: Difference between an SRDF's position and a joint's that is said, rad.
_NOTICED = 1.0e-3
#: Postures of an arm that are tried, and how far each joint may be from the middle of its range, rad.
_TRIED, _SPREAD = 400, 1.0

#: Postures of an SRDF, joint positions in rad by name.
Postures = Mapping[str, Mapping[str, float]]


def reference(model: RobotModel, postures: Postures) -> tuple[str, Array]:
    """The first posture of an SRDF, its name and joint positions, (nj,); without one: no name, and zeros.

    All positions are off the limits by what the controller keeps from them.
    """
    name = next(iter(postures), "")
    lower, upper = model.position_lower, model.position_upper
    kept = np.minimum(_KEPT, 0.1 * (upper - lower))
    return name, pose_of(model.joints, lower + kept, upper - kept, postures.get(name, {}))


def put_standing(model: RobotModel, feet: Sequence[Foot], postures: Postures, draft: Draft) -> Array:
    """Write the posture of a robot that stands on its feet, and return it, (nj,) in rad."""
    name, wanted = reference(model, postures)
    if not name:
        wanted = _off_limits(model, wanted)
    legs = Legs(model, feet, wanted, known=bool(name))
    why = _wrong(feet, legs.stand(wanted)) if name else ""
    if name and not why:
        _put(draft, model, wanted, f"The SRDF's posture {name!r}: the feet are level, the centre of mass above them.")
        _note_moved(draft, model, wanted, postures[name])
        return wanted
    # Where no posture is as high as the SRDF's, with its feet as far apart, one with legs bent as usual may be.
    searches = [legs, Legs(model, feet, wanted, known=False)] if name else [legs]
    stands = (posture for search in searches if (posture := search.solve()) is not None)
    found = next((posture for posture in stands if not _wrong(feet, legs.stand(posture))), None)
    if found is None:
        _put(draft, model, wanted, "the posture: none was found in which the feet are level and the centre of mass is "
             "above them, so that these are " + (f"the SRDF's {name!r}." if name else "zeros."), "missing")  # fmt: skip
        return wanted
    _put(
        draft,
        model,
        found,
        f"The nearest one to the SRDF's {name!r}, in which {why}." if name else
        "Computed: feet level, centre of mass above their middle, legs bent, joints off their limits. Whether links "
        "touch each other in it was not looked at.",
        "guess",
    )  # fmt: skip
    return found


def put_fixed(model: RobotModel, postures: Postures, draft: Draft) -> Array:
    """Write the posture of a robot that is bolted to the ground, and return it, (nj,) in rad."""
    name, wanted = reference(model, postures)
    if name:
        _put(draft, model, wanted, f"The SRDF's posture {name!r}.")
        _note_moved(draft, model, wanted, postures[name])
        return wanted
    found = _dexterous(model)
    _put(
        draft,
        model,
        found,
        "Computed: the ends move in all directions with joints near the middle of their ranges. Whether links touch "
        "each other or the table was not looked at.",
        "guess",
    )
    return found


def _note_moved(draft: Draft, model: RobotModel, posture: Array, given: Mapping[str, float]) -> None:
    """Note the joints that differ from the SRDF."""
    moved = [
        name for name, value in zip(model.joints, posture, strict=True)
        if abs(value - given.get(name, 0.0)) > _NOTICED
    ]  # fmt: skip
    if moved:
        draft.note("robot.posture", f"Moved off their limits: {', '.join(moved)}.", "guess")


def _put(draft: Draft, model: RobotModel, posture: Array, text: str, origin: str = "found") -> None:
    rounded = np.clip(np.round(posture, 4), model.position_lower, model.position_upper)
    draft.put("robot.posture", [float(value) for value in rounded + 0.0], text, origin)  # type: ignore[arg-type]


def _wrong(feet: Sequence[Foot], stand: Stand) -> str:
    """Return the reason why the robot cannot stand in a posture; empty if it can."""
    if not (stand.unlevel <= _LEVEL):
        return f"the feet are not level, by {1e3 * stand.unlevel:.0f} mm or mrad"
    points = np.vstack(
        [
            middle[:2] + (foot.corners if len(foot.corners) else np.zeros((1, 2)))
            for foot, middle in zip(feet, stand.middles, strict=True)
        ]
    )
    margin = support_margin(points, stand.com[:2])
    if not (margin >= _INSIDE):
        side = "inside" if margin >= 0.0 else "outside"
        return f"the centre of mass is {1e3 * abs(margin):.0f} mm {side} the edge of the support"
    return ""


def _off_limits(model: RobotModel, posture: Array) -> Array:
    lower, upper = usable_ranges(model)
    margin = np.minimum(_MARGIN * (upper - lower), _LARGEST_MARGIN)
    return np.clip(posture, lower + margin, upper - margin)


def _dexterous(model: RobotModel) -> Array:
    """Return a posture of arms whose ends move well in all directions, (nj,) in rad, off the limits."""
    pinocchio, data = model.pinocchio, model.pinocchio.createData()
    ends = [j for j in range(1, pinocchio.njoints) if not list(pinocchio.children[j])]
    lower, upper = usable_ranges(model)
    middle = _off_limits(model, 0.5 * (lower + upper))
    spread = np.minimum(_SPREAD, 0.35 * (upper - lower))
    rng = np.random.default_rng(0)  # the same posture each time

    def worth(posture: Array) -> float:
        q = model.configuration(posture)
        gravity = np.abs(model.joint_forces(pin.computeGeneralizedGravity(pinocchio, data, q))) / model.effort_limits
        pin.computeJointJacobians(pinocchio, data, q)
        ease = 0.0
        for end in ends:
            jacobian = pin.getJointJacobian(pinocchio, data, end, pin.LOCAL_WORLD_ALIGNED)
            values = np.linalg.svd(jacobian[:, np.any(jacobian, axis=0)], compute_uv=False)
            ease += float(np.log(max(values[-1] / values[0], 1.0e-6))) / len(ends)
        low = min((float(data.oMi[end].translation[2]) for end in ends), default=0.0)
        away = float((((posture - middle) / spread) ** 2).mean())
        return ease - away - 4.0 * float(gravity.max()) - (10.0 if low < 0.0 else 0.0)

    tried = [middle, *(middle + spread * rng.uniform(-1.0, 1.0, (_TRIED, model.nj)))]
    return max(tried, key=worth)
