"""Search for the feet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.foot_shape import Foot, links_of, measure
from wbc_controller.controller.build.footprint import outline
from wbc_controller.errors import require_known
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Largest height difference of feet, and smallest of other parts above them, as shares of the robot's height.
_LEVEL, _ABOVE = 0.15, 0.02
_ALIKE = 0.2  # largest relative difference of leg masses
LEG_JOINTS = 3  # smallest number; fingers have fewer


class Limb(NamedTuple):
    """End of the kinematic tree, with the joints that move only it."""

    end: int
    joints: tuple[int, ...]
    mass: float  # kg
    lowest_point: float  # height, m, with the base upright


class Body:
    """The robot in one posture, upright at the origin."""

    def __init__(self, model: RobotModel, elements: Sequence[pin.GeometryObject], posture: Array) -> None:
        """Compute kinematics and limbs in a posture, (nj,) in rad."""
        self.model, self.elements, self._robot = model, elements, model.pinocchio
        self.data = self._robot.createData()  # kinematics in the posture
        q = model.configuration(posture)
        pin.framesForwardKinematics(self._robot, self.data, q)
        pin.computeJointJacobians(self._robot, self.data, q)
        points = {joint: self._points(joint) for joint in range(1, self._robot.njoints)}
        self.height = float(np.ptp(np.vstack(list(points.values()))[:, 2]))  # m
        self._lowest_points = {joint: float(some[:, 2].min(initial=np.inf)) for joint, some in points.items()}
        self.limbs = [self.limb(end) for end in range(2, self._robot.njoints) if not len(self._robot.children[end])]

    def _points(self, joint: int) -> Array:
        """Return points of the shapes or link origins moved by a joint, (n, 3) in the world."""
        place = self.data.oMi[joint]
        shapes = [outline(element) for element in self.elements if element.parentJoint == joint]
        shapes = shapes or [frame.placement.translation[None] for frame in links_of(self.model, joint)]
        return np.asarray(np.vstack([np.zeros((0, 3)), *shapes]) @ place.rotation.T + place.translation)

    def limb(self, end: int) -> Limb:
        """Return the limb of a joint, up to the next branch."""
        chain, robot = [end], self._robot
        while robot.parents[chain[0]] > 1 and len(robot.children[robot.parents[chain[0]]]) == 1:
            chain.insert(0, int(robot.parents[chain[0]]))
        return Limb(end, tuple(chain), sum(robot.inertias[joint].mass for joint in chain), self._lowest_points[end])

    def arms(self) -> list[Limb]:
        """Return the limbs, with a palm in place of its fingers."""
        supports = self._robot.supports
        palms: list[Limb] = []
        for joint in range(2, self._robot.njoints):
            if len(self._robot.children[joint]) > 1 and not any(palm.end in supports[joint] for palm in palms):
                chain, own = self.limb(joint), len(supports[joint])
                longest = max(len(supports[limb.end]) - own for limb in self.limbs if joint in supports[limb.end])
                palms += [chain] if len(chain.joints) > longest else []
        limbs = [limb for limb in self.limbs if not any(palm.end in supports[limb.end] for palm in palms)]
        return [*limbs, *palms]

    def feet(self) -> list[Foot]:
        """Return the feet, the front left one first; empty without limbs to stand on."""
        lowest = min(self.limbs, key=lambda limb: limb.lowest_point)
        base, pelvis = 1, int(self._robot.parents[lowest.joints[0]])
        # A pelvis below a waist is lower than the base; a chest with arms is higher.
        below = len(lowest.joints) >= LEG_JOINTS and self.data.oMi[pelvis].translation[2] <= 0.0
        return self._feet_on_trunk(base) or (self._feet_on_trunk(pelvis) if below else [])

    def _feet_on_trunk(self, trunk: int) -> list[Foot]:
        own = [limb for limb in self.limbs if self._robot.parents[limb.joints[0]] == trunk]
        lowest = min(own, key=lambda limb: limb.lowest_point, default=None)
        if lowest is None:
            return []
        alike = [
            limb
            for limb in own
            if limb.lowest_point - lowest.lowest_point <= _LEVEL * self.height
            and len(limb.joints) == len(lowest.joints)
            and abs(limb.mass - lowest.mass) <= _ALIKE * lowest.mass
        ]
        legs = {joint for limb in alike for joint in limb.joints}
        others = [lowest_point for joint, lowest_point in self._lowest_points.items() if joint not in legs]
        if len(alike) < 2 or not (min(others) > max(limb.lowest_point for limb in alike) + _ABOVE * self.height):
            return []
        return self._measure_feet([limb.end for limb in alike])

    def feet_on_links(self, links: Sequence[str]) -> list[Foot]:
        """Return the feet on named links; raise `ConfigurationError` if no joint moves one."""
        moved = {str(f.name): joint for joint in range(2, self._robot.njoints) for f in links_of(self.model, joint)}
        require_known(links, moved, "--feet: unknown moving link")
        return self._measure_feet(list(dict.fromkeys(moved[link] for link in links)))

    def remeasured(self, feet: Sequence[Foot]) -> list[Foot]:
        """Return the feet as measured in this posture: the contact point of a ball depends on the posture."""
        balls = {foot.joint: foot for foot in self._measure_feet([f.joint for f in feet]) if foot.kind == "point"}
        return [balls.get(f.joint, f) if f.kind == "point" and f.measured_on else f for f in feet]

    def _measure_feet(self, ends: Sequence[int]) -> list[Foot]:
        feet = []
        for end in ends:
            J = pin.getJointJacobian(self._robot, self.data, end, pin.LOCAL)
            axis = J[3:, self._robot.joints[end].idx_v]  # of the joint, in its own frame
            feet.append(measure(self.model, self.elements, end, self.data.oMi[end].inverse(), axis))
        at = {foot.joint: self.data.oMi[foot.joint].act(foot.placement.translation) for foot in feet}
        # rounded for adjacent feet
        return sorted(feet, key=lambda foot: (-round(at[foot.joint][0] / self.height, 1), -at[foot.joint][1]))
