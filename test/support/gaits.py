"""A biped's gait, and walks of simulated robots."""

import math

import numpy as np

import wbc_controller as wbc
from wbc_controller.recording.report.run_data import heading, mean_velocity
from wbc_controller.walking.gait import Gait

GAIT = Gait(
    single=0.5, double=0.1, shift=0.8, height=0.7, lowering=0.02, clearance=0.05, rough_clearance=0.1,
    width=0.2, least_width=0.14, length=0.45, greatest_width=0.55, sole_length=0.2, sole_width=0.08, reaction=0.08,
    speed=(0.5, 0.2, 0.5),
)  # fmt: skip


def simulated(robot, changes=None):
    """Return the simulation of a robot with some settings changed, its controller and its walker."""
    simulation = wbc.Simulation(wbc.load(robot).replace(changes or {}))
    return simulation, simulation.controller, simulation.controller.walker


def walking(robot, *velocity, seconds, changes=None):
    """Return `simulated` after a walk by a velocity for some seconds."""
    simulation, controller, walker = simulated(robot, changes)
    controller.walk(*velocity)
    simulation.run(seconds)
    return simulation, controller, walker


def velocity_of(results):
    """Return the mean velocity forward, sideways and turning in a part of a walk, (3,) in m/s and rad/s."""
    way = np.array([[result.time, *result.state.q[:2], heading(result.state.q)] for result in results])
    return mean_velocity(way, 0.0, math.inf)


def run_to(simulation, phase, step=0.002):
    """Run until the walker is in a phase."""
    while simulation.controller.walker.phase is not phase:
        simulation.run(step)
