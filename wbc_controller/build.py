"""From settings to objects."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from wbc_controller import settings as schema
from wbc_controller.build_contacts import make_contact, make_contact_plan, make_loop_closure
from wbc_controller.build_tasks import make_task
from wbc_controller.clock import Clock
from wbc_controller.collision_model import build_collision_model
from wbc_controller.core.controller import Controller
from wbc_controller.core.formulation import Formulation
from wbc_controller.core.from_urdf import build_model
from wbc_controller.core.limits import JointMotionLimit, SelfCollisionLimit, TorqueLimit, TorqueSpeedCurve
from wbc_controller.core.model import RobotModel
from wbc_controller.core.passive import PassiveJoint
from wbc_controller.core.references import BoardPlan, ReferenceBoard, TaskPlan
from wbc_controller.core.solvers.factory import require_solver
from wbc_controller.core.tasks import Task
from wbc_controller.decoding import Vocabulary
from wbc_controller.diagnostics.audit import AuditLimits, ModelAudit
from wbc_controller.diagnostics.markers import MarkerScene
from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.inputs import Inputs
from wbc_controller.interface import CONTROLLER_TOPICS, Endpoint, endpoints
from wbc_controller.loop import ControlLoop
from wbc_controller.outputs import Outputs
from wbc_controller.records import Array, CycleReport, Tuning, frozen
from wbc_controller.resources import locate
from wbc_controller.robot_description import read_urdf, transmissions
from wbc_controller.safety.supervisor import Supervisor, SupervisorLimits
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.transports.transport import Transport
from wbc_controller.tuner import LivePart, Tuner

_log = logging.getLogger(__name__)


def make_model(settings: Settings, urdf: str | None = None) -> RobotModel:
    """Build the robot's model.

    Args:
        settings: the robot's settings.
        urdf: the URDF's text, where it did not come from the settings.

    Raises:
        ConfigurationError: where the URDF and the settings do not fit.
    """
    robot = settings.robot
    return build_model(
        read_urdf(robot.urdf) if urdf is None else urdf,
        robot.joints,
        robot.posture,
        floating_base=robot.base == "floating",
        armature=robot.armature,
        effort_limit_scale=robot.effort_limit_scale,
        actuators=robot.actuators,
        transmission=transmissions(robot),
        passive_joints={
            name: PassiveJoint(joint.stiffness, joint.damping, joint.rest)
            for name, joint in robot.passive_joints.items()
        },
        locked_joints=robot.locked_joints,
        commanded_by_joint=robot.command == "joints",
    )


def make_torque_speed(settings: Settings, model: RobotModel) -> TorqueSpeedCurve | None:
    """Build the torque-speed curve of the motors; None where it is not to be held.

    Raises:
        ConfigurationError: where an actuator is unknown, or a transmission has no speeds.
    """
    curve = settings.limits.torque_speed
    if not curve.enabled:
        return None
    for name in curve.actuators:
        if name not in model.actuators:
            raise ConfigurationError(
                f"limits.torque_speed.actuators: {name!r} is no actuator; {valid_choices(name, model.actuators)}"
            )
    limits = dict(zip(model.joints, model.velocity_limits.tolist(), strict=True))
    corner, no_load = [], []
    for name in model.actuators:
        own = curve.actuators.get(name)
        if own is None and name in settings.robot.transmission:
            raise ConfigurationError(
                f"limits.torque_speed.actuators: {name!r} of robot.transmission needs a corner and a no_load of its "
                "own, as the URDF's velocity limits are those of joints"
            )
        corner.append(own.corner if own is not None else curve.corner * limits[name])
        no_load.append(own.no_load if own is not None else curve.no_load * limits[name])
    return TorqueSpeedCurve(frozen(corner), frozen(no_load))


def make_self_collision(settings: Settings, model: RobotModel) -> SelfCollisionLimit:
    """Build the limit that keeps links apart; says in the log which pairs it does not.

    Raises:
        ConfigurationError: where the URDF, its meshes or the SRDF cannot be used.
    """
    own = settings.limits.self_collision
    srdf = None
    if own.srdf:
        srdf = locate(own.srdf, "limits.self_collision.srdf").read_text(encoding="utf-8")
    collision = build_collision_model(
        model,
        margin=own.margin,
        srdf=srdf,
        pairs=own.pairs,
        visual=own.visual,
        folder=locate(settings.robot.urdf).parent if settings.robot.urdf else None,
    )
    _log.info("self-collision: %s", collision.summary)
    return SelfCollisionLimit(
        model,
        collision.geometry,
        margin=own.margin,
        acceleration=own.acceleration,
        horizon=own.horizon,
        max_pairs=own.max_pairs,
        summary=collision.summary,
    )


def make_controller(
    settings: Settings, model: RobotModel, timer: Callable[[], float] = time.perf_counter
) -> Controller:
    """Build the controller of a robot.

    Args:
        settings: the robot's settings.
        model: the robot's model.
        timer: gives seconds, for the stage times.

    Raises:
        ConfigurationError: where settings and model do not fit.
    """
    require_solver(settings.solver.name)
    limits = settings.limits
    contacts = {name: make_contact(name, contact, model) for name, contact in settings.contacts.items()}
    tasks = [make_task(name, task, model, contacts) for name, task in settings.tasks.items()]
    formulation = Formulation(
        model,
        tasks,
        [*contacts.values(), *(make_loop_closure(name, loop, model) for name, loop in settings.loops.items())],
        TorqueLimit(model.effort_limits, limits.torque_rate, make_torque_speed(settings, model)),
        JointMotionLimit.of(model, make_tuning(settings, tasks), position=limits.position, velocity=limits.velocity),
        [make_self_collision(settings, model)] if limits.self_collision.enabled else [],
        period=1.0 / settings.control.rate,
        regularization_acceleration=settings.solver.regularization_acceleration,
        regularization_force=settings.solver.regularization_force,
    )
    return Controller(formulation, solver=settings.solver.name, timer=timer)


def make_tuning(settings: Settings, tasks: Iterable[Task]) -> Tuning:
    """Collect the gains and limits that can be changed while the controller runs."""
    limits = settings.limits
    return Tuning(
        gains={task.name: task.gains for task in tasks},
        position_margin=limits.position_margin,
        position_horizon=limits.position_horizon,
        velocity_scale=limits.velocity_scale,
        acceleration=limits.acceleration,
        torque_rate=limits.torque_rate,
    )


def make_board(settings: Settings, controller: Controller) -> ReferenceBoard:
    """Build the board that holds what the commands set."""
    return ReferenceBoard(make_live_part(settings, controller).board)


def make_supervisor(settings: Settings, model: RobotModel) -> Supervisor:
    """Build the safety supervisor."""
    return Supervisor(model, make_supervisor_limits(settings, model))


def make_supervisor_limits(settings: Settings, model: RobotModel) -> SupervisorLimits:
    """Collect what the supervisor holds."""
    safety = settings.safety
    return SupervisorLimits(
        activation_ramp=safety.activation_ramp,
        hold_time=safety.hold_time,
        damping_time=safety.damping_time,
        damping=safety.damping,
        torque_rate=settings.limits.torque_rate,
        period=1.0 / settings.control.rate,
        torque_speed=make_torque_speed(settings, model),
    )


def make_live_part(settings: Settings, controller: Controller) -> LivePart:
    """Collect what of the settings can be changed while a controller runs.

    Raises:
        ConfigurationError: where settings and model do not fit.
    """
    limits, model = settings.limits, controller.model
    tuning = make_tuning(
        settings, [make_task(name, task, model, controller.contacts) for name, task in settings.tasks.items()]
    )
    JointMotionLimit.of(model, tuning, position=limits.position, velocity=limits.velocity)  # raises what is wrong
    plan = BoardPlan(
        tasks={
            name: TaskPlan(controller.tasks[name], task.weight, task.enabled, task.setpoint_duration)
            for name, task in settings.tasks.items()
        },
        contacts={
            name: make_contact_plan(contact, controller.contacts[name]) for name, contact in settings.contacts.items()
        },
        weight_ramp=settings.control.weight_ramp,
        tuning=tuning,
    )
    return LivePart(plan, make_supervisor_limits(settings, model), settings.safety.state_timeout)


def joint_efforts(model: RobotModel) -> Array:
    """The largest torque that the actuators can give at each joint, (nj,) in N·m.

    At a joint that none drives it is the median of the others: what there is to measure its torques against.
    """
    efforts = np.asarray(model.effort_limits @ np.abs(model.actuation.ratios))
    driven = efforts > 0.0
    return np.where(driven, efforts, np.median(efforts[driven]))


def make_audit(settings: Settings, controller: Controller) -> ModelAudit:
    """Build the live audit of the model."""
    audit, model = settings.audit, controller.model
    limits = AuditLimits(
        time_constant=audit.time_constant,
        patience=audit.patience,
        energy=audit.energy,
        power=audit.power,
        force=audit.force * model.mass * model.gravity,
        torques=audit.torque * joint_efforts(model),
        period=1.0 / settings.control.rate,
    )
    return ModelAudit(model, controller.contacts, limits)


def make_vocabulary(settings: Settings, model: RobotModel) -> Vocabulary:
    """Collect the names that messages are checked against."""
    kinds = {name: task.type for name, task in settings.tasks.items()}
    joints = {
        name: tuple(task.joints) or model.driven_joints
        for name, task in settings.tasks.items()
        if isinstance(task, schema.PostureTask | schema.TorqueTask)
    }
    reference_frames = {
        name: task.reference_frame for name, task in settings.tasks.items() if isinstance(task, schema.RelativePoseTask)
    }
    for name, task in settings.tasks.items():
        if isinstance(task, schema.ContactWrenchTask):
            contact = settings.contacts[task.contact]
            whole = isinstance(contact, schema.SurfaceContact | schema.FixedContact)
            frame = contact.frame if whole else contact.against  # the forces of others on the world are in its axes
            if frame is not None:
                reference_frames[name] = frame
    return Vocabulary(kinds, joints, tuple(settings.contacts), wrench_frames(settings, model), reference_frames)


def wrench_frames(settings: Settings, model: RobotModel) -> tuple[str, ...]:
    """Frames on which external wrenches are accepted: the base, and every frame that a task or contact names."""
    named = [task.frame for task in settings.tasks.values() if hasattr(task, "frame")]
    named += [contact.frame for contact in settings.contacts.values()]
    return tuple(dict.fromkeys([model.base_link, *named]))


def controller_endpoints(
    settings: Settings,
    model: RobotModel,
    *,
    node: str = NODE_NAME,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> list[Endpoint]:
    """Expand the controller's topic table for one robot."""
    return list(
        endpoints(
            CONTROLLER_TOPICS,
            node,
            task_kinds={name: task.type for name, task in settings.tasks.items()},
            contacts=settings.contacts,
            frames=wrench_frames(settings, model),
            namespace=namespace,
            remappings=remappings,
        )
    )


def make_loop(
    settings: Settings,
    model: RobotModel,
    transport: Transport,
    clock: Clock,
    topics: Sequence[Endpoint],
    *,
    timer: Callable[[], float] = time.perf_counter,
    observers: Sequence[Callable[[CycleReport], None]] = (),
    node: str = NODE_NAME,
) -> ControlLoop:
    """Build the whole service on a transport.

    Args:
        settings: the robot's settings.
        model: the robot's model.
        transport: carries the messages.
        clock: measures ages and durations.
        topics: from `controller_endpoints`.
        timer: gives seconds, for the stage times.
        observers: called with the report of every cycle.
        node: name of the node with its namespace, for diagnostics.

    Raises:
        ConfigurationError: where settings and model do not fit.
    """
    controller = make_controller(settings, model, timer)
    published = {name: controller.contacts[name] for name in settings.contacts}
    markers_period = 1.0 / settings.control.markers_rate if settings.control.markers_rate > 0.0 else math.inf
    return ControlLoop(
        controller,
        make_board(settings, controller),
        make_supervisor(settings, model),
        Inputs(model, make_vocabulary(settings, model), topics, transport, clock),
        Outputs(
            model,
            published,
            topics,
            transport,
            1.0 / settings.control.diagnostics_rate,
            MarkerScene(model, controller.tasks, controller.contacts, 3.0 * markers_period),
            markers_period,
            node,
        ),
        make_audit(settings, controller),
        Tuner(settings, partial(make_live_part, controller=controller)),
        clock,
        timer=timer,
        observers=observers,
    )
