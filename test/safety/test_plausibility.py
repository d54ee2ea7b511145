"""Implausible states, falls and time budgets of the supervisor."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.safety import make_supervisor_limits
from wbc_controller.errors import InputRefused, NoSolution
from wbc_controller.records import Fault, Mode, RobotState, Solution
from wbc_controller.safety.damping import stable_damping
from wbc_controller.safety.plausibility import LEAST_HEIGHT, FallWatch, StateWatch, joint_speed_limits
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.settings.service import SafetySettings

PERIOD = 0.002
NOTHING = NoSolution("nothing", "infeasible", None)
NO_FALL = {"max_tilt": 3.2, "min_height": 0.0}


class Body:
    """Robot that integrates its velocities, and a supervisor with the sensor `sensed`."""

    def __init__(self, settings, model, **changes):
        self.model = model
        limits = make_supervisor_limits(settings, model)
        own = {key: changes.pop(key) for key in [*changes] if hasattr(limits.safety, key)}
        safety = limits.safety.model_copy(update={"activation_ramp": 0.0, **own})
        self.limits = dataclasses.replace(limits, safety=safety, **changes)
        self.supervisor = Supervisor(model, self.limits)
        self.base = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
        self.q, self.v = model.configuration(model.posture, self.base), np.zeros(model.nv)
        self.now, self.stamp = 10.0, 5_000_000_000
        self.tau = 0.5 * model.effort_limits
        self.relaxed = ()
        self.commands = []
        self.supervisor.request("activate", self.now, None)

    @property
    def mode(self):
        return self.supervisor.mode

    def step(self, count=1, *, outcome=None, sensed=lambda q, v: (q, v), dt=PERIOD, velocity=None):
        for _ in range(count):
            self.now += dt
            self.stamp += round(dt * 1e9)
            self.q = pin.integrate(self.model.pinocchio, self.q, dt * self.v)
            q, v = sensed(self.q.copy(), self.v.copy())
            state = RobotState(self.stamp, q, v)
            speeds = v[self.model.v_index] if velocity is None else velocity
            solution = Solution(v_dot=np.zeros(self.model.nv), tau=self.tau, relaxed=self.relaxed, iterations=1)
            made = (outcome or solution) if self.supervisor.solving else None
            self.commands.append(self.supervisor.step(self.now, state, speeds, None, made))
        return self.commands[-1]

    def says(self, *words, code="IMPLAUSIBLE_STATE"):
        assert self.mode is Mode.DAMPING
        assert self.supervisor.fault.code == code
        for word in words:
            assert word in self.supervisor.fault.sentence


@pytest.fixture
def body(robot_of):
    """Return a factory of Go2 after some steps."""

    def make(steps=0, **changes):
        made = Body(*robot_of("go2"), **changes)
        if steps:
            made.step(steps)
        return made

    return make


def joint(model, i):
    return model.q_index[i], model.v_index[i]


def replacing(*, q=None, v=None):
    """Return a sensor with values replaced by index."""

    def sensed(positions, velocities):
        for measured, replaced in ((positions, q or {}), (velocities, v or {})):
            measured[list(replaced)] = list(replaced.values())
        return positions, velocities

    return sensed


def test_the_torque_rate_is_per_second_however_often_the_states_come(body):
    """Five states per period: the torque rate counts time."""
    robot = body(torque_rate=2.0)
    robot.step(5)
    before = robot.commands[-1].tau
    robot.step(100, dt=PERIOD / 5.0)
    gained = (robot.commands[-1].tau - before) / robot.model.effort_limits
    np.testing.assert_allclose(gained, 2.0 * 20 * PERIOD, rtol=1e-6)
    before = robot.commands[-1].tau
    robot.step(dt=0.03)  # late: at most the change of one period
    np.testing.assert_allclose(robot.commands[-1].tau - before, 2.0 * PERIOD * robot.model.effort_limits, rtol=1e-6)


def test_a_clock_that_goes_back_keeps_the_torques_and_does_not_stop_the_way_to_zero(body):
    robot = body(torque_rate=20.0, damping_time=0.05)
    robot.step(50)
    before = robot.commands[-1].tau
    robot.supervisor.request("damp", robot.now, None)
    robot.now -= 5.0
    robot.step()
    np.testing.assert_array_equal(robot.commands[-1].tau, before)
    robot.step(60)
    assert robot.mode is Mode.STOPPED
    assert not robot.commands[-1].tau.any()


@pytest.mark.parametrize(("rate", "falls"), [(0.95, False), (1.1, True)])
def test_a_base_that_tilts_too_far_has_fallen(body, rate, falls):
    robot = body(steps=10)
    robot.v[3] = 1.0
    robot.step(round(rate / PERIOD))
    if falls:
        robot.says("the base has tilted by 1.00 rad", "limit 1.00 rad, safety.max_tilt", code="FALLEN")
    else:
        assert robot.mode is Mode.ACTIVE


def test_a_slope_and_turning_about_the_vertical_are_no_fall(body):
    robot = body()
    slope = pin.exp3(np.array([1.2, 0.0, 0.0]))
    robot.q = robot.model.configuration(robot.model.posture, pin.SE3(slope, np.zeros(3)))
    robot.v[3:6] = slope.T @ np.array([0.0, 0.0, 2.0])
    robot.step(1500)
    assert robot.mode is Mode.ACTIVE


def fold(robot, thigh=1.0, calf=-1.5):
    """Fold the legs at joint velocities, rad/s."""
    for leg in range(4):
        robot.v[joint(robot.model, 3 * leg + 1)[1]] = thigh
        robot.v[joint(robot.model, 3 * leg + 2)[1]] = calf


def test_a_base_that_sinks_between_its_limbs_has_fallen(body):
    """The legs fold; the height relative to the feet counts."""
    robot = body(steps=10)
    fold(robot)
    robot.v[2] = 0.3  # the base rises in the world, as on stairs
    for _ in range(800):
        robot.step()
        if robot.mode is not Mode.ACTIVE:
            break
    robot.says("above the lowest limb (limit 0.4 of the ", "safety.min_height", code="FALLEN")
    height, at_first = map(float, re.findall(r"(\d\.\d+) m ", robot.supervisor.fault.sentence))
    assert 0.36 < height / at_first < 0.4  # detected within 10 ms


def test_without_a_smallest_height_a_base_may_sink(body):
    robot = body(max_tilt=1.0, min_height=0.0)
    robot.q[joint(robot.model, 1)[0]] += 0.1  # not symmetric: or the lowest end would be the base itself
    for leg in range(4):
        robot.q[joint(robot.model, 3 * leg + 1)[0]] += 1.6  # on its back legs: the feet above the base
    again(robot)
    robot.step(10)
    fold(robot)
    robot.step(800)
    assert robot.mode is Mode.ACTIVE


def test_where_the_limbs_are_hardly_below_the_base_its_height_does_not_count(body):
    """Lying robot: a height below the limit is not checked."""
    robot = body()
    for leg in range(4):
        robot.q[joint(robot.model, 3 * leg + 1)[0]] = 1.57
        robot.q[joint(robot.model, 3 * leg + 2)[0]] = -0.25
    robot.step()
    assert 0.0 < robot.supervisor._fall._height < LEAST_HEIGHT
    fold(robot, 0.5, 0.0)
    robot.step(300)
    assert robot.mode is Mode.ACTIVE


def again(robot):
    for word in ("damp", "reset", "activate"):
        robot.supervisor.request(word, robot.now, None)


def test_tilt_and_height_are_counted_from_each_activation_anew(body):
    robot = body(max_tilt=1.0, min_height=0.0)
    robot.v[3] = 1.0
    for _ in range(3):  # 0.8 rad in each activation, 2.4 rad in all
        robot.step(round(0.8 / PERIOD))
        assert robot.mode is Mode.ACTIVE
        again(robot)
    robot = body(max_tilt=3.2, min_height=0.7)
    fold(robot, 0.5, -1.0)
    watch = robot.supervisor._fall
    for _ in range(3):  # 0.8 of the height in each activation, half of it in all
        robot.step()
        while watch._height_of(RobotState(0, robot.q, robot.v)) > 0.8 * watch._height:
            robot.step()
        assert robot.mode is Mode.ACTIVE
        again(robot)


def random_robot(seed):
    """A floating base with 12 joints of every kind that a URDF may give, on it and on each other."""
    rng, model = np.random.default_rng(seed), pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    for i in range(12):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        kinds = (
            pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ(), pin.JointModelRevoluteUnaligned(axis),
            pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelPrismaticUnaligned(axis),
        )  # fmt: skip
        parent = model.addJoint(int(rng.integers(1, i + 2)), kinds[rng.integers(8)], pin.SE3.Random(), f"joint {i}")
        model.addFrame(pin.Frame(f"end {i}", parent, 0, pin.SE3.Random(), pin.FrameType.BODY))
    return model, rng


def height_of(model, q):
    watch = FallWatch(SimpleNamespace(floating_base=True, pinocchio=model), SafetySettings(max_tilt=1, min_height=0.5))
    return watch._height_of(RobotState(0, q, np.zeros(model.nv)))


@pytest.mark.parametrize("seed", range(20))
def test_the_height_above_the_lowest_end_of_a_limb_is_that_of_forward_kinematics(seed):
    model, rng = random_robot(seed)
    data = model.createData()
    q = np.concatenate([pin.SE3ToXYZQUAT(pin.exp6(2.0 * rng.normal(size=6))), rng.uniform(-4.0, 4.0, 12)])
    pin.framesForwardKinematics(model, data, q)
    ends = {frame.parentJoint: data.oMf[i].translation[2] for i, frame in enumerate(model.frames) if i > 0}
    inner = set(model.parents)
    lowest = min(z for joint, z in ends.items() if joint not in inner)
    assert height_of(model, q) == pytest.approx(q[2] - lowest, abs=1e-12)


@pytest.mark.parametrize(("axis", "speed", "changes"), [(2, -1.0, {}), (3, 1.0, NO_FALL)])
def test_neither_stairs_nor_anything_without_limits_is_a_fall(body, axis, speed, changes):
    robot = body(**changes)
    robot.v[axis] = speed
    robot.step(1500)
    assert robot.mode is Mode.ACTIVE


def test_neither_a_fixed_base_nor_one_without_limbs_falls(robot_of, changed):
    settings = changed(robot_of("go2")[0], {"robot": {"base": "fixed"}})
    watch = FallWatch(make_model(settings), SafetySettings(max_tilt=0.01, min_height=1.0))
    watch.begin()
    for i in range(20):  # values 3 to 6 of its configuration are joints, and no quaternion
        q = np.random.default_rng(i).uniform(-1.0, 1.0, 12)
        assert watch.check(0.1 * i, RobotState(i, q, np.zeros(12))) is None
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    assert height_of(model, pin.neutral(model)) == -np.inf


def test_single_solutions_do_not_renew_the_time_for_holding(body):
    robot = body(hold_time=0.1, hold_window=1.0)
    robot.step(10)
    held = 0
    while robot.mode is not Mode.DAMPING:
        assert held < 100
        robot.step(9, outcome=NOTHING)
        held += 9
        if robot.mode is not Mode.DAMPING:
            robot.step()
    assert held * PERIOD == pytest.approx(0.1, abs=0.02)
    robot.says(
        "held the last torques for 1", "within 1 s (limit 100 ms, safety.hold_time)", "nothing", code="NO_SOLUTION"
    )


def test_rare_failures_and_relaxations_do_not_add_up(body):
    robot = body(hold_time=0.1, hold_window=1.0)
    for _ in range(60):
        robot.step(2, outcome=NOTHING)
        robot.step(48)
    assert robot.mode is Mode.ACTIVE
    robot = body()
    for _ in range(30):
        robot.relaxed = ("joint_motion",)
        robot.step(40)
        robot.relaxed = ()
        robot.step(160)
    assert robot.mode is Mode.ACTIVE


def test_relaxed_for_too_long_is_a_fault_that_names_what_was_relaxed(body):
    robot = body(steps=10)
    robot.relaxed = ("self_collision",)
    robot.step(100)
    robot.relaxed = ()
    robot.step(50)
    robot.relaxed = ("joint_motion", "torque_rate")
    robot.step(149)
    assert robot.mode is Mode.ACTIVE
    robot.step(4)
    robot.says("self_collision, joint_motion, torque_rate: relaxed for 50", "safety.relax_time", code="RELAXED")


def test_an_activation_begins_with_whole_budgets(body):
    robot = body(hold_time=0.1, hold_window=10.0)
    for outcome, relaxed, count in ((NOTHING, (), 40), (None, ("joint_motion",), 200)):
        for _ in range(2):
            again(robot)
            robot.step(10)
            robot.relaxed = relaxed
            robot.step(count, outcome=outcome)
            robot.relaxed = ()
        robot.step(5)
        assert robot.mode is Mode.ACTIVE


def test_noise_of_sensors_is_plausible(body):
    """Noise of 5e-3 rad, 0.2 rad/s, 3 mm and 0.1 m/s for 20 s at 500 Hz."""
    robot, rng = body(), np.random.default_rng(0)
    model = robot.model

    def noisy(q, v):
        q[model.q_index] += rng.normal(0.0, 5e-3, model.nj)
        v[model.v_index] += rng.normal(0.0, 0.2, model.nj)
        q[:3] += rng.normal(0.0, 3e-3, 3)
        v[:6] += rng.normal(0.0, 0.1, 6)
        return q, v

    for i in range(1000):
        robot.v[model.v_index] = 2.0 * np.sin(0.1 * i + np.arange(model.nj))
        robot.step(10, sensed=noisy)
    assert robot.mode is Mode.ACTIVE


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_values_that_repeat_at_rest_and_coarse_encoders_with_noise_are_plausible(body, noise):
    robot, rng = body(), np.random.default_rng(0)
    model = robot.model

    def coarse(q, v):
        v[model.v_index] += rng.normal(0.0, noise, model.nj)
        return q, v

    robot.step(5000, sensed=coarse)
    assert robot.mode is Mode.ACTIVE


def test_slow_lost_and_corrected_measurements_are_plausible(body):
    """50 Hz at 1 m/s: the pose repeats for ten states, and then catches up."""
    robot = body()
    robot.v[0], robot.v[5] = 1.0, 0.5
    robot.v[robot.model.v_index] = 0.3
    kept = {}

    def slow(q, v):
        if (robot.stamp // 2_000_000) % 10 == 0 or not kept:
            kept["q"], kept["v"] = q[:7].copy(), v[:6].copy()
        q[:7], v[:6] = kept["q"], kept["v"]
        return q, v

    robot.step(500, sensed=slow)
    assert robot.mode is Mode.ACTIVE
    robot, rng = body(**NO_FALL), np.random.default_rng(1)
    for i in range(300):
        robot.v[robot.model.v_index] = 3.0 * np.sin(0.2 * i + np.arange(robot.model.nj))
        robot.step(dt=PERIOD * int(rng.integers(1, 10)))
    robot.v[robot.model.v_index] = -3.0
    robot.step()
    robot.v[robot.model.v_index] = 3.0  # turned back during the gap
    robot.step(dt=0.3)
    robot.step(10)
    assert robot.mode is Mode.ACTIVE
    robot = body(steps=10)
    for _ in range(10):
        robot.q[0] += 0.05
        robot.step(250)
    assert robot.mode is Mode.ACTIVE


def test_reach_after_a_gap(body):
    robot = body(**NO_FALL)
    robot.step(10)
    place = joint(robot.model, 4)[0]
    fastest = joint_speed_limits(robot.model, robot.limits.safety.max_joint_speed)[4]
    robot.q[place] += 0.06 * fastest + 0.15
    robot.step(dt=0.06)
    assert robot.mode is Mode.ACTIVE
    robot.step(500)
    robot.q[place] -= 0.06 * fastest + 0.25
    robot.step(dt=0.06)
    robot.says(repr(robot.model.joints[4]), "differs by -0.25 rad", "safety.joint_mismatch")


def test_largest_joint_speeds_and_time_of_frozen_values(robot_of, changed):
    settings, model = robot_of("go2")
    limits = np.array([0.0, 1e-3, 0.5, 1.0, 20.0, 1e6, *model.velocity_limits[6:]])
    found = joint_speed_limits(SimpleNamespace(velocity_limits=limits), 5.0)
    np.testing.assert_allclose(found[:6], [1000.0, 5.0, 5.0, 5.0, 100.0, 1000.0])
    for timeout, frozen_time in ((0.05, 0.1), (0.5, 0.5)):
        watch = StateWatch(model, changed(settings, {"safety": {"state_timeout": timeout}}).safety)
        assert watch._joint_values._limit == frozen_time


@pytest.mark.parametrize("jump", [-1.0, 0.25, 3.2])
def test_a_joint_that_jumps_is_named(body, jump):
    robot = body(steps=10)
    robot.q[joint(robot.model, 4)[0]] += jump
    robot.step()
    name = robot.model.joints[4]
    robot.says(f"joint {name!r}: the position differs by {jump:.3g} rad", "limit 0.2, safety.joint_mismatch")


def test_what_has_led_to_a_fault_is_forgotten(body):
    """After an implausible velocity the next state is accepted."""
    robot = body()
    place, v = joint(robot.model, 4)
    robot.v[:] = 0.01
    robot.step(10)
    robot.q[place] += 0.3
    robot.step()
    robot.says("safety.joint_mismatch")
    robot.step()
    assert robot.supervisor._watch.fault is None
    robot.v[v], dead = 3.0, replacing(q={place: robot.q[place]})
    watch, doubts = robot.supervisor._watch, []
    for _ in range(8):
        robot.step(sensed=dead)
        doubts.append(watch.fault is not None)
    assert doubts == [False] * 5 + [True] + [False] * 2  # 3 mm and then 6 mm a period, 30 mm in all


def test_a_fault_of_the_inputs_counts_before_one_of_the_state(body):
    late = Fault("STALE_INPUT", "odom is 60 ms old (limit 50 ms)")
    for absurd in (0.0, 1e7):
        robot = body(steps=10)
        state = RobotState(robot.stamp + 2_000_000, robot.q + absurd, robot.v)
        robot.supervisor.step(robot.now + PERIOD, state, robot.v[robot.model.v_index], late, None)
        assert (robot.mode, robot.supervisor.fault) == (Mode.DAMPING, late)


@pytest.mark.parametrize(
    ("dead", "speed", "count", "said"),
    [
        ("velocity", 2.0, 200, ("safety.joint_mismatch",)),
        ("position", 0.5, 40, ("the position is constant", "0.03, safety.frozen_motion")),
    ],
)
def test_a_joint_whose_velocity_or_position_is_dead_is_named(body, dead, speed, count, said):
    robot = body()
    place, v = joint(robot.model, 4)
    robot.v[v] = speed
    robot.step(count, sensed=replacing(v={v: 0.0}) if dead == "velocity" else replacing(q={place: robot.q[place]}))
    robot.says(f"joint {robot.model.joints[4]!r}: ", *said)


@pytest.mark.parametrize(
    ("what", "places", "speeds"),
    [("the joint states", slice(7, None), slice(6, None)), ("the base's pose and twist", slice(0, 7), slice(0, 6))],
)
def test_values_that_are_frozen_under_fresh_stamps_are_named(body, what, places, speeds):
    robot, rng = body(), np.random.default_rng(0)
    kept = {}

    def frozen(q, v):
        kept.setdefault("q", q[places].copy()), kept.setdefault("v", v[speeds].copy())
        q[places], v[speeds] = kept["q"], kept["v"]
        return q, v

    for count in (45, 10):
        assert robot.mode is Mode.ACTIVE
        for _ in range(count):
            robot.v = rng.normal(0.0, 1e-3, robot.model.nv)
            robot.step(sensed=frozen)
    robot.says(f"{what} have repeated for 102 ms", "limit 100 ms, safety.frozen_time")


@pytest.mark.parametrize(("axis", "jump"), [(0, 1.0), (1, -0.15), (2, 0.12), (3, 0.4)])
def test_odometry_that_jumps_is_a_fault(body, axis, jump):
    robot = body(steps=10)
    if axis < 3:
        robot.q[axis] += jump
        said = "xyz"[axis], f"{jump:.3g} m", "limit 0.1, safety.base_mismatch"
    else:
        robot.q[3:7] = [np.sin(jump / 2.0), 0.0, 0.0, np.cos(jump / 2.0)]
        said = "base rotation about x", "0.4 rad", "limit 0.2, safety.base_turn_mismatch"
    robot.step()
    robot.says(*said)
    assert (np.abs(robot.commands[-1].tau - robot.commands[-2].tau) <= 0.2 * robot.model.effort_limits + 1e-9).all()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("place", "value", "key"),
    [(8, 500.0, "joint_speed"), (0, 25.0, "base_speed"), (4, 60.0, "base_turn"), (8, 1e200, "joint_speed")],
)
def test_velocities_out_of_range(body, place, value, key, sign):
    robot = body(steps=10)
    command = robot.step(sensed=replacing(v={place: sign * value}))
    robot.says(f"{sign * value:.3g}", f"safety.max_{key}")
    assert np.isfinite(command.tau).all()


@pytest.mark.parametrize("value", [1e7, -1e200, np.inf, np.nan])
@pytest.mark.parametrize("place", [0, 9])
def test_positions_out_of_range(body, place, value):
    robot = body(steps=10)
    robot.step(sensed=replacing(q={place: value}))
    robot.says(f"value {place} is {value:.3g}", "safety.max_magnitude")
    robot.step()
    robot.supervisor.request("reset", robot.now, None)
    assert robot.supervisor.request("activate", robot.now, None)


def test_activation_is_refused_while_the_state_is_not_plausible(body):
    robot = body()
    robot.supervisor.request("damp", robot.now, None)
    robot.supervisor.request("reset", robot.now, None)
    robot.step(velocity=None, sensed=lambda q, v: (q, v + 1e3))
    with pytest.raises(InputRefused, match=r"'activate' is refused: .* has the velocity 1e\+03"):
        robot.supervisor.request("activate", robot.now, None)


@pytest.mark.parametrize(("damping", "speed"), [(2.0, 1.0), (100.0, 0.01)])
def test_plausible_velocities_are_damped_as_a_sampled_loop_can_bear(body, damping, speed):
    robot = body(damping=damping)
    robot.step(100)
    robot.supervisor.request("damp", robot.now, None)
    speeds = np.full(robot.model.nj, speed)
    speeds[3] = -1e6
    robot.step(10, velocity=speeds)
    D = stable_damping(robot.model, damping, PERIOD)
    assert (D.max() < 50.0) if damping > 50.0 else (damping == D).all()
    np.testing.assert_allclose(robot.commands[-1].tau, -D * np.where(speeds > 0.0, speed, 0.0))
