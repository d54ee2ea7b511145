"""Safety checks: a fault or None; NaN fails."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from wbc_controller.records import Array, Fault

#: Share of an effort limit by which a solution may exceed the available torque, before clipping.
TORQUE_TOLERANCE = 0.01


class Check(NamedTuple):
    """Row of the table of checks in docs/safety.md."""

    name: str
    keys: tuple[str, ...]  # settings of its thresholds; empty if fixed
    unit: str
    response: str
    code: str = ""  # code of the fault; empty without a fault


CHECKS = (
    Check("age of the joint states, and of the odometry or the IMU data", ("safety.state_timeout",), "s", "damping",
          "STALE_INPUT"),
    Check("age of the states by synchronized clocks", ("safety.synchronized_clocks",), "none", "damping",
          "STALE_INPUT"),
    Check("stamps ahead of this computer's clock, with synchronized clocks", ("safety.clock_tolerance",), "s",
          "the message is refused", "STALE_INPUT"),
    Check("the estimated base: finite, its slowest contact below 0.1 m/s", (), "m/s", "damping", "ESTIMATE_LOST"),
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
    Check("a constant joint position against its velocity", ("safety.frozen_motion",), "rad", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("joint states or odometry repeated bit for bit during motion", ("safety.frozen_time",), "s", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("position of the base against its velocity", ("safety.base_mismatch",), "m", "damping", "IMPLAUSIBLE_STATE"),
    Check("orientation of the base against its angular velocity", ("safety.base_turn_mismatch",), "rad", "damping",
          "IMPLAUSIBLE_STATE"),
    Check("joint motion not explained by the torques, at the start of active control",
          ("safety.bring_up_time", "safety.bring_up_speed"), "s, rad/s", "zero torque at once", "UNEXPLAINED_MOTION"),
    Check("tilt of a floating base since the activation", ("safety.max_tilt",), "rad", "damping", "FALLEN"),
    Check("height of a floating base above the lowest end of a limb", ("safety.min_height",),
          "share of the height at the activation", "damping", "FALLEN"),
    Check("distance of the capture point from the support of a biped that walks or can walk", (), "m", "damping",
          "FALLING"),
    Check("time without a usable solution, continuous or in total", ("safety.hold_time", "safety.hold_window"),
          "s", "holding, then damping", "NO_SOLUTION"),
    Check("the solution's torques: finite, and within their limits", ("robot.effort_limit_scale",),
          "share of the effort limits", "holding, then damping", "BAD_TORQUE"),
    Check("time with relaxed constraints", ("safety.relax_time", "safety.relax_window"), "s", "damping", "RELAXED"),
    Check("change of the torques in time", ("limits.torque_rate",), "effort limits per second",
          "the command is clipped"),
    Check("joint velocities used for damping", ("safety.max_joint_speed",), "velocity limits",
          "no damping at that joint"),
    Check("damping in discrete time", ("safety.damping", "control.rate"), "N·m·s/rad, Hz",
          "less damping at light joints"),
    Check("other publishers of torques", ("safety.torque_publishers",), "names",
          "`activate` is refused; a warning while active"),
)  # fmt: skip


def stale_inputs(
    ages: Mapping[str, float], limit: float, notes: Callable[[], Mapping[str, str]] = dict
) -> Fault | None:
    """Check ages of inputs, s (inf before the first); `notes` returns remarks by input."""
    parts = []
    for name, age in ages.items():
        if not (age <= limit):
            text = "has not arrived" if not math.isfinite(age) else f"is {1e3 * age:.0f} ms old"
            note = notes().get(name)
            parts.append(f"{name} {text} (limit {1e3 * limit:.0f} ms)" + (f"; {note}" if note else ""))
    return Fault("STALE_INPUT", "; ".join(parts)) if parts else None


def unusable_torques(
    tau: Array,
    available: tuple[Array, Array],
    limits: Array,
    actuators: Sequence[str],
    tolerance: float = TORQUE_TOLERANCE,
) -> Fault:
    """Return the fault of torques that are not finite or exceed the bounds, (na,) in N·m."""
    lower, upper = available
    good = (tau >= lower - tolerance * limits) & (tau <= upper + tolerance * limits)
    bound = np.where(tau < 0.0, -lower, upper)
    worst = [f"{actuators[i]}: {tau[i]:.3g} N·m (limit {bound[i]:.3g})" for i in map(int, np.flatnonzero(~good))]
    return Fault("BAD_TORQUE", "the solution's torques are not usable: " + ", ".join(worst))


def no_solution_for_too_long(reason: Fault, held: float, limit: float, window: float) -> Fault:
    """Return the fault of holding for `held`, s, in total within a window."""
    sentence = (
        f"held the last torques for {1e3 * held:.0f} ms within {window:g} s (limit {1e3 * limit:.0f} ms, "
        f"safety.hold_time): {reason.sentence}"
    )
    return Fault(reason.code, sentence, reason.infeasibility)


def relaxed_for_too_long(groups: Sequence[str], spent: float, limit: float, window: float) -> Fault | None:
    """Check the time with relaxed constraints within a window, `spent`, s; `groups` names the relaxed ones."""
    if spent <= limit:
        return None
    return Fault(
        "RELAXED",
        f"{', '.join(groups)}: relaxed for {1e3 * spent:.0f} ms within {window:g} s "
        f"(limit {1e3 * limit:.0f} ms, safety.relax_time)",
    )
