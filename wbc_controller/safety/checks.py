"""Safety checks as pure functions: each returns a fault, or None if the check passes.

All comparisons are written so that NaN fails them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from wbc_controller.records import Array, Fault

#: Share of an effort limit by which a solver may exceed the available torque; the supervisor clips the excess.
TORQUE_TOLERANCE = 0.01


class Check(NamedTuple):
    """One check of the supervisor, as in the table of docs/safety.md."""

    name: str
    keys: tuple[str, ...]  # keys of the configuration with its thresholds; empty if they are fixed
    unit: str
    response: str
    code: str = ""  # code of the fault; empty if the check causes none


CHECKS = (
    Check("age of the joint states, and of the odometry or the IMU data", ("safety.state_timeout",), "s", "damping",
          "STALE_INPUT"),
    Check("age of the states by synchronized clocks", ("safety.synchronized_clocks",), "none", "damping",
          "STALE_INPUT"),
    Check("stamps ahead of this computer's clock, with synchronized clocks", ("safety.clock_tolerance",), "s",
          "the message is refused", "STALE_INPUT"),
    Check("the estimated base: finite, its slowest contact below 0.12 m/s", (), "m/s", "damping", "ESTIMATE_LOST"),
    Check("axes and units of the odometry, against its pose and the legs", (), "rad, m",
          "`activate` is refused; damping", "IMPLAUSIBLE_STATE"),
    Check("axes and units of the IMU, against the legs", (), "rad", "`activate` is refused; damping", "ESTIMATE_LOST"),
    Check("magnitude of joint positions and base coordinates", ("safety.max_magnitude",), "rad, m", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("speeds of the joints and the base",
          ("safety.max_joint_speed", "safety.max_base_speed", "safety.max_base_turn"),
          "velocity limits, m/s, rad/s", "damping", "IMPLAUSIBLE_STATE"),
    Check("joint positions against joint velocities", ("safety.joint_mismatch",), "rad", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("a joint position that repeats against its velocity", ("safety.frozen_motion",), "rad", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("joint states or odometry that repeat bit for bit while moving", ("safety.frozen_time",), "s", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("position of the base against its velocity", ("safety.base_mismatch",), "m", "damping", "IMPLAUSIBLE_STATE"),
    Check("orientation of the base against its angular velocity", ("safety.base_turn_mismatch",), "rad", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("joint motion that the torques do not explain, in the first time of active control",
          ("safety.bring_up_time", "safety.bring_up_speed"), "s, rad/s", "zero torque at once", "UNEXPLAINED_MOTION"),
    Check("tilt of a floating base since the activation", ("safety.max_tilt",), "rad", "damping", "FALLEN"),
    Check("height of a floating base above the lowest end of a limb", ("safety.min_height",),
          "share of that at the activation", "damping", "FALLEN"),
    Check("time without a usable solution, without interruption or in all", ("safety.hold_time", "safety.hold_window"),
          "s", "holding, then damping", "NO_SOLUTION"),
    Check("the solution's torques: finite, and within their limits", ("robot.effort_limit_scale",),
          "share of the effort limits", "holding, then damping", "BAD_TORQUE"),
    Check("time with relaxed constraints", ("safety.relax_time", "safety.relax_window"), "s", "damping", "RELAXED"),
    Check("change of the torques in time", ("limits.torque_rate",), "effort limits per second",
          "the command is clipped"),
    Check("joint velocities that damping uses", ("safety.max_joint_speed",), "velocity limits",
          "no damping at that joint"),
    Check("damping in discrete time", ("safety.damping", "control.rate"), "N·m·s/rad, Hz",
          "less damping at light joints"),
    Check("other nodes that publish torques", ("safety.torque_publishers",), "names",
          "`activate` is refused; a warning while active"),
)  # fmt: skip


def stale_inputs(
    ages: Mapping[str, float], limit: float, notes: Callable[[], Mapping[str, str]] = dict
) -> Fault | None:
    """Check that no input is older than a limit.

    Args:
        ages: age of each input, s; infinite where none has arrived.
        notes: gives for inputs what to know about their age; called where one is too old.
    """
    parts = []
    for name, age in ages.items():
        if not (age <= limit):
            said = "has not arrived" if not math.isfinite(age) else f"is {1e3 * age:.0f} ms old"
            note = notes().get(name)
            parts.append(f"{name} {said} (limit {1e3 * limit:.0f} ms)" + (f"; {note}" if note else ""))
    return Fault("STALE_INPUT", "; ".join(parts)) if parts else None


def unusable_torques(
    tau: Array,
    available: tuple[Array, Array],
    limits: Array,
    actuators: Sequence[str],
    tolerance: float = TORQUE_TOLERANCE,
) -> Fault:
    """Name the torques that are not finite or not available.

    Args:
        tau: torques of the actuators, (na,) in N·m.
        available: lower and upper bounds of the torques available at the present speeds, both (na,) in N·m.
        limits: effort limits, (na,) in N·m.
        tolerance: share of an effort limit by which a solver may exceed a bound.
    """
    lower, upper = available
    good = (tau >= lower - tolerance * limits) & (tau <= upper + tolerance * limits)
    bound = np.where(tau < 0.0, -lower, upper)
    worst = [f"{actuators[i]}: {tau[i]:.3g} N·m (limit {bound[i]:.3g})" for i in map(int, np.flatnonzero(~good))]
    return Fault("BAD_TORQUE", "the solution's torques are not usable: " + ", ".join(worst))


def no_solution_for_too_long(reason: Fault, held: float, limit: float, window: float) -> Fault:
    """Say that holding has used up its budget, in pieces.

    Args:
        reason: why there is no solution now.
        held: time of holding within the window, s.
    """
    sentence = (
        f"held the last torques for {1e3 * held:.0f} ms within {window:g} s (limit {1e3 * limit:.0f} ms, "
        f"safety.hold_time): {reason.sentence}"
    )
    return Fault(reason.code, sentence, reason.infeasibility)


def relaxed_for_too_long(groups: Sequence[str], spent: float, limit: float, window: float) -> Fault | None:
    """Check the time with relaxed constraints.

    Args:
        groups: what was relaxed within the window.
        spent: time with relaxed constraints within the window, s.
    """
    if spent <= limit:
        return None
    return Fault(
        "RELAXED",
        f"{', '.join(groups)} had to be relaxed for {1e3 * spent:.0f} ms within {window:g} s "
        f"(limit {1e3 * limit:.0f} ms, safety.relax_time)",
    )
