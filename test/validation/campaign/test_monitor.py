"""Detection of each violation at its threshold, and not below."""

from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.controller.build.robot import make_model
from wbc_controller.middleware.codec import encode, torques
from wbc_controller.records import Fault, Mode
from wbc_controller.settings.config import load
from wbc_controller.validation.campaign.monitor import STALL, OutputMonitor

CONFIG = load("go2")
MODEL = make_model(CONFIG.settings)
NAMES = {"joint_states": "/joint_states", "odom": "/odom"}
STEP = CONFIG.settings.limits.torque_rate / CONFIG.settings.control.rate * MODEL.effort_limits


class Cycles:
    """A controller with given outputs."""

    def __init__(self, **changes) -> None:
        self.monitor = OutputMonitor(MODEL, CONFIG.replace(changes).settings, NAMES)
        self.monitor.now = 1.0

    def state(self, **taken) -> None:
        for stream, time in taken.items():
            self.monitor.sent(stream, round(1e9 * time))

    def cycle(self, tau, *, passed=0.002, mode=Mode.ACTIVE, code=None, solution=True, refused=()) -> dict:
        self.monitor.now += passed
        self.monitor.torques(encode(torques(np.asarray(tau, dtype=float))))
        fault, solved = Fault(code, "why") if code else None, object() if solution else None
        result = SimpleNamespace(mode=mode, fault=fault, command=object(), solution=solved, refused=refused)
        self.monitor.cycle(result)
        return self.monitor.violations


@pytest.fixture
def cycles():
    made = Cycles()
    made.state(joint_states=1.0, odom=1.0)
    made.cycle(np.zeros(12), passed=0.0)
    return made


@pytest.mark.parametrize(("passed", "share"), [(0.002, 1.0), (0.001, 0.5), (0.5, 1.0), (0.0, 0.0)])
def test_torque_rate(cycles, passed, share):
    cycles.state(joint_states=1.0 + passed, odom=1.0 + passed)
    assert cycles.cycle(share * STEP, passed=passed) == {}
    cycles.state(joint_states=1.0 + 2 * passed, odom=1.0 + 2 * passed)
    more = share * STEP
    more[3] += share * STEP[3] + 1e-3
    assert set(cycles.cycle(more, passed=passed)) == {"over_rate"}
    assert "FR_hip_joint" in cycles.monitor.violations["over_rate"]


def test_only_an_emergency_stop_is_exempt_from_the_rate(cycles):
    for number in range(1, 4):
        cycles.cycle(number * STEP)
    assert cycles.cycle(np.zeros(12), mode=Mode.FAULT, code="ESTOP", solution=False) == {}
    for number in range(1, 4):
        cycles.cycle(number * STEP)
    assert "over_rate" in cycles.cycle(np.zeros(12), mode=Mode.DAMPING, code="FALLEN", solution=False)


def test_torques_are_finite_and_within_limits(cycles):
    for number in range(1, 6):
        assert cycles.cycle(number * STEP) == {}
    assert set(cycles.cycle(MODEL.effort_limits * 1.0)) <= {"over_rate"}
    assert "over_limit" in cycles.cycle(MODEL.effort_limits * 1.001)
    assert "not_finite" in cycles.cycle(np.full(12, np.inf))
    assert "unreadable" in cycles.cycle(np.zeros(11))


@pytest.mark.parametrize(
    ("sent", "refused", "stale"),
    [
        (["odom"], (), "joint_states"),
        (["joint_states"], (), "odom"),
        (["joint_states", "odom"], ("/odom: header.stamp is 0",), "odom"),  # refused messages do not count
    ],
)
def test_stale_state_by_its_true_age(cycles, sent, refused, stale):
    """Latency that jumps up is seen, whatever the arrival says."""
    for _ in range(25):
        cycles.state(**dict.fromkeys(sent, cycles.monitor.now + 0.002))
        assert cycles.cycle(0.5 * STEP, refused=refused) == {}
    cycles.state(**dict.fromkeys(sent, cycles.monitor.now + 0.002))
    assert stale in cycles.cycle(0.5 * STEP, refused=refused)["stale"]


def test_zero_and_decreasing_torques_are_not_stale(cycles):
    cycles.cycle(STEP)
    assert cycles.cycle(0.6 * STEP, passed=0.3, mode=Mode.DAMPING, code="STALE_INPUT", solution=False) == {}
    assert cycles.cycle(np.zeros(12), mode=Mode.DAMPING, code="STALE_INPUT", solution=False) == {}
    assert "stale" in cycles.cycle(0.1 * STEP, mode=Mode.DAMPING, code="STALE_INPUT", solution=False)


@pytest.mark.parametrize(("synchronized", "found"), [(True, True), (False, False)])
def test_constant_latency_counts_with_synchronized_clocks(synchronized, found):
    cycles = Cycles(**{"safety.synchronized_clocks": synchronized})
    for _ in range(3):
        cycles.state(joint_states=cycles.monitor.now - 0.1, odom=cycles.monitor.now - 0.1)
        cycles.cycle(0.1 * STEP)
    assert ("stale" in cycles.monitor.violations) == found


def test_increased_latency_counts_without_synchronized_clocks(cycles):
    """A jump of the latency is detected independently of the arrival."""
    late = cycles.monitor.now + 0.002
    cycles.state(joint_states=late, odom=late)
    cycles.cycle(STEP)
    cycles.state(joint_states=late + 0.002, odom=late + 0.002)
    assert "stale" in cycles.cycle(STEP, passed=0.2)


def test_defects_and_stalls_are_violations(cycles):
    assert "internal_error" in cycles.cycle(np.zeros(12), mode=Mode.DAMPING, code="INTERNAL_ERROR", solution=False)
    cycles.monitor.check_processor_time(0.99 * STALL)
    assert "stall" not in cycles.monitor.violations
    cycles.monitor.check_processor_time(1.01 * STALL)
    assert "stall" in cycles.monitor.violations


@pytest.mark.parametrize("through", [(), (Mode.HOLDING,)])
def test_end_of_the_active_mode_is_stored_with_its_reason(cycles, through):
    for mode in through:
        cycles.cycle(np.zeros(12), mode=mode, code="NO_SOLUTION", solution=False)
    assert cycles.monitor.deactivation is None
    cycles.cycle(np.zeros(12), mode=Mode.DAMPING, code="FALLEN", solution=False)
    cycles.cycle(np.zeros(12), mode=Mode.FAULT, code="OTHER", solution=False)
    time, code, sentence = cycles.monitor.deactivation
    assert (round(time, 4), code, sentence) == (round(1.002 + 0.002 * len(through), 4), "FALLEN", "why")
