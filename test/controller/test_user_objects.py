"""User objects with failing methods, before activation and in a running controller."""

from functools import cache

import numpy as np
import pytest
from refusals import refusal

import wbc_controller as wbc
from wbc_controller.controller.build.estimation import contact_normals
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.controller import Controller
from wbc_controller.inverse_dynamics.contacts import FixedContact, SurfaceContact, placement_of
from wbc_controller.inverse_dynamics.contacts.support import Rectangle
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.records import Mode
from wbc_controller.validation.fuzz.hostile_classes import Ceiling, Grip, Height

PERIOD = 0.002


class Momentum(wbc.RateTask):
    """Linear momentum."""

    size, weight = 3, 1.0e-4

    def __init__(self, model):
        super().__init__("momentum", [True] * 3, gain=10.0, key="gain")

    def position(self, dynamics):
        return dynamics.centroidal_matrix[:3] @ dynamics.v

    def jacobian(self, dynamics):
        return dynamics.centroidal_matrix[:3]

    def drift(self, dynamics):
        return dynamics.centroidal_drift[:3]


class Effort(wbc.EffortTask):
    """The first torque."""

    size, weight = 1, 1.0e-6

    def __init__(self, model):
        super().__init__("effort", [True], np.zeros(1))

    def equation(self, efforts, reference):
        rows, offset = efforts.torque_map
        return rows[:1], reference.position - offset[:1]


KINDS = {Height: "tasks", Momentum: "tasks", Effort: "tasks", Grip: "contacts", Ceiling: "limits"}
NAMES = {kind: f"{key.removesuffix('s')} '{kind.__name__.lower()}'" for kind, key in KINDS.items()}


def raises(*arguments):
    raise ZeroDivisionError("division by zero")


def returns(value):
    return lambda *arguments: value


def writes(number):
    def fill(dynamics, period, rows, lower, upper):
        rows[:], lower[:], upper[:] = number, -1.0, 1.0

    return fill


#: Class, method, replacement, message.
FAILURES = [
    (Height, "error", returns(np.zeros(2)), "returned shape (2,), expected (1,)"),
    (Height, "error", returns(np.array([np.nan])), "returned [nan], expected finite numbers"),
    (Height, "error", returns(None), "returned None, expected an array of numbers of shape (1,)"),
    (Height, "error", returns(np.array([1.0j])), "returned [1j], expected an array of numbers of shape (1,)"),
    (Height, "error", raises, "raised ZeroDivisionError: division by zero"),
    (Height, "velocity", returns(np.zeros(0)), "returned shape (0,), expected (1,)"),
    (Height, "drift", returns(np.zeros(2)), "returned shape (2,), expected (1,)"),
    (Height, "jacobian", returns(np.zeros(18)), "returned shape (18,), expected (1, 18)"),
    (Height, "jacobian", returns(np.full((1, 18), np.inf)), "returned [[inf, inf,"),
    (Height, "right", returns(np.zeros(1)), "returned [0.0], expected 2 arrays"),
    (Height, "equation", returns((np.zeros((2, 18)), np.zeros(1), np.zeros(1))), "shape (2, 18), expected (1, 18)"),
    (Momentum, "drift", returns(np.zeros(1)), "returned shape (1,), expected (3,)"),
    (Momentum, "jacobian", returns(np.zeros((1, 18))), "returned shape (1, 18), expected (3, 18)"),
    (Momentum, "position", raises, "raised ZeroDivisionError: division by zero"),
    (Effort, "equation", returns((np.zeros((1, 3)), np.zeros(1))), "returned shape (1, 3), expected (1, "),
    (Effort, "equation", returns(np.zeros(1)), "returned [0.0], expected 2 arrays"),
    (Grip, "displacement", returns(np.full(3, np.nan)), "returned [nan, nan, nan], expected finite numbers"),
    (Grip, "acceleration_at_rest", raises, "raised ZeroDivisionError: division by zero"),
    (Grip, "jacobian", returns(np.zeros((1, 18))), "returned shape (1, 18), expected (3, 18)"),
    (Grip, "drift", returns(np.full(3, np.nan)), "returned [nan, nan, nan], expected finite numbers"),
    (Grip, "bounds", returns((np.zeros(3), np.full(3, -1.0))), "returned the bounds 0 and -1 at index 0"),
    (Grip, "bounds", returns((np.zeros(1), np.ones(1))), "returned shape (1,), expected (3,)"),
    (Ceiling, "fill", writes(np.nan), "wrote [[nan, nan,"),
    (Ceiling, "fill", raises, "raised ZeroDivisionError: division by zero"),
]


def broken(kind, method, instead):
    def make(model):
        one = kind(model)
        setattr(one, method, instead)
        return one

    return make


CONFIG = wbc.load("go2").replace({"safety.damping_time": 0.1})


@cache
def go2():
    return make_model(CONFIG.settings)


def made(**own):
    return wbc.Controller(CONFIG, **own, preflight=False, model=go2())


@cache
def with_all():
    """A controller with an object of each class."""
    return made(tasks=[Height, Momentum, Effort], contacts=[Grip], limits=[Ceiling])


def running(controller):
    """Activate a controller; return a function for a further step, and the last result."""
    q, v = controller.stance(), np.zeros(controller.model.nv)
    controller.reset(q, v)
    for i in range(60):
        result = controller.step(q, v, PERIOD * (i + 1))
    assert result.mode is Mode.ACTIVE
    return lambda i: controller.step(q, v, PERIOD * (61 + i)), result


@pytest.mark.parametrize(("kind", "method", "instead", "said"), FAILURES)
def test_a_failing_method_is_refused_before_anything_moves_and_damps_the_robot_in_a_run(
    kind, method, instead, said, caplog, monkeypatch
):
    refused = refusal(made, **{KINDS[kind]: [broken(kind, method, instead)]})
    assert f"{NAMES[kind]}: {kind.__name__}.{method}() " in refused
    assert said in refused
    controller = with_all()
    step, before = running(controller)
    (owner,) = [one for one in (*controller.tasks.values(), *controller.contacts.values(), *controller.limits.values())
                if isinstance(one, kind)]  # fmt: skip
    monkeypatch.setattr(owner, method, instead)
    result = step(0)
    assert (result.mode, result.fault.code) == (Mode.DAMPING, "METHOD_FAILED")
    assert f"{NAMES[kind]}: {kind.__name__}.{method}() " in result.fault.sentence
    assert said in result.fault.sentence
    assert "Traceback" in caplog.text
    assert np.abs(before.tau).max() > 1.0
    assert not result.tau.any()  # damping of joints at rest
    later = [step(i) for i in range(1, 60)][-1]
    assert later.mode is Mode.FAULT
    assert not later.tau.any()
    assert later.fault.code == "METHOD_FAILED"


def test_integers_and_lists_are_converted():
    def changed(model):
        one = Height(model)
        one.error = lambda dynamics, position: [int(position[0] - dynamics.com[2])]
        one.drift = lambda dynamics: np.zeros(1, dtype=np.float32)
        one.velocity = lambda dynamics: np.zeros(2)[::2].astype(">f8")
        one.jacobian = lambda dynamics: dynamics.com_jacobian[2:].tolist()
        return one

    results = []
    for make in (Height, changed):
        step, _ = running(made(tasks=[make]))
        results.append(step(0).tau)
    np.testing.assert_allclose(results[1], results[0], atol=1.0e-9)


@pytest.mark.parametrize(
    ("kind", "attribute", "value", "said"),
    [
        (Height, "size", 1.5, "Height.size is 1.5, expected an integer above 0"),
        (Height, "rows", np.array([1]), "expected indices below size = 1"),
        (Height, "weight", np.nan, "Height.weight is nan, expected a finite number of at least 0"),
        (Height, "stiffness", np.ones(2), "expected finite numbers of shape () or (1,)"),
        (Height, "tolerance", np.array([-1.0]), "expected finite numbers of at least 0"),
        (Effort, "target", np.zeros(2), "returned shape (2,), expected (1,)"),
        (Grip, "basis", np.zeros((6, 2)), "expected finite numbers of shape (6, 3)"),
        (Grip, "cone", np.zeros((1, 2)), "expected finite numbers of shape (rows, 3)"),
        (Grip, "metric", np.ones(2), "expected finite numbers of shape (3,)"),
        (Grip, "damping", np.inf, "Grip.damping is inf, expected a finite number of at least 0"),
        (Ceiling, "names", (), "Ceiling.names is (), expected a tuple with one string per row"),
    ],
)
def test_attributes_of_which_no_program_can_be_laid_out_are_refused(kind, attribute, value, said):
    refused = refusal(made, **{KINDS[kind]: [broken(kind, attribute, value)]})
    assert NAMES[kind] in refused
    assert said in refused


def test_a_limit_that_changes_its_number_of_rows_damps_the_robot():
    controller = made(limits=[Ceiling])
    step, _ = running(controller)
    controller.limits["ceiling"].names = ("ceiling:com", "ceiling:base")
    result = step(0)
    assert (result.mode, result.fault.code) == (Mode.DAMPING, "METHOD_FAILED")
    assert "Ceiling.fill() changed the number of names to 2, expected 1" in result.fault.sentence


def test_a_method_that_fails_at_the_reset_leaves_the_controller_without_torques():
    controller = made(tasks=[Height])
    step, _ = running(controller)
    controller.tasks["height"].position = returns(np.zeros(2))
    said = refusal(controller.reset, controller.stance(), np.zeros(controller.model.nv))
    assert "Height.position() returned shape (2,), expected (1,)" in said
    result = step(0)
    assert result.mode is not Mode.ACTIVE
    assert not result.tau.any()


@pytest.fixture
def service(bench, monkeypatch):
    """Controller with topics and user objects."""
    made = bench("go2")
    controller = Controller(made.settings, tasks=[Height], contacts=[Grip], preflight=False, model=made.model)
    made.loop = make_loop(controller, made.transport, made.clock, made.topics, observers=(made.reports.append,))
    return made


def test_a_method_that_fails_at_the_command_to_activate_damps_the_robot(service):
    service.cycle(3)
    service.loop.controller.tasks["height"].position = returns(np.zeros(2))
    report = service.activate()
    assert (report.mode, report.fault.code) == (Mode.DAMPING, "METHOD_FAILED")
    assert "Height.position() returned shape (2,), expected (1,)" in report.fault.sentence
    assert not service.efforts()[-1].any()


def test_a_method_that_only_pictures_use_damps_the_robot_too(service):
    service.activate()
    service.cycle(20)
    service.loop.controller.contacts["grip"].points = returns(np.zeros((1, 2)))
    for _ in range(200):  # until the next markers
        service.give_state()
        service.loop._guarded_cycle()
    fault = service.loop.controller.fault
    assert (service.loop.controller.mode, fault.code) == (Mode.DAMPING, "METHOD_FAILED")
    assert "contact 'grip': Grip.points() returned shape (1, 2), expected (1, 3)" in fault.sentence
    assert "METHOD_FAILED" in service.received("state")[-1].data


@pytest.mark.parametrize("kind", ["surface", "fixed"])
def test_own_contacts_of_known_kinds_are_accepted_if_the_base_is_estimated(kind):
    def brace(model):
        place = placement_of([0.1, 0.0, 0.0])
        if kind == "fixed":
            made = FixedContact("brace", model, "torso_link", place)
        else:
            made = SurfaceContact("brace", model, "torso_link", place, Rectangle(0.02, 0.02))
        made.enabled = False
        return made

    config = wbc.load("g1").replace({"estimation.base_state": "imu"})
    controller = wbc.Controller(config, contacts=[brace], preflight=False)
    topics = controller_endpoints(controller.config.settings, controller.model)
    assert make_loop(controller, MemoryTransport(MemoryBus()), ManualClock(), topics).estimator is not None
    normals = contact_normals(controller.model, controller.contacts)["brace"]
    np.testing.assert_allclose(normals["torso_link"], [0.0, 0.0, 1.0], atol=1e-9)
