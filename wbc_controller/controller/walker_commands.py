"""Walking in the control cycle: preparation and commands."""

from dataclasses import replace

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references.board import BoardPlan, ReferenceBoard
from wbc_controller.inverse_dynamics.references.changes import WalkFootsteps, WalkingChange, WalkTo
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import RobotState, frozen
from wbc_controller.walking.footsteps import Goal, Velocity
from wbc_controller.walking.walker import Walker


def prepare_gait(walker: Walker, qp: WholeBodyQP, plan: BoardPlan) -> None:
    """Prepare the quadratic programs of a gait: a first step must not be late."""
    model, board = qp.model, ReferenceBoard(plan)
    state = RobotState(0, frozen(model.configuration(model.posture)), frozen(np.zeros(model.nv)))
    board.reset(qp.dynamics, 0.0)
    standing = board.sample(0.0)
    begins = {**standing.weights, **{name: board.plans[name].weight for name in walker.tasks.own}}
    walks = {**begins, **dict.fromkeys(walker.tasks.suspended, 0.0)}
    both = dict.fromkeys(standing.contacts, 0.0) | dict.fromkeys(walker.contact_sets[0], 1.0)
    qp.prepare(state, replace(standing, weights=begins, contacts=both))
    for names in walker.contact_sets:
        contacts = {name: float(name in names) for name in standing.contacts}
        qp.prepare(state, replace(standing, weights=walks, contacts=contacts))


def command_walker(walker: Walker | None, change: WalkingChange, dynamics: Dynamics, until: float) -> None:
    """Pass a command to the walker, or raise `InputRefused`; a streamed velocity ends at the time `until`, s."""
    if walker is None:
        raise InputRefused("this robot cannot walk: its configuration has no section 'walking'")
    if isinstance(change, WalkTo):
        x, y, heading = change.pose.tolist()
        walker.go(Goal(complex(x, y), heading))
    elif isinstance(change, WalkFootsteps):
        walker.follow(change.poses, dynamics)
    elif change.velocity is None:
        walker.ask(None, until if change.streamed else np.inf)
    else:
        forward, sideways, turning = change.velocity.tolist()
        walker.ask(Velocity(complex(forward, sideways), turning), until if change.streamed else np.inf)
