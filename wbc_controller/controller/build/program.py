"""Construction of the quadratic program."""

import time
from collections.abc import Callable, Iterable

from wbc_controller.controller.build.contacts import make_contact, make_loop_closure
from wbc_controller.controller.build.limits import make_self_collision, make_torque_speed
from wbc_controller.controller.build.references import make_tuning
from wbc_controller.controller.build.tasks import make_task
from wbc_controller.controller.build.user_objects import evaluate_methods, make_user_objects
from wbc_controller.controller.build.walking import make_walking_tasks
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, RowLimit, TorqueLimit
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.solvers.factory import require_solver
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings


def make_qp(
    settings: Settings,
    model: RobotModel,
    timer: Callable[[], float] = time.perf_counter,
    *,
    tasks: Iterable[Callable[[RobotModel], Task]] = (),
    contacts: Iterable[Callable[[RobotModel], Contact]] = (),
    limits: Iterable[Callable[[RobotModel], RowLimit]] = (),
) -> WholeBodyQP:
    """Build the quadratic program; arguments as in `ControlCycle`."""
    require_solver(settings.solver.name)
    own = settings.limits
    configured = {name: make_contact(name, contact, model) for name, contact in settings.contacts.items()}
    all_tasks = [make_task(name, task, model, configured) for name, task in settings.tasks.items()]
    all_tasks += make_walking_tasks(settings, model)
    own_tasks = make_user_objects(tasks, model, Task, "tasks", [task.name for task in all_tasks])
    all_tasks += own_tasks
    loops = [make_loop_closure(name, loop, model) for name, loop in settings.loops.items()]
    all_contacts = [*configured.values(), *loops]
    own_contacts = make_user_objects(contacts, model, Contact, "contacts", [contact.name for contact in all_contacts])
    all_contacts += own_contacts
    row_limits: list[RowLimit] = [make_self_collision(settings, model)] if own.self_collision.enabled else []
    own_limits = make_user_objects(limits, model, RowLimit, "limits", [])
    row_limits += own_limits
    tuning = make_tuning(settings, all_tasks)
    formulation = Formulation(
        model,
        all_tasks,
        all_contacts,
        TorqueLimit(model.effort_limits, tuning.torque_rate, make_torque_speed(settings, model)),
        JointMotionLimit.of(model, tuning, position=own.position, velocity=own.velocity),
        row_limits,
        period=1.0 / settings.control.rate,
        regularization_acceleration=settings.solver.regularization_acceleration,
        regularization_force=settings.solver.regularization_force,
    )
    evaluate_methods(formulation, own_tasks, own_contacts, own_limits)
    return WholeBodyQP(formulation, solver=settings.solver.name, timer=timer)
