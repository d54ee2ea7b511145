"""Hostile or faulty inputs neither end, stall nor deceive the loop."""

from wbc_controller.records import Mode


def said(report, words):
    return [sentence for sentence in report.refused if words in sentence]


def test_the_largest_time_that_a_message_holds_is_answered(bench):
    robot = bench()
    robot.clock.time = 2147483640.0
    robot.activate()
    assert robot.cycle(10).mode is Mode.ACTIVE


def test_a_stop_is_never_merged_away_and_passes_a_flood_of_other_requests(bench):
    robot = bench().activated(100)
    robot.command("estop")
    robot.command("reset")
    sent = len(robot.efforts())
    report = robot.cycle()
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not robot.efforts()[sent:].any()
    assert len(robot.efforts()) == sent + 1
    assert robot.received("state")[-1].data.startswith("fault ESTOP")
    assert said(report, "command 'reset' is refused in the cycle of an emergency stop")
    robot.request("reset")
    assert robot.activate().mode is Mode.ACTIVE
    for _ in range(1000):
        robot.command("activate")
    report = robot.request("estop")
    assert (report.mode, report.fault.code) == (Mode.FAULT, "ESTOP")
    assert not report.command.tau.any()


def test_a_long_word_is_refused_without_being_repeated(bench, make):
    robot = bench()
    robot.send("command", make.string("x" * 1000))
    assert said(robot.cycle(), "command has 1000 characters (limit 40)")


def test_the_activation_at_the_start_can_be_cancelled(bench):
    robot = bench()
    robot.loop._activate_when_fresh = True
    robot.command("damp")
    robot.cycle(joints=False, base=False)
    assert robot.cycle(5).mode is Mode.INACTIVE
