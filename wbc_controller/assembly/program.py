"""Builds the quadratic program from the settings and a user's own tasks, contacts and limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from wbc_controller.assembly.contacts import make_contact, make_loop_closure
from wbc_controller.assembly.limits import make_self_collision, make_torque_speed
from wbc_controller.assembly.references import make_tuning
from wbc_controller.assembly.tasks import make_task
from wbc_controller.core.contacts import Contact
from wbc_controller.core.limits import JointMotionLimit, RowLimit, TorqueLimit
from wbc_controller.core.program.formulation import Formulation
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.core.solvers.factory import require_solver
from wbc_controller.core.tasks import Task
from wbc_controller.core.whole_body_qp import WholeBodyQP
from wbc_controller.errors import ConfigurationError
from wbc_controller.settings import Settings

_Made = TypeVar("_Made", Task, Contact, RowLimit)


def make_qp(
    settings: Settings,
    model: RobotModel,
    timer: Callable[[], float] = time.perf_counter,
    *,
    tasks: Iterable[Callable[[RobotModel], Task]] = (),
    contacts: Iterable[Callable[[RobotModel], Contact]] = (),
    limits: Iterable[Callable[[RobotModel], RowLimit]] = (),
) -> WholeBodyQP:
    """Build the quadratic program of a robot.

    Args:
        settings: the robot's settings.
        model: the robot's model.
        timer: returns seconds, for the stage times.
        tasks: the user's own tasks, added to those of the settings: classes or functions that take the model and return
            a task.
        contacts: the user's own contacts, given in the same way.
        limits: the user's own limits, given in the same way.

    Raises:
        ConfigurationError: if settings and model do not fit together, or a name is already used.
    """
    require_solver(settings.solver.name)
    own = settings.limits
    configured = {name: make_contact(name, contact, model) for name, contact in settings.contacts.items()}
    all_tasks = [make_task(name, task, model, configured) for name, task in settings.tasks.items()]
    all_tasks += _own(tasks, model, Task, "tasks", list(settings.tasks))
    loops = [make_loop_closure(name, loop, model) for name, loop in settings.loops.items()]
    all_contacts = [*configured.values(), *loops]
    all_contacts += _own(contacts, model, Contact, "contacts", [contact.name for contact in all_contacts])
    row_limits: list[RowLimit] = [make_self_collision(settings, model)] if own.self_collision.enabled else []
    row_limits += _own(limits, model, RowLimit, "limits", [])
    formulation = Formulation(
        model,
        all_tasks,
        all_contacts,
        TorqueLimit(model.effort_limits, own.torque_rate, make_torque_speed(settings, model)),
        JointMotionLimit.of(model, make_tuning(settings, all_tasks), position=own.position, velocity=own.velocity),
        row_limits,
        period=1.0 / settings.control.rate,
        regularization_acceleration=settings.solver.regularization_acceleration,
        regularization_force=settings.solver.regularization_force,
    )
    return WholeBodyQP(formulation, solver=settings.solver.name, timer=timer)


def _own(
    makers: Iterable[Callable[[RobotModel], _Made]],
    model: RobotModel,
    kind: Any,
    key: str,
    taken: Sequence[str],
) -> list[_Made]:
    """Make the user's own objects, and check that each has the right class and a unique name."""
    made: list[_Made] = []
    for make in makers:
        one = make(model)
        if not isinstance(one, kind):
            raise ConfigurationError(
                f"{key}: {make!r} made a {type(one).__name__}; it must make a {kind.__name__} when it is called with "
                "the robot's model"
            )
        name = getattr(one, "name", None)
        if name is not None and name in (*taken, *(other.name for other in made if not isinstance(other, RowLimit))):
            raise ConfigurationError(f"{key}: the name {name!r} stands twice; give each of them one of its own")
        made.append(one)
    return made
