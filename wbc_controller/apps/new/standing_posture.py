"""Search for a standing posture: feet level, centre of mass above their middle, legs bent, joints off limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from wbc_controller.apps.new.foot_shape import Foot
from wbc_controller.apps.new.mechanism import usable_ranges
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Length of a leg in the posture, as a share of the longest at which the feet are level: a flat foot's and another's.
_BENT, _BENT_POINT = 0.94, 0.85
#: Distance from the limits, as a share of a joint's range and at most, rad.
_MARGIN, _LARGEST_MARGIN = 0.08, 0.15
#: Starts of the search, and how far they are from the reference, rad.
_STARTS, _SPREAD = 8, 0.8
#: Largest error of what has to hold in a posture that was found: m, or rad.
_TOLERANCE = 1.0e-3
#: Weights of the centre of mass away from the feet's middle and of a foot away from below its hip, both relative to
#: the robot's size, and of a sole or axle that tilts, and of a sole that turns away.
_CENTRE, _UNDER_HIP, _TILT, _YAW = 3000.0, 30.0, 3000.0, 5.0
#: Largest difference between a left and a right leg that mirror each other: of directions, and of places, m.
_MIRROR = 0.02
#: Cosine of the largest angle between a joint axis that bends the leg and the lateral one, 45°.
_LATERAL = 0.7


@dataclass(frozen=True, slots=True)
class _Leg:
    """A foot with the joints that move only it: their numbers in Pinocchio's model, and their places in `joints`."""

    foot: Foot
    joints: tuple[int, ...]
    columns: np.ndarray


@dataclass(frozen=True, slots=True)
class Stand:
    """Placement of the feet in a posture, the base upright at the origin."""

    bottoms: Array  # height of the lowest point of each foot, (n,) in m
    middles: Array  # positions of the feet, (n, 3) in m
    tilts: Array  # tilts of soles and axles, as sines, (m,)
    yaw: Array  # yaw angles of soles, as sines, (k,)
    com: Array  # centre of mass, (3,) in m

    @property
    def unlevel(self) -> float:
        """The largest difference of heights, m, or tilt, as a sine."""
        return float(max(np.ptp(self.bottoms), np.abs(self.tilts).max(initial=0.0)))


class Legs:
    """The legs of a robot, and the posture that they take."""

    def __init__(self, model: RobotModel, feet: Sequence[Foot], reference: Array, *, known: bool) -> None:
        """Prepare the search near a reference posture, (nj,) in rad, of a robot with a floating base.

        If `known` is True, the feet are at their places in the reference: these and the height of the base are kept.
        """
        self.model, self.feet, self.reference, self._known = model, feet, np.array(reference), known
        self._data = model.pinocchio.createData()
        self._legs = self._find_legs()
        self._mirrored = self._find_mirrored()
        free = [leg for i, leg in enumerate(self._legs) if i not in self._mirrored]
        self._columns = np.concatenate([leg.columns for leg in free]).astype(int)
        lower, upper = (ends[self._columns] for ends in usable_ranges(model))
        margin = np.minimum(_MARGIN * (upper - lower), _LARGEST_MARGIN)
        self._bounds = np.column_stack([lower + margin, upper - margin])
        start = self.stand(self.reference)
        self._size = float(start.com[2] - start.bottoms.min())
        self._wanted = self._hips(start)

    def _find_legs(self) -> list[_Leg]:
        pinocchio = self.model.pinocchio
        chains = [list(pinocchio.supports[foot.joint])[2:] for foot in self.feet]
        columns = {int(v): i for i, v in enumerate(self.model.v_index)}
        legs = []
        for foot, chain in zip(self.feet, chains, strict=True):
            own = [
                int(j) for j in chain
                if sum(j in other for other in chains) == 1 and pinocchio.joints[j].idx_v in columns
                and not (foot.kind == "rolling" and j == foot.joint)
            ]  # fmt: skip
            places = np.array([columns[pinocchio.joints[j].idx_v] for j in own], dtype=int)
            legs.append(_Leg(foot, tuple(own), places))
        return legs

    def _find_mirrored(self) -> dict[int, tuple[int, Array]]:
        """Return, by right leg, the left leg that it mirrors and the signs of its joint positions, (k,)."""
        axes, places = self._at_zero()
        found: dict[int, tuple[int, Array]] = {}
        flip = np.array([1.0, -1.0, 1.0])
        for i, left in enumerate(self._legs):
            for k, right in enumerate(self._legs):
                if i == k or k in found or i in found or len(left.joints) != len(right.joints) or not left.joints:
                    continue
                if not places[left.joints[-1]][1] > places[right.joints[-1]][1]:
                    continue
                pairs = list(zip(left.joints, right.joints, strict=True))
                signs = np.array([axes[b] @ (-flip * axes[a]) for a, b in pairs])
                apart = max(float(np.linalg.norm(places[b] - flip * places[a])) for a, b in pairs)
                if np.abs(np.abs(signs) - 1.0).max() < _MIRROR and apart < _MIRROR:
                    found[k] = i, np.sign(signs)
        return found

    def _at_zero(self) -> tuple[dict[int, Array], dict[int, Array]]:
        """Return axis and position of each joint in the base, all joints at zero."""
        model, data = self.model.pinocchio, self._data
        pin.computeJointJacobians(model, data, pin.neutral(model))
        joints = range(2, model.njoints)
        axes = {
            j: np.array(pin.getJointJacobian(model, data, j, pin.LOCAL_WORLD_ALIGNED)[3:, model.joints[j].idx_v])
            for j in joints
        }
        return axes, {j: np.array(data.oMi[j].translation) for j in joints}

    def _hips(self, start: Stand) -> Array:
        """Return the target of each foot, (n, 2) in m: as in the reference sideways, and below its hip."""
        wanted = np.array(start.middles[:, :2])
        if self._known:
            return wanted
        axes, places = self._at_zero()
        for i, leg in enumerate(self._legs):
            hip = next((j for j in leg.joints if abs(axes[j][1]) > _LATERAL), None)
            if hip is not None:
                wanted[i, 0] = places[hip][0]
        return wanted

    def _hip_height(self) -> float:
        """Return the height of the hips above the base, m; 0 below it: a base may be at the feet."""
        places = self._at_zero()[1]
        return max(0.0, float(np.mean([places[leg.joints[0]][2] for leg in self._legs if leg.joints] or [0.0])))

    def stand(self, posture: Array) -> Stand:
        """Return the placement of the feet in a posture, (nj,) in rad."""
        model, data = self.model.pinocchio, self._data
        com = pin.centerOfMass(model, data, self.model.configuration(posture))
        bottoms, middles, tilts, yaw = [], [], [], []
        for foot in self.feet:
            place = data.oMi[foot.joint] * foot.placement
            reach = foot.radius
            if foot.kind == "surface":
                tilts += place.rotation[:2, 2].tolist()
                yaw.append(place.rotation[1, 0])
            elif foot.kind == "rolling":
                lean = float(data.oMi[foot.joint].rotation[2] @ np.array(foot.axis))
                tilts.append(lean)
                reach *= np.sqrt(max(0.0, 1.0 - lean**2))
            bottoms.append(place.translation[2] - reach)
            middles.append(place.translation)
        return Stand(np.array(bottoms), np.array(middles), np.array(tilts), np.array(yaw), np.array(com))

    def solve(self) -> Array | None:
        """Return the standing posture nearest to the reference, (nj,) in rad; None if none was found."""
        rng = np.random.default_rng(0)  # the same posture each time
        middle = np.clip(self.reference[self._columns], *self._bounds.T)
        starts = [middle, *(middle + rng.uniform(-_SPREAD, _SPREAD, (_STARTS, len(middle))))]
        starts = [np.clip(start, *self._bounds.T) for start in starts]
        if self._known:
            height = -float(self.stand(self.reference).bottoms.mean())
        else:
            longest = [self._search(start, None) for start in starts[:4]]
            heights = [-float(self.stand(found).bottoms.mean()) for found in longest if found is not None]
            if not heights:
                return None
            flat = all(foot.kind == "surface" for foot in self.feet)
            hips = self._hip_height()
            height = (_BENT if flat else _BENT_POINT) * (max(heights) + hips) - hips
        found = [posture for start in starts if (posture := self._search(start, height)) is not None]
        return min(found, key=lambda posture: self._cost(posture[self._columns]), default=None)

    def _search(self, start: Array, height: float | None) -> Array | None:
        """Search with the base at a height above the ground, m, or as high as possible for None."""

        def objective(x: Array) -> float:
            bottom = 0.0 if height is not None else float(self.stand(self._expand(x)).bottoms.mean()) / self._size
            return 1.0e2 * bottom + self._cost(x)

        result = minimize(
            objective,
            start,
            method="SLSQP",
            bounds=self._bounds,
            constraints={"type": "eq", "fun": lambda x: self._errors(x, height)},
            options={"maxiter": 150, "ftol": 1.0e-8},
        )
        x = np.clip(result.x, *self._bounds.T)
        return self._expand(x) if np.abs(self._errors(x, height)).max(initial=0.0) <= _TOLERANCE else None

    def _expand(self, x: Array) -> Array:
        """Return the whole posture, (nj,), for the free joints, (k,)."""
        posture = self.reference.copy()
        posture[self._columns] = x
        for right, (left, signs) in self._mirrored.items():
            posture[self._legs[right].columns] = signs * posture[self._legs[left].columns]
        return np.asarray(np.clip(posture, self.model.position_lower, self.model.position_upper))

    def _errors(self, x: Array, height: float | None) -> Array:
        """Return the differences of heights, zero in a solution. Tilts are a cost: short legs cannot change them."""
        bottoms = self.stand(self._expand(x)).bottoms
        level = bottoms - (bottoms[0] if height is None else -height)
        free = [i for i in range(len(self.feet)) if i not in self._mirrored and not (height is None and i == 0)]
        return np.asarray(level[free])

    def _cost(self, x: Array) -> float:
        """Return the cost: squared distances of joints, feet and centre of mass from their targets."""
        posture = self._expand(x)
        stand = self.stand(posture)
        away = (stand.middles[:, :2] - self._wanted) / self._size
        away[:, 0] -= away[:, 0].mean()  # all feet may be further in front: the centre of mass decides
        offset = (stand.com - stand.middles.mean(axis=0))[:2] / self._size
        change = float(((posture - self.reference) ** 2).sum())
        return (
            change
            + _CENTRE * float(offset @ offset)
            + _TILT * float(stand.tilts @ stand.tilts)
            + _UNDER_HIP * float((away**2).sum())
            + _YAW * float((stand.yaw**2).sum())
        )
