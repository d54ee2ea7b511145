"""Prints the table of the supervisor's checks for docs/safety.md, and lists the test of each check."""

from __future__ import annotations

from wbc_controller.safety.checks import CHECKS

#: Test of each check, as ``<file>::<function>`` in test/.
TESTS = {
    "age of the joint states, and of the odometry or the IMU data":
        "safety/test_checks.py::test_an_input_over_the_limit_is_named_with_its_age",
    "age of the states by synchronized clocks":
        "nodes/test_clock.py::test_with_synchronized_clocks_a_constant_latency_does_not_activate",
    "stamps ahead of this computer's clock, with synchronized clocks":
        "nodes/test_clock.py::test_clocks_that_part_are_a_fault_that_says_by_how_much",
    "the estimated base: finite, its slowest contact below 0.1 m/s":
        "nodes/test_base_from_imu.py::test_an_imu_that_contradicts_all_contacts_is_a_fault_with_the_size",
    "axes and units of the odometry, against its pose and the legs":
        "integration/test_wrong_sensor_axes.py::test_the_wrong_axis_or_unit_is_named",
    "axes and units of the IMU, against the legs":
        "integration/test_wrong_sensor_axes.py::test_the_wrong_axis_or_unit_is_named",
    "magnitude of joint positions and base coordinates":
        "safety/test_plausibility.py::test_positions_out_of_range",
    "speeds of the joints and the base": "safety/test_plausibility.py::test_velocities_out_of_range",
    "joint positions against joint velocities": "safety/test_plausibility.py::test_a_joint_that_jumps_is_named",
    "a constant joint position against its velocity":
        "safety/test_plausibility.py::test_a_joint_whose_velocity_or_position_is_dead_is_named",
    "joint states or odometry repeated bit for bit during motion":
        "safety/test_plausibility.py::test_values_that_are_frozen_under_fresh_stamps_are_named",
    "position of the base against its velocity": "safety/test_plausibility.py::test_odometry_that_jumps_is_a_fault",
    "orientation of the base against its angular velocity":
        "safety/test_plausibility.py::test_an_orientation_that_jumps_is_a_fault",
    "joint motion not explained by the torques, at the start of active control":
        "nodes/test_bring_up.py::test_torques_in_another_order_stop_the_robot_and_name_a_joint",
    "tilt of a floating base since the activation":
        "safety/test_plausibility.py::test_a_base_that_tilts_too_far_has_fallen",
    "distance of the capture point from the support of a biped that walks or can walk":
        "walking/test_fall.py::test_the_fall_of_a_standing_robot_is_predicted_before_it_reaches_the_ground",
    "height of a floating base above the lowest end of a limb":
        "safety/test_plausibility.py::test_a_base_that_sinks_between_its_limbs_has_fallen",
    "time without a usable solution, continuous or in total":
        "safety/test_plausibility.py::test_single_solutions_do_not_renew_the_time_for_holding",
    "the solution's torques: finite, and within their limits":
        "safety/test_supervisor.py::test_torques_that_are_not_usable_never_leave",
    "time with relaxed constraints":
        "safety/test_plausibility.py::test_relaxed_for_too_long_is_a_fault_that_names_what_was_relaxed",
    "change of the torques in time":
        "safety/test_plausibility.py::test_the_torque_rate_is_per_second_however_often_the_states_come",
    "joint velocities used for damping":
        "safety/test_plausibility.py::test_implausible_velocities_are_not_damped",
    "damping in discrete time":
        "safety/test_damping.py::test_damping_is_stable_in_all_postures_with_one_more_period_of_delay",
    "other publishers of torques":
        "nodes/test_loop.py::test_while_another_node_publishes_torques_activation_is_refused",
}  # fmt: skip


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
