"""A user's own task, contact and limit."""

import numpy as np
import pinocchio as pin

import wbc_controller as wbc

AXES = pin.LOCAL_WORLD_ALIGNED


class Height(wbc.MotionTask):
    """Height of the centre of mass."""

    size = 1

    def __init__(self, model, name="height"):
        super().__init__(name, [True])

    def position(self, dynamics):
        return np.array(dynamics.com[2:])

    def velocity(self, dynamics):
        return dynamics.com_velocity[2:]

    def error(self, dynamics, position):
        return position - dynamics.com[2:]

    def jacobian(self, dynamics):
        return dynamics.com_jacobian[2:]

    def drift(self, dynamics):
        return dynamics.com_drift[2:]


class Grip(wbc.AnchoredContact):
    """A point of a link that is held, with 3 forces and an anchor."""

    def __init__(self, model, link="FL_calf", cone=np.zeros((0, 3)), stiffness=1.0):  # noqa: B008
        super().__init__("grip", np.eye(6)[:, :3], cone, "world", stiffness=stiffness, damping=20.0, internal=False)
        self.frame = model.frame_id(link, "grip")

    def jacobian(self, dynamics):
        return dynamics.jacobian(self.frame, AXES)[:3]

    def drift(self, dynamics):
        return dynamics.drift_world(self.frame)[:3]

    def points(self, dynamics):
        return dynamics.placement(self.frame).translation[None]

    def wrench_in_world(self, dynamics, force):
        return np.concatenate([force, np.cross(dynamics.placement(self.frame).translation, force)])

    def bounds(self, activation):
        return np.full(3, -50.0 * activation), np.full(3, 50.0 * activation)

    def pose(self, dynamics):
        return dynamics.placement(self.frame)

    def displacement(self, dynamics, anchor):
        return anchor[:3] - dynamics.placement(self.frame).translation


class Ceiling(wbc.RowLimit):
    """An upper bound of the vertical acceleration of the centre of mass."""

    names, kind, unit = ("ceiling:com",), "ceiling", "m/s²"

    def __init__(self, model, most=0.05):
        self.most = most

    def fill(self, dynamics, period, rows, lower, upper):
        rows[:] = dynamics.com_jacobian[2]
        lower[:], upper[:] = -np.inf, self.most - dynamics.com_drift[2]
