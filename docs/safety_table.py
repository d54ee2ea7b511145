"""Table of the supervisor's checks, printed for docs/safety.md."""

from typing import NamedTuple


class Check(NamedTuple):
    """Check of the supervisor."""

    name: str
    keys: tuple[str, ...]  # settings of its thresholds; empty if fixed
    unit: str
    response: str
    code: str  # code of the fault; empty without a fault
    test: str  # ``<file>::<function>`` in test/


CHECKS = (
    Check("age of the joint states, and of the odometry or the IMU data", ("safety.state_timeout",), "s", "damping",
          "STALE_INPUT", "safety/test_checks.py::test_an_input_over_the_limit_is_named_with_its_age"),
    Check("age of the states by synchronized clocks", ("safety.synchronized_clocks",), "none", "damping", "STALE_INPUT",
          "nodes/test_clock.py::test_only_with_synchronized_clocks_a_constant_latency_prevents_the_activation"),
    Check("stamps ahead of this computer's clock, with synchronized clocks", ("safety.clock_tolerance",), "s",
          "the message is refused", "STALE_INPUT",
          "nodes/test_clock.py::test_clocks_that_part_are_a_fault_that_says_by_how_much"),
    Check("the estimated base: finite, a contact point below 0.1 m/s, while walking 0.3", (), "m/s", "damping",
          "ESTIMATE_LOST",
          "nodes/test_base_from_imu.py::test_an_imu_that_contradicts_all_contacts_is_a_fault_with_the_size"),
    Check("axes and units of the odometry, against its pose and the legs", (), "rad, m",
          "`activate` is refused; damping", "IMPLAUSIBLE_STATE",
          "integration/test_wrong_sensor_axes.py::test_the_wrong_axis_or_unit_is_named"),
    Check("axes and units of the IMU, against the legs", (), "rad", "`activate` is refused; damping", "ESTIMATE_LOST",
          "integration/test_wrong_sensor_axes.py::test_the_wrong_axis_or_unit_is_named"),
    Check("magnitude of joint positions and base coordinates", ("safety.max_magnitude",), "rad, m", "damping",
          "IMPLAUSIBLE_STATE", "safety/test_plausibility.py::test_positions_out_of_range"),
    Check("speeds of the joints and the base",
          ("safety.max_joint_speed", "safety.max_base_speed", "safety.max_base_turn"), "velocity limits, m/s, rad/s",
          "damping", "IMPLAUSIBLE_STATE", "safety/test_plausibility.py::test_velocities_out_of_range"),
    Check("joint positions against joint velocities", ("safety.joint_mismatch",), "rad", "damping", "IMPLAUSIBLE_STATE",
          "safety/test_plausibility.py::test_a_joint_that_jumps_is_named"),
    Check("a constant joint position against its velocity", ("safety.frozen_motion",), "rad", "damping",
          "IMPLAUSIBLE_STATE", "safety/test_plausibility.py::test_a_joint_whose_velocity_or_position_is_dead_is_named"),
    Check("joint states or odometry repeated bit for bit during motion", ("safety.frozen_time",), "s", "damping",
          "IMPLAUSIBLE_STATE", "safety/test_plausibility.py::test_values_that_are_frozen_under_fresh_stamps_are_named"),
    Check("position of the base against its velocity", ("safety.base_mismatch",), "m", "damping", "IMPLAUSIBLE_STATE",
          "safety/test_plausibility.py::test_odometry_that_jumps_is_a_fault"),
    Check("orientation of the base against its angular velocity", ("safety.base_turn_mismatch",), "rad", "damping",
          "IMPLAUSIBLE_STATE", "safety/test_plausibility.py::test_odometry_that_jumps_is_a_fault"),
    Check("joint motion not explained by the torques, at the start of active control",
          ("safety.bring_up_time", "safety.bring_up_speed"), "s, rad/s", "zero torque at once", "UNEXPLAINED_MOTION",
          "nodes/test_bring_up.py::test_torques_at_wrong_joints_stop_the_robot_and_name_a_joint"),
    Check("tilt of a floating base since the activation", ("safety.max_tilt",), "rad", "damping", "FALLEN",
          "safety/test_plausibility.py::test_a_base_that_tilts_too_far_has_fallen"),
    Check("height of a floating base above the lowest end of a limb", ("safety.min_height",),
          "share of the height at the activation", "damping", "FALLEN",
          "safety/test_plausibility.py::test_a_base_that_sinks_between_its_limbs_has_fallen"),
    Check("distance of the capture point from the support of a biped that walks or can walk", (), "m", "damping",
          "FALLING",
          "walking/test_fall.py::test_the_fall_of_a_standing_robot_is_predicted_before_it_reaches_the_ground"),
    Check("time without a usable solution, continuous or in total", ("safety.hold_time", "safety.hold_window"), "s",
          "holding, then damping", "NO_SOLUTION",
          "safety/test_plausibility.py::test_single_solutions_do_not_renew_the_time_for_holding"),
    Check("the solution's torques: finite, and within their limits", ("robot.effort_limit_scale",),
          "share of the effort limits", "holding, then damping", "BAD_TORQUE",
          "safety/test_supervisor.py::test_torques_that_are_not_usable_never_leave"),
    Check("time with relaxed constraints", ("safety.relax_time", "safety.relax_window"), "s", "damping", "RELAXED",
          "safety/test_plausibility.py::test_relaxed_for_too_long_is_a_fault_that_names_what_was_relaxed"),
    Check("change of the torques in time", ("limits.torque_rate",), "effort limits per second",
          "the command is clipped", "",
          "safety/test_plausibility.py::test_the_torque_rate_is_per_second_however_often_the_states_come"),
    Check("joint velocities used for damping", ("safety.max_joint_speed",), "velocity limits",
          "no damping at that joint", "",
          "safety/test_plausibility.py::test_plausible_velocities_are_damped_as_a_sampled_loop_can_bear"),
    Check("damping in discrete time", ("safety.damping", "control.rate"), "N·m·s/rad, Hz",
          "less damping at light joints", "",
          "safety/test_damping.py::test_damping_is_stable_in_all_postures_with_one_more_period_of_delay"),
    Check("other publishers of torques", ("safety.torque_publishers",), "names",
          "`activate` is refused; a warning while active", "",
          "nodes/test_loop.py::test_while_another_node_publishes_torques_activation_is_refused"),
)  # fmt: skip


def safety_table() -> str:
    """Return the table as Markdown."""
    rows = ["| Checked | Threshold | Response | Code |", "|---|---|---|---|"]
    for check in CHECKS:
        keys = ", ".join(f"`{key}`" for key in check.keys) or "fixed"
        unit = f" ({check.unit})" if check.unit != "none" else ""
        code = f"`{check.code}`" if check.code else "none"
        rows.append(f"| {check.name} | {keys}{unit} | {check.response} | {code} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    print(safety_table(), end="")
