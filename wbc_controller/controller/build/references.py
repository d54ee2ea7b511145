"""Construction of reference board and live tuning."""

from collections.abc import Iterable, Mapping
from typing import Any

from wbc_controller.controller.build.estimation import solution_torque_rate
from wbc_controller.controller.build.tasks import make_task
from wbc_controller.inverse_dynamics.limits import JointMotionLimit
from wbc_controller.inverse_dynamics.references.board import BoardPlan, ContactPlan, ReferenceBoard, TaskPlan
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Tuning
from wbc_controller.settings import Settings


def make_tuning(settings: Settings, tasks: Iterable[Task]) -> Tuning:
    """Return the live gains and limits."""
    limits = settings.limits.model_dump(include=set(settings.limits.live))
    return Tuning(gains={task.name: task.gains for task in tasks}, torque_rate=solution_torque_rate(settings), **limits)


def make_board(settings: Settings, qp: WholeBodyQP) -> ReferenceBoard:
    """Build the board of commanded references."""
    return ReferenceBoard(make_board_plan(settings, qp))


def make_board_plan(settings: Settings, qp: WholeBodyQP) -> BoardPlan:
    """Return initial values and ramp times from the (live) settings; those of user objects from their attributes."""
    limits, model = settings.limits, qp.model
    own_tasks = [task for name, task in qp.tasks.items() if name not in settings.tasks]
    configured = [make_task(name, task, model, qp.contacts) for name, task in settings.tasks.items()]
    tuning = make_tuning(settings, [*configured, *own_tasks])
    JointMotionLimit.of(model, tuning, position=limits.position, velocity=limits.velocity)  # raises on invalid limits
    tasks: Mapping[str, Any] = {**settings.tasks, **{task.name: task for task in own_tasks}}
    changeable = {name: contact for name, contact in qp.contacts.items() if not contact.permanent}
    contacts: Mapping[str, Any] = changeable | settings.contacts
    return BoardPlan(
        tasks={
            name: TaskPlan(qp.tasks[name], each.weight, each.enabled, each.setpoint_duration)
            for name, each in tasks.items()
        },
        contacts={name: ContactPlan(each.enabled, each.ramp, qp.contacts[name]) for name, each in contacts.items()},
        weight_ramp=settings.control.weight_ramp,
        tuning=tuning,
        robot_weight=model.mass * model.gravity if model.floating_base else 0.0,
    )
