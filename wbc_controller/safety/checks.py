"""Safety checks as pure functions: each returns a fault, or None if the check passes.

All comparisons are written so that NaN fails them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array, Fault

#: Share of an effort limit by which a solver may exceed the available torque; the supervisor clips the excess.
TORQUE_TOLERANCE = 0.01


@dataclass(frozen=True, slots=True)
class Check:
    """One check of the supervisor, for the table in docs/safety.md.

    Attributes:
        code: code of the fault.
        what: what is checked.
        limits: the keys of the configuration that hold its thresholds.
        unit: their unit.
        response: what follows.
        test: the test that shows it, as ``<file>::<function>`` in test/.
    """

    code: str
    what: str
    limits: tuple[str, ...]
    unit: str
    response: str
    test: str


_DAMPS = "damping"
_STATES, _SUPERVISOR = "safety/test_plausibility.py::test_", "safety/test_supervisor.py::test_"
CHECKS = (
    Check("STALE_INPUT", "age of the joint states, and of the odometry or the IMU data", ("safety.state_timeout",), "s",
          _DAMPS, "safety/test_checks.py::test_an_input_over_the_limit_is_named_with_its_age"),
    Check("STALE_INPUT", "age of the states by synchronized clocks", ("safety.synchronized_clocks",), "none", _DAMPS,
          "nodes/test_clock.py::test_with_synchronized_clocks_a_constant_latency_does_not_activate"),
    Check("STALE_INPUT", "stamps ahead of this computer's clock, with synchronized clocks",
          ("safety.clock_tolerance",), "s", "the message is refused",
          "nodes/test_clock.py::test_clocks_that_part_are_a_fault_that_says_by_how_much"),
    Check("ESTIMATE_LOST", "the estimated base: finite, its slowest contact below 0.12 m/s", (), "m/s", _DAMPS,
          "nodes/test_base_from_imu.py::test_an_imu_that_contradicts_all_contacts_is_a_fault_with_the_size"),
    Check("IMPLAUSIBLE_STATE", "magnitude of joint positions and base coordinates", ("safety.max_magnitude",),
          "rad, m", _DAMPS, _STATES + "positions_that_no_robot_has_are_a_fault_and_are_not_compared_with"),
    Check("IMPLAUSIBLE_STATE", "speeds of the joints and the base",
          ("safety.max_joint_speed", "safety.max_base_speed", "safety.max_base_turn"),
          "velocity limits, m/s, rad/s", _DAMPS, _STATES + "velocities_that_no_robot_has_are_a_fault"),
    Check("IMPLAUSIBLE_STATE", "joint positions against joint velocities", ("safety.joint_mismatch",), "rad", _DAMPS,
          _STATES + "a_joint_that_jumps_is_named"),
    Check("IMPLAUSIBLE_STATE", "a joint position that repeats against its velocity", ("safety.frozen_motion",), "rad",
          _DAMPS, _STATES + "a_joint_whose_position_is_dead_is_named"),
    Check("IMPLAUSIBLE_STATE", "joint states or odometry that repeat bit for bit while moving", ("safety.frozen_time",),
          "s", _DAMPS, _STATES + "values_that_are_frozen_under_fresh_stamps_are_named"),
    Check("IMPLAUSIBLE_STATE", "position of the base against its velocity", ("safety.base_mismatch",), "m", _DAMPS,
          _STATES + "odometry_that_jumps_is_a_fault"),
    Check("IMPLAUSIBLE_STATE", "orientation of the base against its angular velocity", ("safety.base_turn_mismatch",),
          "rad", _DAMPS, _STATES + "an_orientation_that_jumps_is_a_fault"),
    Check("FALLEN", "tilt of a floating base since the activation", ("safety.max_tilt",), "rad", _DAMPS,
          _STATES + "a_base_that_tilts_too_far_has_fallen"),
    Check("FALLEN", "height of a floating base above the lowest end of a limb", ("safety.min_height",),
          "share of that at the activation", _DAMPS, _STATES + "a_base_that_sinks_between_its_limbs_has_fallen"),
    Check("NO_SOLUTION", "time without a usable solution, without interruption or in all",
          ("safety.hold_time", "safety.hold_window"), "s", "holding, then damping",
          _STATES + "single_solutions_do_not_renew_the_time_for_holding"),
    Check("BAD_TORQUE", "the solution's torques: finite, and within their limits", ("robot.effort_limit_scale",),
          "share of the effort limits", "holding, then damping",
          _SUPERVISOR + "torques_that_are_not_usable_never_leave"),
    Check("RELAXED", "time with relaxed constraints", ("safety.relax_time", "safety.relax_window"), "s", _DAMPS,
          _STATES + "relaxed_for_too_long_is_a_fault_that_names_what_was_relaxed"),
    Check("", "change of the torques in time", ("limits.torque_rate",), "effort limits per second",
          "the command is clipped", _STATES + "the_torque_rate_is_per_second_however_often_the_states_come"),
    Check("", "joint velocities that damping uses", ("safety.max_joint_speed",), "velocity limits",
          "no damping at that joint", _STATES + "a_velocity_that_no_joint_has_is_not_damped_and_the_others_are"),
    Check("", "damping in discrete time", ("safety.damping", "control.rate"), "N·m·s/rad, Hz",
          "less damping at light joints", _STATES + "damping_changes_no_velocity_s_sign_whatever_is_configured"),
    Check("", "other nodes that publish torques", ("safety.torque_publishers",), "names",
          "`activate` is refused; a warning while active",
          "nodes/test_loop.py::test_while_another_node_publishes_torques_activation_is_refused"),
)  # fmt: skip


def checks_table() -> str:
    """The table of all checks, as Markdown."""
    rows = ["| Checked | Threshold | Unit | Response | Code | Test in `test/` |", "|---|---|---|---|---|---|"]
    for check in CHECKS:
        limits, code = (
            ", ".join(f"`{key}`" for key in check.limits) or "fixed",
            f"`{check.code}`" if check.code else "none",
        )
        file, _, test = check.test.partition("::")
        rows.append(f"| {check.what} | {limits} | {check.unit} | {check.response} | {code} | `{file}`: `{test}` |")
    return "\n".join(rows) + "\n"


def stale_inputs(
    ages: Mapping[str, float], limit: float, notes: Callable[[], Mapping[str, str]] = dict
) -> Fault | None:
    """Check that no input is older than a limit.

    Args:
        ages: age of each input, s; infinite where none has arrived.
        limit: largest allowed age, s.
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
        actuators: names, (na,).
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
        limit: largest such time, s.
        window: s.
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
        limit: largest such time, s.
        window: s.
    """
    if spent <= limit:
        return None
    return Fault(
        "RELAXED",
        f"{', '.join(groups)} had to be relaxed for {1e3 * spent:.0f} ms within {window:g} s "
        f"(limit {1e3 * limit:.0f} ms, safety.relax_time)",
    )
