"""Live audit on the mock robot: silent with the right model, a warning for each error.

The energy residual stays below 2 % of the mechanical power. A wrong mass, a torque with the wrong sign and an unknown
push are detected within a second.
"""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.report import CycleReport
from wbc_controller.inverse_dynamics.references.changes import SetExternalWrench, SetSetpoint, SetTrajectory
from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.mechanics.energy import energy_residual
from wbc_controller.mechanics.external import ExternalWrench
from wbc_controller.mechanics.momentum import momentum_residual
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.safety.model_audit import ModelAudit
from wbc_controller.settings.config import load
from wbc_controller.simulation.simulation import Simulation

LET_GO, CALM = 0.2, 0.9  # s: release of the hoist, end of transients


def heavier(urdf: str, link: str, factor: float) -> str:
    """The same robot with one link's mass and inertia scaled."""
    tree = ElementTree.fromstring(urdf)  # noqa: S314  # our own robot
    inertial = tree.find(f"link[@name='{link}']/inertial")
    assert inertial is not None
    for element in (inertial.find("mass"), inertial.find("inertia")):
        for key, value in element.attrib.items():
            element.set(key, repr(factor * float(value)))
    return ElementTree.tostring(tree, encoding="unicode")


class Run(Lockstep):
    """A controller and a mock robot in one thread, released from the hoist."""

    def __init__(self, robot: str = "g1", plant: RobotModel | None = None) -> None:
        quick = {"safety.activation_ramp": 0.1, "safety.bring_up_time": 0.0}
        self.reports: list[CycleReport] = []
        mock = {"model": plant} if plant else {}
        super().__init__(load(robot).replace(quick).settings, mock=mock, observers=(self.reports.append,))
        self.user.send_text("command", "activate")
        self.until(LET_GO)
        self.mock.plant.hold(False)
        self.until(CALM)

    @property
    def time(self) -> float:
        return self.mock.stamp * 1e-9

    def until(self, time: float) -> None:
        while self.time < time - 1e-9:
            self.cycle()
            if self.mock.plant.fallen:
                return

    def change(self, *changes) -> None:
        self.controller.board.apply(changes, self.controller.qp.dynamics, self.time)

    def audits(self, since: float, within: float = np.inf):
        """Return the audits in a time span."""
        reports = [report for report in self.reports if since < report.stamp * 1e-9 <= since + within]
        return [report.audit for report in reports if report.audit]

    def until_warned(self, *names: str) -> bool:
        """Run for at most a second; return whether one of these warnings came."""
        while not self.warned(CALM, 1.0) & set(names) and self.time < CALM + 1.0:
            self.until(self.time + 0.05)
        return bool(self.warned(CALM, 1.0) & set(names))

    def warned(self, since: float, within: float) -> set[str]:
        """Return the names of warnings in a time span."""
        return {warning.partition(":")[0] for audit in self.audits(since, within) for warning in audit.warnings}


def test_with_the_right_model_nothing_is_left_over():
    run = Run("go2")
    com, still = run.controller.qp.dynamics.com.copy(), np.zeros(3)
    knots = Knot(1.0, com - [0.0, 0.0, 0.06], still, still), Knot(2.0, com, still, still)
    run.change(SetTrajectory("com", None, knots))
    run.until(CALM + 2.4)
    audits = run.audits(CALM + 0.5)
    moving = [audit for audit in audits if audit.throughput > 5.0]
    share = max(abs(audit.energy) / audit.throughput for audit in moving)
    force = max(np.linalg.norm(audit.force) for audit in audits) / (run.model.mass * run.model.gravity)
    print(f"energy residual {100 * share:.3f} % of the power, force {100 * force:.3f} % of the weight")
    assert len(moving) > 200
    assert share < 0.02
    assert force < 0.001
    assert not run.warned(CALM, 10.0)


@pytest.mark.parametrize("robot", ["g1", "go2"])
def test_the_residuals_are_those_of_the_laws_of_motion(robot):
    """Without its filter, against the functions of `mechanics` (S5, S6), with a wrong link and a known wrench."""
    simulation = Simulation(robot)
    controller, plant = simulation.controller, simulation.plant
    unfiltered = controller.config.settings.audit.model_copy(update={"time_constant": 1.0e-15})
    audit = ModelAudit(controller.model, unfiltered, controller.period)
    base, known = controller.model.base_link, np.array([5.0, 12.0, -3.0, 0.5, -0.3, 0.2])
    controller.board.apply([SetExternalWrench(base, known)], controller.dynamics, simulation.time)
    plant.push(base, known + [9.0, 0.0, 4.0, 0.0, 0.0, 0.0], 1.0)  # exceeds the known wrench
    model, seen = controller.model.pinocchio, []
    before = None

    def compare(now):
        nonlocal before
        result = now.result
        report = audit.check(result.state, controller.dynamics, result.solution, result.command)
        if before is not None and report is not None and np.array_equal(before.solution.tau, before.command.tau):
            wrenches = [ExternalWrench(base, known)]
            force = controller.model.actuation.generalized_force(before.command.tau)
            rotors = controller.model.actuation.rotors
            if rotors is not None:
                force = force - rotors @ (result.state.v - before.state.v) / controller.period
            energy = energy_residual(model, before.state, result.state, force, wrenches)
            momentum = momentum_residual(model, before.state, result.state, [*contacts, *wrenches]).residual[:3]
            energies = report.energy, energy.residual, report.throughput, energy.throughput
            seen.append((*energies, *report.force, *momentum))
        contacts[:] = [
            ExternalWrench(base, controller.contacts[name].wrench_in_world(controller.dynamics, f), "WORLD")
            for name, f in result.solution.forces.items()
        ]
        before = result

    contacts = []
    simulation.run(0.1, compare)
    values = np.array(seen)
    assert len(values) > 40
    assert np.abs(values[:, 0]).max() > 0.1
    assert np.abs(values[:, 4:7]).max() > 2.0
    np.testing.assert_allclose(values[:, 0], values[:, 1], atol=1e-6)
    np.testing.assert_allclose(values[:, 2], values[:, 3], rtol=1e-9)
    np.testing.assert_allclose(values[:, 4:7], values[:, 7:10], atol=1e-4)


def test_a_wrong_mass_is_named_within_a_second():
    settings = load("g1").settings
    run = Run(plant=make_model(settings, heavier(make_model(settings).urdf, "right_elbow_link", 0.8)))
    assert run.until_warned("UNMODELLED_FORCE")
    assert "UNMODELLED_FORCE" in run.reports[-1].audit.warnings[0]


def test_a_torque_with_the_wrong_sign_is_named_within_a_second():
    run = Run()
    i, apply = run.model.joints.index("left_ankle_pitch_joint"), run.mock.plant.apply
    sign = np.ones(run.model.na)
    sign[i] = -1.0
    run.mock.plant.apply = lambda tau: apply(sign * tau)
    assert run.until_warned("UNMODELLED_TORQUE", "ENERGY_RESIDUAL")


def test_an_unknown_push_is_named_within_a_second_and_then_forgotten():
    run, push = Run(), (3.0, 0.0, 0.0)
    run.mock.plant.push(run.model.base_link, np.array([*push, 0.0, 0.0, 0.0]), 1.0)
    run.until(CALM + 1.0)
    assert "UNMODELLED_FORCE" in run.warned(CALM, 1.0)
    # The ground supports a part, so that only the direction is accurate.
    force, size = run.audits(CALM)[-1].force, np.linalg.norm(push)
    assert force @ push > 0.9 * np.linalg.norm(force) * size
    assert 0.5 * size < np.linalg.norm(force) < 1.5 * size
    while run.reports[-1].audit.warnings and run.time < CALM + 2.5:
        run.until(run.time + 0.05)
    assert not run.reports[-1].audit.warnings


def test_a_push_that_is_known_and_a_setpoint_are_no_surprise():
    run = Run("go2")
    run.change(SetSetpoint("com", run.controller.qp.dynamics.com + np.array([0.02, 0.02, -0.03])))
    run.until(CALM + 1.2)
    assert not run.warned(CALM, 2.0)
    push = np.array([0.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    run.change(SetExternalWrench(run.model.base_link, push))
    run.mock.plant.push(run.model.base_link, push, 0.7)
    run.until(CALM + 1.8)
    assert not run.warned(CALM, 3.0)


def test_short_pushes_with_rests_between_them_do_not_add_up():
    run = Run()
    for i in range(3):
        run.mock.plant.push(run.model.base_link, np.array([0.0, 5.0, 0.0, 0.0, 0.0, 0.0]), 0.1)
        run.until(CALM + (i + 1))
        assert max(np.linalg.norm(audit.force) for audit in run.audits(CALM + i)) > run.loop._audit._largest_force
    assert not run.warned(CALM, 5.0)
