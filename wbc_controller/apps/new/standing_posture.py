"""Search for a standing posture, stable and with bent legs."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from wbc_controller.apps.new.foot_shape import Foot
from wbc_controller.apps.new.mechanism import usable_ranges
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Leg length, as a share of the longest with level feet: with flat feet, and with other feet.
_BENT, _BENT_POINT = 0.94, 0.85
#: Share of the travel of flat feet under the hips by which the legs are bent at most, since the ankles' range may be
#: small; tried shares of the bend; largest motion of a foot aside, relative to the robot's size.
_TRAVEL_SHARE, _SHARES, _ASIDE = 0.35, (1.0, 0.75, 0.5, 0.3, 0.15), 0.03
_ANKLE_SHARE = 0.5  # of the ankles' torques, for the centre of mass before them
_MARGIN, _LARGEST_MARGIN = 0.08, 0.15  # share of the range, and maximum, rad
_STARTS, _SPREAD = 8, 0.8  # starts, and distance from the reference, rad
_TOLERANCE = 1.0e-3  # largest accepted constraint error, m or rad
_LEVEL = 0.02  # largest height difference, m, or tilt, as a sine, of level feet
#: Weights: centre of mass off the feet's middle and foot off the hip, relative to the robot's size; tilt and yaw of
#: soles.
_CENTRE, _UNDER_HIP, _TILT, _YAW = 3000.0, 30.0, 3000.0, 5.0
_MIRROR = 0.02  # of directions, and of positions, m
_LATERAL = 0.7  # cosine of the largest angle to the lateral axis, 45°


class _Leg(NamedTuple):
    """Indices of the joints that move only one foot, in Pinocchio's model and in `RobotModel.joints`."""

    joints: tuple[int, ...]
    columns: np.ndarray


class FeetPlacement(NamedTuple):
    """Placement of the feet, with the base upright at the origin."""

    bottoms: Array  # height of the lowest point of each foot, (n,) in m
    middles: Array  # of the feet, (n, 3) in m
    tilts: Array  # tilts of soles and axles, as sines, (m,)
    yaw: Array  # of soles, as sines, (k,)
    com: Array  # (3,) in m

    @property
    def height(self) -> float:
        """Height of the base above the feet, m."""
        return -float(self.bottoms.mean())

    @property
    def level_error(self) -> float:
        """Largest height difference, m, or tilt, as a sine."""
        return float(max(np.ptp(self.bottoms), np.abs(self.tilts).max(initial=0.0)))


class Legs:
    """Legs of a robot, and the search for their posture."""

    def __init__(self, model: RobotModel, feet: Sequence[Foot], reference: Array, *, keep_feet: bool) -> None:
        """Prepare the search near a reference, (nj,) in rad; `keep_feet` keeps its foot positions and base height."""
        self.model, self.feet, self.reference, self._keep_feet = model, feet, np.array(reference), keep_feet
        robot, data = model.pinocchio, model.pinocchio.createData()
        self._data, joints = data, range(2, robot.njoints)
        pin.computeJointJacobians(robot, data, pin.neutral(robot))
        jacobians = {j: pin.getJointJacobian(robot, data, j, pin.LOCAL_WORLD_ALIGNED) for j in joints}
        #: Axes and positions of the joints at zero, (3,) each in the world, by joint.
        self._axes = {j: np.array(J[3:, robot.joints[j].idx_v]) for j, J in jacobians.items()}
        self._places = {j: np.array(data.oMi[j].translation) for j in joints}
        self._legs = self._find_legs()
        self._mirrored = self._find_mirrored()
        self._com_target = self._find_com_target()
        free = [leg for i, leg in enumerate(self._legs) if i not in self._mirrored]
        self._columns = np.concatenate([leg.columns for leg in free]).astype(int)
        self._bounds = np.column_stack(usable_ranges(model, _MARGIN, _LARGEST_MARGIN))[self._columns]
        start = self.place_feet(self.reference)
        self._size = float(start.com[2] - start.bottoms.min())
        self._targets = self._foot_targets(start)

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
            legs.append(_Leg(tuple(own), places))
        return legs

    def _find_com_target(self) -> Array:
        """Return the target of the centre of mass from the middle of the feet, (2,) in m.

        It is the middle of soles if the ankles bear the weight there with `_ANKLE_SHARE` of their torques.
        """
        model, offsets = self.model, []
        efforts = model.effort_limits @ np.abs(model.actuation.ratios)  # of the joints, N·m
        largest = _ANKLE_SHARE * len(self.feet) * efforts / (model.mass * model.gravity)  # lever arms, m
        for foot, leg in zip(self.feet, self._legs, strict=True):
            pitch = [i for i, j in zip(leg.columns, leg.joints, strict=True) if abs(self._axes[j][1]) > _LATERAL]
            if foot.kind != "surface" or not pitch:
                return np.zeros(2)
            ankle = float(foot.placement.inverse().translation[0])
            offsets.append(ankle + np.clip(-ankle, -largest[pitch[-1]], largest[pitch[-1]]))
        return np.array([np.mean(offsets), 0.0])

    def _find_mirrored(self) -> dict[int, tuple[int, Array]]:
        """Return the mirrored left leg of each right leg, and the signs of its joint positions, (k,)."""
        axes, places = self._axes, self._places
        found: dict[int, tuple[int, Array]] = {}
        flip = np.array([1.0, -1.0, 1.0])
        for (i, left), (k, right) in itertools.permutations(enumerate(self._legs), 2):
            if k in found or i in found or len(left.joints) != len(right.joints) or not left.joints:
                continue
            if not places[left.joints[-1]][1] > places[right.joints[-1]][1]:
                continue
            pairs = list(zip(left.joints, right.joints, strict=True))
            signs = np.array([axes[b] @ (-flip * axes[a]) for a, b in pairs])
            apart = max(float(np.linalg.norm(places[b] - flip * places[a])) for a, b in pairs)
            if np.abs(np.abs(signs) - 1.0).max() < _MIRROR and apart < _MIRROR:
                found[k] = i, np.sign(signs)
        return found

    def _foot_targets(self, start: FeetPlacement) -> Array:
        """Return the target of each foot, (n, 2) in m: laterally as in the reference, and below its hip."""
        targets = np.array(start.middles[:, :2])
        if self._keep_feet:
            return targets
        for i, leg in enumerate(self._legs):
            hip = next((j for j in leg.joints if abs(self._axes[j][1]) > _LATERAL), None)
            if hip is not None:
                targets[i, 0] = self._places[hip][0]
        return targets

    def place_feet(self, posture: Array) -> FeetPlacement:
        """Return the feet in a posture, (nj,) in rad."""
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
                lean = float(data.oMi[foot.joint].rotation[2] @ foot.axis)
                tilts.append(lean)
                reach *= np.sqrt(max(0.0, 1.0 - lean**2))
            bottoms.append(place.translation[2] - reach)
            middles.append(place.translation)
        return FeetPlacement(np.array(bottoms), np.array(middles), np.array(tilts), np.array(yaw), np.array(com))

    def solve(self) -> Array | None:
        """Return the nearest standing posture, (nj,) in rad, or None."""
        rng = np.random.default_rng(0)
        middle = np.clip(self.reference[self._columns], *self._bounds.T)
        starts = [middle, *(middle + rng.uniform(-_SPREAD, _SPREAD, (_STARTS, len(middle))))]
        starts = [np.clip(start, *self._bounds.T) for start in starts]
        if self._keep_feet:
            height = self.place_feet(self.reference).height
        else:
            longest = self._best(starts[:4], None)
            if longest is None:
                return None
            height = self.place_feet(longest).height
            flat = all(foot.kind == "surface" for foot in self.feet)
            hips = float(np.mean([self._places[leg.joints[0]][2] for leg in self._legs if leg.joints] or [0.0]))
            bend = (1.0 - (_BENT if flat else _BENT_POINT)) * (height + max(0.0, hips))
            height -= bend * self._share_of_bend(starts[:4], height, bend) if flat else bend
        return self._best(starts, height)

    def _share_of_bend(self, starts: Sequence[Array], longest: float, bend: float) -> float:
        """Return the share of a bend, m, that leaves room for a squat of flat feet under the hips."""
        for share in _SHARES:
            lowest = self._best(starts, longest - share * bend / _TRAVEL_SHARE)
            if lowest is not None:
                placement = self.place_feet(lowest)
                aside = np.abs(placement.middles[:, 1] - self._targets[:, 1]).max()
                if placement.level_error <= _LEVEL and aside <= _ASIDE * self._size:
                    return share
        return _SHARES[-1]

    def _best(self, starts: Sequence[Array], height: float | None) -> Array | None:
        found = [posture for start in starts if (posture := self._search(start, height)) is not None]
        if height is None:
            return max(found, key=lambda posture: self.place_feet(posture).height, default=None)
        return min(found, key=lambda posture: self._cost(posture[self._columns]), default=None)

    def _search(self, start: Array, height: float | None) -> Array | None:
        """Search at a base height, m; None maximizes it."""

        def objective(x: Array) -> float:
            raised = 0.0 if height is not None else 1.0e2 * self.place_feet(self._expand(x)).height / self._size
            return self._cost(x) - raised

        level = {"type": "eq", "fun": lambda x: self._errors(x, height)}
        options = {"maxiter": 150, "ftol": 1.0e-8}
        result = minimize(objective, start, method="SLSQP", bounds=self._bounds, constraints=level, options=options)
        x = np.clip(result.x, *self._bounds.T)
        return self._expand(x) if np.abs(self._errors(x, height)).max(initial=0.0) <= _TOLERANCE else None

    def _expand(self, x: Array) -> Array:
        posture = self.reference.copy()
        posture[self._columns] = x
        for right, (left, signs) in self._mirrored.items():
            posture[self._legs[right].columns] = signs * posture[self._legs[left].columns]
        return np.asarray(np.clip(posture, self.model.position_lower, self.model.position_upper))

    def _errors(self, x: Array, height: float | None) -> Array:
        """Return the height errors of the feet, m; tilts are costs, because short legs cannot change them."""
        bottoms = self.place_feet(self._expand(x)).bottoms
        level = bottoms - (bottoms[0] if height is None else -height)
        free = [i for i in range(len(self.feet)) if i not in self._mirrored and not (height is None and i == 0)]
        return np.asarray(level[free])

    def _cost(self, x: Array) -> float:
        posture = self._expand(x)
        placement = self.place_feet(posture)
        offsets = (placement.middles[:, :2] - self._targets) / self._size
        offsets[:, 0] -= offsets[:, 0].mean()
        offset = ((placement.com - placement.middles.mean(axis=0))[:2] - self._com_target) / self._size
        change = float(((posture - self.reference) ** 2).sum())
        return (
            change
            + _CENTRE * float(offset @ offset)
            + _TILT * float(placement.tilts @ placement.tilts)
            + _UNDER_HIP * float((offsets**2).sum())
            + _YAW * float((placement.yaw**2).sum())
        )
