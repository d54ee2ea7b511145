"""Return of the controller after a takeover by the guard."""

import copy

import numpy as np
import pytest
from services import make_guard

from wbc_controller.controller.controller import Controller
from wbc_controller.middleware.topics import GUARD_NODE
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.nodes.takeover import Takeover
from wbc_controller.records import Mode


class Rig:
    """A standing controller and its guard, with wall time that is set by hand."""

    def __init__(self, bench, changes):
        # The standing torques of Go2 are several periods of this rate.
        self.bench = bench(changes={"limits": {"torque_rate": 20.0}, **changes})
        settings, model = self.bench.settings, self.bench.model
        self.bench.loop._timer = self.bench.clock.now
        self.guard = make_guard(settings, model, MemoryTransport(self.bench.bus, GUARD_NODE), self.bench.clock)
        self.step = settings.limits.torque_rate * self.bench.period * model.effort_limits
        self.bench.command("activate")
        self.run(120)

    def run(self, count, *, commands=True):
        """Let periods pass, with a state each."""
        for _ in range(count):
            self.bench.give_state()
            report = self.bench.loop.cycle() if commands else None
            self.guard.cycle()
            if report is not None:
                assert np.array_equal(report.command.tau, self.bench.efforts()[-1])
                self.mode = report.mode

    def largest_change(self):
        """Return the largest change of a torque between two messages, as a share of the rate limit's."""
        return (np.abs(np.diff(self.bench.efforts(), axis=0)) / self.step).max()


@pytest.fixture
def rig(bench):
    return Rig(bench, {})


@pytest.mark.parametrize(("silence", "changes"), [(8, {}), (12, {"robot": {"command": "joints"}}), (200, {})])
def test_a_returning_controller_continues_from_the_torques_of_the_guard(bench, silence, changes):
    rig = Rig(bench, changes)
    standing = rig.bench.efforts()[-1]
    rig.run(silence, commands=False)
    assert rig.guard.guard.sending
    assert (np.abs(rig.bench.efforts()[-1] - standing) > 0.5 * rig.step).any()
    rig.run(100)
    assert rig.mode is Mode.ACTIVE
    assert not rig.guard.guard.sending
    assert rig.largest_change() <= 1.0 + 1e-9
    np.testing.assert_allclose(rig.bench.efforts()[-1], standing, atol=0.05 * np.abs(standing).max())


def test_a_takeover_during_the_computation_counts_too(rig, monkeypatch):
    computed = rig.bench.loop.controller.cycle

    def slow(inputs):
        result = computed(inputs)
        rig.run(15, commands=False)
        return result

    with monkeypatch.context() as patch:
        patch.setattr(rig.bench.loop.controller, "cycle", slow)
        rig.run(1)
    rig.run(50)
    assert rig.mode is Mode.ACTIVE
    assert rig.largest_change() <= 1.0 + 1e-9


@pytest.mark.parametrize("cycles", [0, 1])
def test_an_emergency_stop_after_a_takeover_is_zero_at_once(rig, cycles):
    rig.run(9, commands=False)
    rig.run(cycles)
    rig.bench.command("estop")
    rig.run(1)
    assert not rig.bench.efforts()[-1].any()


def test_only_finite_torques_after_the_last_command_count(bench, make, caplog):
    controller, stamp = bench(), 7
    model, patience = controller.model, 0.012
    limits, positions = model.effort_limits, np.zeros(model.nj)
    takeover = Takeover(model, controller.topics, controller.transport, patience)

    def torques(effort, after=stamp, now=1.0 + 1.1 * patience):
        efforts = np.full(model.nj, effort)
        controller.send("guard_commands", make.joint_state(model.joints, positions, positions, efforts, after))
        return takeover.torques(now)

    assert torques(1.0) is None  # no command was sent
    takeover.record_command(1.0, stamp)
    assert torques(1.0, now=1.0 + 0.9 * patience) is None
    assert np.array_equal(torques(1.0), np.full(model.na, 1.0))
    assert takeover.torques(2.0) is None  # taken
    assert torques(1.0, after=stamp - 1) is None  # of an earlier takeover
    assert np.array_equal(torques(-1e4), -limits)
    assert torques(np.nan) is None
    (said,) = caplog.messages
    assert said.startswith("/guard/joint_commands refused: effort of 'FL_hip_joint' is nan N·m")


def test_a_replay_of_the_inputs_has_the_same_torques(rig, monkeypatch):
    controller, cycles = rig.bench.loop.controller, []
    other = Controller(rig.bench.settings, preflight=False, model=rig.bench.model)
    other.recall(copy.deepcopy(controller.memory()), controller.live.settings)
    computed = controller.cycle

    def recorded(inputs):
        cycles.append((inputs, computed(inputs)))
        return cycles[-1][1]

    monkeypatch.setattr(controller, "cycle", recorded)
    rig.run(25, commands=False)
    rig.run(20)
    for inputs, result in cycles:
        assert np.array_equal(other.cycle(inputs).command.tau, result.command.tau)
    assert sum(inputs.torques_sent is not None for inputs, _ in cycles) == 1
