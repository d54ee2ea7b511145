"""Outgoing messages: commands, forces, the mode, diagnostics."""

import statistics

import numpy as np
import pytest
from composed import whole

from wbc_controller.controller.report import CycleReport, LatchedInputs
from wbc_controller.controller.result import CycleResult
from wbc_controller.middleware.codec import nanoseconds
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.nodes.diagnostics.status import StatusSummary
from wbc_controller.records import Disturbance, Fault, Infeasibility, LevelReport, Mode, References, Solution


def report(**changes):
    inputs = LatchedInputs(state=None, joint_velocity=None, ages=changes.pop("ages", {"joint_states": 0.001}))
    values = {"mode": Mode.INACTIVE, "fault": None, "command": None}
    parts = ("mode", "fault", "command", "solution", "references")
    values |= {key: changes.pop(key) for key in parts if key in changes}
    others = {"cycle": 1, "refused": (), "stage_seconds": {"total": 1e-3}, "deadlines_missed": 0}
    return CycleReport(inputs=inputs, result=CycleResult(qp=None, time=5e-9, **values), **{**others, **changes})


def solution(**changes):
    """With all values, and changes."""
    values = {
        "forces": {}, "residuals": {"contact_motion": 1e-9}, "task_errors": {"com": 0.01},
        "binding": {"torque:knee:upper": 0.25}, "levels": (LevelReport(("com",), 0.5, 7, 5e-5),),
    }  # fmt: skip
    made = Solution(np.zeros(18), np.zeros(12), iterations=7)
    vars(made).update(values | changes)
    return made


def test_both_command_topics_say_the_same(bench):
    controller = bench().activated(20)
    effort, named = controller.received("effort"), controller.received("joint_commands")
    assert len(effort) == len(named) == len({each.stamp for each in controller.reports}) == 21
    assert [each.cycle for each in controller.reports] == list(range(21))
    for array, state, said in zip(effort, named, controller.reports, strict=True):
        np.testing.assert_array_equal(array.data, state.effort)
        np.testing.assert_array_equal(array.data, said.command.tau)
        assert state.name == list(controller.model.joints)
        assert nanoseconds(state.header.stamp) == said.stamp
        assert array.layout.dim[0].size == controller.model.na
        np.testing.assert_array_equal(state.position, said.command.q_desired)
        np.testing.assert_array_equal(state.velocity, said.command.v_desired)


def test_the_mode_is_published_when_it_changes_and_commands_and_forces_only_under_control(bench):
    controller = bench()
    controller.cycle(10)
    assert not any(controller.received(key) for key in ("effort", "joint_commands"))
    assert not controller.received("contact_wrench", "front_left_foot")
    controller.activate()
    controller.cycle(5)
    before = len(controller.received("contact_wrench", "front_left_foot"))
    assert before > 0
    controller.command("damp")
    controller.cycle(10)
    assert len(controller.received("contact_wrench", "front_left_foot")) == before
    assert [content.data for content in controller.received("state")] == ["inactive", "active", "damping"]


@pytest.mark.parametrize(("name", "frame"), [("g1", "left_ankle_roll_link"), ("go2", "world")])
def test_the_forces_counted_on_are_published_in_the_contact_frame(bench, name, frame):
    controller = bench(name).activated(120)
    weight = controller.model.mass * controller.model.gravity
    total = 0.0
    for contact in controller.settings.contacts:
        wrench = controller.received("contact_wrench", contact)[-1]
        force = controller.reports[-1].solution.forces[contact]
        assert wrench.wrench.force.z == force[2]
        assert wrench.wrench.torque.x == (force[3] if len(force) == 6 else 0.0)
        total += wrench.wrench.force.z
    assert total == pytest.approx(weight, rel=0.05)
    assert controller.received("contact_wrench", next(iter(controller.settings.contacts)))[0].header.frame_id == frame


@pytest.mark.parametrize(
    ("found", "least"),
    [
        ({("contact_wrench", "front_right_foot")}, 100),
        ({("task_value", "com"), ("task_reference", "com")}, 2),
        ({("markers", "")}, 9),
    ],
)
def test_topics_are_published_on_demand(bench, monkeypatch, found, least):
    readers = set()
    monkeypatch.setattr(
        MemoryTransport, "has_reader", lambda self, endpoint: (endpoint.key, endpoint.subject) in readers
    )
    controller = bench(changes={"control": {"markers_rate": 50.0}}).activated(10)

    def came():
        """Count the messages of topics on demand in 0.3 s."""
        kinds = ("contact_wrench", "task_value", "task_reference", "markers")
        before = {key: len(payloads) for key, payloads in controller._payloads.items()}
        controller.cycle(150)
        counts = {key: len(payloads) - before[key] for key, payloads in controller._payloads.items()}
        return {key: count for key, count in counts.items() if key[0] in kinds and count}

    assert came() == {}
    readers.add(max(found))
    sent = came()
    assert set(sent) == found
    assert min(sent.values()) >= least
    readers.clear()
    controller.cycle(round(0.1 / controller.period) + 1)
    assert sum(came().values()) <= 1  # one may be in transit


def test_diagnostics_without_subscription_come_once_per_second(bench, monkeypatch):
    readers = set()
    monkeypatch.setattr(MemoryTransport, "has_reader", lambda self, endpoint: endpoint.key in readers)
    controller = bench(changes={"control": {"rate": 100.0, "diagnostics_rate": 10.0}})
    second = round(1.0 / controller.period)

    def came(cycles):
        before = len(controller.received("diagnostics"))
        controller.cycle(cycles)
        return len(controller.received("diagnostics")) - before

    assert came(3 * second + 4) == 4
    controller.command("actvate")
    assert came(1) == 1
    status = controller.status
    assert "refused command 'actvate' is unknown; did you mean 'activate'?" in status.message
    assert (status.level, status.name) == (1, "wbc_controller: control loop")
    assert status.hardware_id == "go2_description"  # the robot's name in its URDF
    assert came(second - 5) == 0
    readers.add("diagnostics")
    assert 18 <= came(2 * second) <= 22
    readers.clear()
    controller.cycle(round(0.1 / controller.period) + 1)
    assert 2 <= came(3 * second) <= 4


def _status(*reports, model=None):
    summary = StatusSummary("/r1/wbc_controller", "r1", model=model)
    for each in reports:
        summary.add(each)
    (status,) = whole(summary.compose(9)).status
    return status, {value.key: value.value for value in status.values}


@pytest.mark.parametrize(
    ("mode", "level"), [("inactive", 0), ("active", 0), ("holding", 1), ("damping", 1), ("stopped", 1), ("fault", 2)]
)
def test_level_and_message_of_modes_and_faults(mode, level):
    status, values = _status(report(mode=Mode(mode)))
    assert (status.level, status.message, values["mode"]) == (level, mode, mode)

    status, _ = _status(report(mode=Mode(mode), fault=Fault("ESTOP", "emergency stop by command")))
    assert status.message == f"{mode}; ESTOP: emergency stop by command"
    assert status.level == max(level, 1)


def test_a_conflict_has_names_and_slacks():
    why = Infeasibility(
        conflict=("torque:knee", "normal_force:foot"), smallest=("torque:knee",),
        slack={"torque:knee": 12.345, "normal_force:foot": 80.0},
        units={"torque:knee": "N·m", "normal_force:foot": "N"},
        sentence="conflict: torque of knee against normal force of foot",
    )  # fmt: skip
    status, values = _status(report(mode=Mode.HOLDING, fault=Fault("NO_SOLUTION", f"no; {why.sentence}", why)))
    assert status.message == "holding; NO_SOLUTION: no; conflict: torque of knee against normal force of foot"
    assert values["infeasibility/conflict"] == "torque:knee, normal_force:foot"
    assert values["infeasibility/smallest"] == "torque:knee"
    assert values["infeasibility/slack/torque:knee"] == "12.35 N·m"
    assert values["infeasibility/slack/normal_force:foot"] == "80 N"


def test_contents_of_a_summary_and_of_the_next_one():
    first = report(stage_seconds={"total": 1e-3}, refused=("x: no",), solution=solution(relaxed=("joint_motion",)))
    last = report(cycle=2, stage_seconds={"total": 3e-3}, deadlines_missed=4, ages={"odom": 0.25}, solution=solution())
    status, values = _status(first, last)
    assert status.message == "inactive; relaxed joint_motion in 1 of 2 cycles; refused x: no"
    assert status.level == 1
    expected = {
        "cycles": "2", "cycle": "2", "deadlines_missed": "4", "age/odom": "0.2500 s", "time/total/median": "2000 us",
        "time/total/max": "3000 us", "task_error/com": "0.01000", "residual/contact_motion": "1.00e-09",
        "binding": "torque:knee:upper", "level/0": "com: cost 0.5, 7 iterations, 50 us",
        "cost/torque:knee:upper": "0.25 1/(N·m)", "refused/0": "x: no",
    }  # fmt: skip
    assert {key: values[key] for key in expected} == expected
    summary = StatusSummary("/r1/wbc_controller", "r1")
    summary.add(report(refused=("x: no",)))
    whole(summary.compose(1))
    summary.add(report())
    (status,) = whole(summary.compose(2)).status
    assert "refused" not in status.message


def test_no_piece_of_diagnostics_sorts_the_times_of_many_cycles(monkeypatch):
    """At 1 kHz the times of a second took a millisecond in one piece, and delayed the cycle."""
    summary, median, asked, pieces = StatusSummary("controller", "g1"), statistics.median, [], []

    def counted(times):
        asked.append(len(times))
        return median(times)

    monkeypatch.setattr(statistics, "median", counted)
    for i in range(1000):
        summary.add(report(stage_seconds={f"stage {j}": 1e-6 * (j + (i % 10 == 0) * i) for j in range(9)}))
    composing = summary.compose(0)
    message = None
    while message is None:
        try:
            next(composing)
        except StopIteration as end:
            message = end.value
        pieces.append(sum(asked))
        asked.clear()
    assert sum(pieces) == 9000
    assert max(pieces) <= 1000
    values = {value.key: value.value for value in message.status[0].values}
    assert (values["time/stage 3/median"], values["time/stage 3/max"]) == ("3 us", "993 us")


@pytest.mark.parametrize(("missed", "level"), [(0.4, 0), (0.6, 1)])
def test_contacts_that_contradict_each_other_are_a_warning(missed, level):
    status, _ = _status(report(solution=solution(residuals={"contact_motion": missed})))
    assert ("contacts contradict each other by 0.6 m/s²" in status.message) == (level == 1)
    assert status.level == level


def test_friction_and_disturbance_are_reported_by_contact_and_joint(robot_of):
    _, model = robot_of("go2")
    forces = np.arange(18.0)
    loaded = solution(disturbance=Disturbance(2.0 * forces, forces, ("base", "FL_calf_joint")))
    references = References({}, {}, {}, friction={"left_foot": 0.05, "right_foot": 1.0})
    status, values = _status(report(solution=loaded, references=references), model=model)
    assert {key: value for key, value in values.items() if key.startswith("friction/")} == {
        "friction/left_foot": "0.05 of the configured one"
    }
    assert values["disturbance/base"] == "0.000 1.000 2.000 N, 3.000 4.000 5.000 N·m"
    assert values[f"disturbance/{model.joints[2]}"] == f"{model.v_index[2]:.4f} N·m"
    assert "at its bound (estimation.disturbance_share) at base, FL_calf_joint" in status.message
    assert status.level == 1
