"""Recordings of a walking robot: replay bit for bit, also from the middle of a step, and faults during a step."""

from dataclasses import replace

import numpy as np
import pytest

from wbc_controller.middleware.codec import message
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.recording.recorder import Recorder
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.replay.recording_summary import summarize
from wbc_controller.records import Mode
from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.catalogue import KINDS
from wbc_controller.walking.gait import Phase

FALLS = {"FALLEN", "FALLING", "ESTIMATE_LOST", "IMPLAUSIBLE_STATE", "RELAXED", "NO_SOLUTION"}
#: Fault, its parameters, and the codes that may name it.
FAULTS = [
    ("message_dropout", {"stream": "joint_states"}, {"STALE_INPUT"}),
    ("imu_shock", {"turn": 50.0}, FALLS),
    ("actuator_weak", {"share": 0.05}, FALLS),
    ("command_loss", {"share": 1.0}, FALLS),
    ("floor_hole", {"contact": ""}, FALLS),
]


class Walk(Lockstep):
    """G1 without odometry that walks, recorded."""

    def __init__(self, file):
        changes = {
            "estimation.base_state": "imu", "mock.sensors": "good", "safety.activation_ramp": 0.0,
            "safety.bring_up_time": 0.0, "control.markers_rate": 0.0, "recorder.folder": str(file.parent / "faults"),
            "estimation.settling": 0.1,
        }  # fmt: skip
        settings = load("g1").replace(changes).settings
        self.recorder = Recorder(settings, file, patient=True, name="g1")
        super().__init__(settings, recorder=self.recorder)
        self.reports, self.velocity = [], None

    def go(self, seconds, stop=lambda: False):
        for i in range(round(seconds / self.controller.period)):
            if self.velocity is not None and i % 50 == 0:
                self.user.send("cmd_vel", self.velocity)
            self.reports.append(self.cycle())
            if stop():
                return

    def step(self):
        """Stand, walk, and stop in the middle of the first step."""
        self.go(self.settings.estimation.settling + 0.1)
        self.user.send_text("command", "activate")
        self.go(0.25)
        self.mock.plant.hold(False, ramp=0.0)
        self.go(0.1)
        walker = self.controller.walker
        self.velocity = message("geometry_msgs/msg/Twist", linear={"x": 0.2})
        self.go(4.0, lambda: walker.phase is Phase.SINGLE)
        self.go(0.2)
        assert walker.phase is Phase.SINGLE

    def finish(self, file):
        self.recorder.close()
        return Recording(file)


@pytest.mark.parametrize(("kind", "parameters", "codes"), FAULTS, ids=[kind for kind, *_ in FAULTS])
def test_a_walk_replays_bit_for_bit_from_the_middle_of_a_step_and_names_its_fault(tmp_path, kind, parameters, codes):
    walk, phases = Walk(tmp_path / "a.mcap"), {}
    walk.loop.observers += (lambda report: phases.setdefault(report.cycle, walk.controller.walker.phase),)
    walk.step()
    if kind == "floor_hole":  # below the foot that lands
        parameters = {"contact": walk.controller.walker._feet[-walk.controller.walker._stance].contact}
    walk.mock.plan([KINDS[kind](start=0.0, duration=1.5, **parameters)], since=walk.time)
    with np.errstate(all="ignore"):
        walk.go(3.0, lambda: walk.reports[-1].mode is not Mode.ACTIVE)
        walk.go(0.1)
    fault = walk.reports[-1].fault
    assert fault is not None
    assert fault.code in codes
    recorded = walk.finish(tmp_path / "a.mcap")
    summary = summarize(recorded)
    assert f"fault {fault.code} " in summary
    assert fault.sentence in summary
    inside = [number for number in recorded.memories if number and phases[number - 1] is Phase.SINGLE]
    later = Replay(recorded)
    with np.errstate(all="ignore"):
        found = [(each.cycle.number, each.is_identical) for each in later.run(inside[-1])]
        assert found == [(number, True) for number in range(inside[-1], recorded.count)]
        assert later.controller.walker.steps == walk.controller.walker.steps
        if kind == "message_dropout":
            found = [(each.is_identical, each.exact) for each in Replay(recorded).run()]
            assert found == [(True, True)] * recorded.count


def test_contact_sensors_are_part_of_the_recorded_inputs(tmp_path):
    """A sensor that shows the touchdown earlier than the motion, in the recording alone."""
    walk = Walk(tmp_path / "a.mcap")
    cycle = walk.controller.cycle
    states = {"left_foot": True, "right_foot": False}
    walk.controller.cycle = lambda inputs: cycle(replace(inputs, touching=states))
    walk.go(0.1)
    states = {"left_foot": False}
    walk.go(0.02)
    replay, seen = Replay(walk.finish(tmp_path / "a.mcap")), []
    cycle_of_replay = replay.controller.cycle
    replay.controller.cycle = lambda inputs: (seen.append(dict(inputs.touching)), cycle_of_replay(inputs))[1]
    assert all(each.is_identical for each in replay.run())
    assert seen[0] == {"left_foot": True, "right_foot": False}
    assert seen[-1] == {"left_foot": False}
