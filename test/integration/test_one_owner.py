"""Real processes: two controllers of one robot, then two robots on one topic."""

import pytest

pytestmark = pytest.mark.live

RIVAL = "torques on /effort_controller/commands are published by /wbc_controller too"


def test_two_controllers_do_not_fight_and_two_robots_are_said(processes, dds_user):
    user = dds_user
    mock = processes.start("mock", "go2")
    processes.start("run", "go2", "--use-sim-time")
    user.wait_for_service()  # the first must be discovered
    second = processes.start("run", "go2", "--activate", "--use-sim-time")
    # Each logs the other once.
    user.until(lambda: processes.logs().count(f"ownership: {RIVAL}") == 2, "both controllers to see each other")
    refused, waits = f"'activate' is refused: {RIVAL}", f"the activation at the start waits: {RIVAL}"
    user.until(
        lambda: any(refused in said for said in user.refusals()), "the refusal", lambda: user.command("activate")
    )
    user.until(lambda: waits in processes.logs(), "the activation at the start to wait")
    user.run(0.5)
    assert {content.data for content in user.all("controller", "state")} == {"inactive"}
    assert not len(user.efforts())
    (status,) = user.last("controller", "diagnostics").status
    assert (status.level, RIVAL in status.message) == (1, True)

    # After the end of one, the other is activated.
    assert processes.stop(second) == 0
    user.activate_again()

    # Both robots and the controller report a second robot.
    processes.start("mock", "go2")
    said = "/joint_states has another publisher, /mock_robot: two robots on one topic"
    user.until(lambda: processes.logs().count(said) == 2, "both robots to see each other")
    several = "/odom has several publishers: /mock_robot, /mock_robot; stop all but one"
    user.until(lambda: several in user.last("controller", "diagnostics").status[0].message, "the diagnostics")
    values = {value.key: value.value for value in user.last("controller", "diagnostics").status[0].values}
    assert values["publishers//joint_states"] == "/mock_robot, /mock_robot"
    assert processes.stop(mock) == 0
