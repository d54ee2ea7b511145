"""From received messages to one latched state, requests and changes."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from peer import Peer

from wbc_controller.controller.build.robot import make_model
from wbc_controller.errors import ConfigurationError
from wbc_controller.estimation.joint_velocity import delay
from wbc_controller.inverse_dynamics.references.changes import EnableTask, SetWeight
from wbc_controller.middleware import decoding
from wbc_controller.middleware.stamps import StampTracker
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes import requests
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.wiring import controller_endpoints, make_vocabulary

NAN = float("nan")


class Wire(Peer):
    """`Inputs`, and a publisher."""

    def __init__(self, settings, model, q, make):
        self.model, self.q, self.clock, self.make = model, q, ManualClock(50.0), make
        bus, topics, vocabulary = MemoryBus(), controller_endpoints(settings, model), make_vocabulary(settings, model)
        self.inputs = Inputs(settings, model, {}, vocabulary, topics, MemoryTransport(bus), self.clock)
        super().__init__(bus, topics)

    def state(self, velocity=0.0, time=None):
        """Send a good state."""
        model, time = self.model, round(self.clock.time * 1e9) if time is None else time
        self.send("odom", self.make.odom(self.q[:7], [velocity] * 6, model.base_link, time))
        position, speeds = self.q[model.q_index], [velocity] * model.na
        self.send("joint_states", self.make.joint_state(model.joints, position, speeds, time=time))


@pytest.fixture
def go2(robot_of, stance_of, make):
    return Wire(*robot_of("go2"), stance_of("go2"), make)


def test_no_state_without_all_parts(go2, make):
    latched = go2.inputs.latch()
    assert latched.state is None
    assert latched.joint_velocity is None
    assert latched.ages == {"joint_states": np.inf, "odom": np.inf}
    assert not latched.refused
    assert not go2.inputs.wait(0.0)
    model = go2.model
    go2.send("joint_states", make.joint_state(model.joints, np.zeros(model.na), np.ones(model.na)))
    assert go2.inputs.wait(0.0)
    latched = go2.inputs.latch()
    assert latched.state is None  # without the base
    np.testing.assert_array_equal(latched.joint_velocity, np.ones(model.na))
    assert not go2.inputs.wait(0.0)


def test_after_a_bad_joint_state_the_last_good_one_stays_and_ages(go2, make):
    go2.state()
    before = go2.inputs.latch().state
    go2.clock.time += 0.01
    model, bad = go2.model, np.zeros(go2.model.na)
    bad[2] = NAN
    go2.send("joint_states", make.joint_state(model.joints, bad, np.zeros(model.na)))
    latched = go2.inputs.latch()
    (sentence,) = latched.refused
    said = f"position of '{model.joints[2]}' is nan"
    assert sentence.startswith(f"/joint_states: {said}")
    assert said in go2.inputs.notes()["joint_states"]
    np.testing.assert_array_equal(latched.state.q, before.q)
    assert latched.state.stamp == before.stamp
    assert latched.ages["joint_states"] == pytest.approx(0.01)
    go2.state(velocity=0.5)
    latched = go2.inputs.latch()
    assert not latched.refused
    assert not go2.inputs.notes()
    assert latched.ages["joint_states"] == 0.0
    assert (latched.joint_velocity == 0.5).all()


@pytest.mark.parametrize("key", ["joint_states", "odom", "command", "update"])
@pytest.mark.parametrize("payload", [b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 40])
def test_bytes_that_are_no_message_are_refused(go2, key, payload):
    go2.state()
    go2.inputs.latch()
    go2.send_bytes(key, payload)
    latched = go2.inputs.latch()
    (sentence,) = latched.refused
    assert f"{len(payload)} bytes are not a " in sentence
    assert latched.state is not None


def test_excess_requests_are_counted_and_reported(go2, make):
    for i in range(130):
        go2.send("command", make.string(f" {i} \n"))
    latched = go2.inputs.latch()
    assert latched.refused == ("/wbc_controller/command: 30 messages dropped: more than 100 requests at once",)
    words = list(latched.requests.commands)
    assert len(words) == 20  # the number of requests per cycle is limited
    while latched.requests.commands:
        latched = go2.inputs.latch()
        assert not latched.refused
        words += latched.requests.commands
    assert words == [str(i) for i in range(100)]


@pytest.mark.parametrize("reader", [True, False])
def test_between_threads_no_request_is_lost_unsaid(go2, make, reader):
    """With concurrent threads for sending, reading and latching, each request is taken once, in order, or counted."""
    sent, taken, counted = 1000, [], 0
    if reader:
        go2.inputs.requests.start_reader()

    def write():
        for i in range(sent):
            go2.send("command", make.string(str(i)))

    thread = threading.Thread(target=write)
    thread.start()
    deadline = time.monotonic() + 60.0
    while len(taken) + counted < sent and time.monotonic() < deadline:
        latched = go2.inputs.latch()
        taken += [int(word) for word in latched.requests.commands]
        counted += sum(int(sentence.split(": ")[1].split()[0]) for sentence in latched.refused)
    thread.join()
    go2.inputs.requests.stop_reader()
    assert len(taken) + counted == sent
    assert taken == sorted(set(taken))


def test_requests_on_several_topics_come_in_the_order_of_their_arrival(go2, make):
    go2.send("update", make.string("{tasks: {com: {enabled: true, weight: 3}}}"))
    go2.clock.time += 1e-4
    go2.send("task_enable", make.bool(False), "com")
    go2.clock.time += 1e-4
    go2.send("weight", make.float64(4), "com")
    assert go2.inputs.latch().requests.changes == (
        (EnableTask("com", True), SetWeight("com", 3.0)),
        (EnableTask("com", False),),
        (SetWeight("com", 4.0),),
    )


def test_a_refused_state_or_request_names_its_topic(go2, make):
    go2.state()
    go2.send("odom", make.odom(go2.q[:7], [NAN] * 6, go2.model.base_link, 51_000_000_000))
    go2.send("weight", make.float64(NAN), "com")
    go2.send("weight", make.float64(2), "posture")
    go2.send("setpoint", make.point([0, 0, 0], "moon"), "com")
    go2.send("update", make.string("{tasks: {comm: {weight: 1}}}"))
    latched = go2.inputs.latch()
    assert latched.requests.changes == ((SetWeight("posture", 2.0),),)
    assert [sentence.split(": ")[0] for sentence in latched.refused] == [
        "/odom",
        "/wbc_controller/tasks/com/weight",
        "/wbc_controller/tasks/com/setpoint",
        "/wbc_controller/update",
    ]
    assert "did you mean 'com'? Valid: base, com, posture" in latched.refused[3]


def test_changes_of_settings_are_prepared_on_the_reader_thread(go2, make):
    prepared = []

    def prepare(change):
        prepared.append(change.settings)
        if "safety" in change.settings:
            raise ConfigurationError("not while it runs")

    go2.inputs.requests._prepare = prepare
    go2.send("update", make.string("{control: {weight_ramp: 0.9}}"))
    go2.send("update", make.string("{safety: {damping: 1.0}}"))
    latched = go2.inputs.latch()
    assert prepared == [{"control": {"weight_ramp": 0.9}}, {"safety": {"damping": 1.0}}]
    assert len(latched.requests.changes) == 1
    assert latched.refused == ("/wbc_controller/update: not while it runs",)


def test_a_long_refusal_is_cut(go2, make):
    go2.send("setpoint", make.joint_state(["x" * 100_000], [0.0]), "posture")
    (sentence,) = go2.inputs.latch().refused
    assert len(sentence) < 1100
    assert sentence.endswith("…")


def test_a_message_that_finds_a_defect_is_refused_and_logged(go2, make, monkeypatch, caplog):
    def broken(vocabulary, subject, content):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(decoding, "READERS", {**decoding.READERS, "weight": broken})
    go2.state()
    go2.send("weight", make.float64(1), "com")
    latched = go2.inputs.latch()
    assert latched.refused == (
        "/wbc_controller/tasks/com/weight: cannot be decoded: ZeroDivisionError: division by zero",
    )
    assert latched.state is not None
    assert "Traceback" in caplog.text


@pytest.fixture(scope="module", params=["floating", "fixed"])
def robot(request, robot_of, changed):
    """Settings and model of Go2 on a floating or fixed base."""
    own = changed(robot_of("go2")[0], {"robot": {"base": request.param}})
    return own, make_model(own)


#: Messages (None: no message), errors of their stamps, and advances of the clock before a cycle, s.
KINDS = ("good", "good", "good", None, "other shape", "not finite", "bad quaternion")
ERRORS, ADVANCES = (0.0, 0.0, 0.0, -0.0003, 0.02, -0.01, 0.4, -5.0), (0.002, 0.002, 0.002, 0.0, 0.04, 0.4)
#: Settings that accept random samples as plausible.
LENIENT = {
    "joint_mismatch": 100.0, "base_mismatch": 100.0, "base_turn_mismatch": 10.0,
    "max_joint_speed": 100.0, "max_base_speed": 1000.0, "max_base_turn": 1000.0,
}  # fmt: skip


@pytest.mark.parametrize("tolerance", [None, 0.015])
@pytest.mark.parametrize("seed", range(20))
def test_the_state_is_that_of_the_newest_accepted_messages(robot, stance_of, make, changed, tolerance, seed):
    own, model = robot
    random = np.random.default_rng(seed)
    arrivals = [(random.choice(KINDS), random.choice(ERRORS)) for _ in range(80)]
    cycles = list(zip(arrivals[::2], arrivals[1::2], random.choice(ADVANCES, 40), strict=True))
    clocks = {} if tolerance is None else {"synchronized_clocks": True, "clock_tolerance": tolerance}
    wire = Wire(changed(own, {"safety": LENIENT | clocks}), model, stance_of("go2"), make)
    keys = ("joint_states", "odom") if model.floating_base else ("joint_states",)
    ahead = None if tolerance is None else lambda: 0.0
    trackers, newest = {key: StampTracker(ahead, tolerance or 0.0) for key in keys}, {}
    for number, (odometry, joints, passed) in enumerate([(("good", 0.0),) * 2 + (0.002,)] * 3 + cycles):
        wire.clock.time += passed
        if number == len(cycles):  # new time after a restart of the simulator
            wire.inputs.restart()
            trackers = {key: StampTracker(ahead, tolerance or 0.0) for key in keys}
        numbers = {"odom": np.concatenate([stance_of("go2")[:7] + random.normal(0.0, 0.01, 7), random.normal(size=6)])}
        numbers["odom"][3:7] /= np.linalg.norm(numbers["odom"][3:7])
        numbers["joint_states"] = random.normal(size=2 * model.na)
        refused = 0
        for key, (kind, off) in (("odom", odometry), ("joint_states", joints)):
            if kind is None:
                continue
            time, values = round((wire.clock.time + off) * 1e9), numbers[key]
            if kind == "not finite":
                values[random.integers(7, len(values))] = NAN
            if kind == "bad quaternion" and key == "odom":
                values[3:7] *= 1.5
            if key == "odom":
                child = "" if kind == "other shape" else model.base_link
                wire.send("odom", make.odom(values[:7], values[7:], child, time))
            else:
                order = slice(None, None, -1 if kind == "other shape" else 1)
                position, velocity = values.reshape(2, -1)[:, order].copy()
                wire.send("joint_states", make.joint_state(model.joints[order], position, velocity, time=time))
            valid = np.isfinite(values).all() and (key != "odom" or kind != "bad quaternion")
            if key in keys and valid and trackers[key].refusal(time, wire.clock.time) is None:
                trackers[key].accept(time, wire.clock.time)
                newest[key] = time, values
            else:
                refused += key in keys
        latched = wire.inputs.latch()
        assert len(latched.refused) == refused
        assert latched.ages == {key: tracker.age(wire.clock.time) for key, tracker in trackers.items()}
        assert latched.clock_stall == max(tracker.clock_stall for tracker in trackers.values())
        if set(newest) < set(keys):
            assert latched.state is None
            continue
        stamp, values = newest["joint_states"]
        measured = (newest["odom"][1][:7], newest["odom"][1][7:]) if model.floating_base else ()
        q, v = model.state(*values.reshape(2, -1), *measured)
        assert latched.state.stamp == stamp
        np.testing.assert_allclose(latched.state.q, q, rtol=0.0, atol=1e-15)
        np.testing.assert_array_equal(latched.state.v, v)
        np.testing.assert_array_equal(latched.joint_velocity, values[model.na :])
        assert not latched.state.q.flags.writeable
        assert not latched.state.v.flags.writeable


@pytest.mark.parametrize(
    ("key", "subject", "largest"),
    [("joint_states", "", 1 << 18), ("odom", "", 1 << 16), ("trajectory", "com", 1 << 20), ("command", "", 1 << 18)],
)
def test_each_topic_has_its_largest_message(go2, key, subject, largest):
    go2.send_bytes(key, b"\x00" * (largest + 1), subject)
    (sentence,) = go2.inputs.latch().refused
    assert sentence.endswith(f": 1 messages dropped: more than {largest} bytes")
    go2.send_bytes(key, b"\x00" * largest, subject)
    assert "more than" not in go2.inputs.latch().refused[0]


def test_an_oversized_message_neither_wakes_nor_displaces(go2):
    go2.state()
    go2.send_bytes("joint_states", b"\x00" * ((1 << 18) + 1))
    assert go2.inputs.wait(0.0)
    latched = go2.inputs.latch()
    assert latched.state is not None
    assert [": 1 messages dropped" in sentence for sentence in latched.refused] == [True]
    go2.send_bytes("joint_states", b"\x00" * ((1 << 18) + 1))
    assert not go2.inputs.wait(0.01)


def test_states_before_the_start_are_dropped(go2):
    go2.state()
    assert go2.inputs.wait(0.0)
    go2.state(time=2_000_000_000)
    go2.inputs.discard_pending()
    latched = go2.inputs.latch()
    assert latched.state is None
    assert latched.ages == {"joint_states": np.inf, "odom": np.inf}


def test_wake_and_an_emergency_stop_end_the_wait(go2, make):
    go2.inputs.wake()
    assert go2.inputs.wait(0.0)
    assert not go2.inputs.wait(0.0)
    go2.send("command", make.string("activate"))
    assert not go2.inputs.wait(0.0)
    go2.send("command", make.string("estop"))
    assert go2.inputs.wait(0.0)


@pytest.mark.parametrize("stalled", [0.0, 0.5])
def test_the_reader_leaves_the_loop_three_quarters_of_the_processor_time(go2, make, monkeypatch, stalled):
    slept, done = [], threading.Event()

    def reader(*words):
        time.sleep(stalled)  # as a thread without a processor
        began = time.thread_time()
        while time.thread_time() < began + 0.02:
            pass
        return ()

    def sleep(seconds):
        slept.append(seconds)
        done.set()

    monkeypatch.setattr(decoding, "READERS", {**decoding.READERS, "weight": reader})
    monkeypatch.setattr(requests, "time", SimpleNamespace(thread_time=time.thread_time, sleep=sleep))
    go2.inputs.requests.start_reader()
    go2.send("weight", make.float64(1), "com")
    assert done.wait(20.0)
    go2.inputs.requests.stop_reader()
    assert 0.06 <= slept[0] <= 0.2


def test_differentiated_velocities(robot_of, changed, stance_of, make):
    own, model = robot_of("go2")
    filtered = {"estimation": {"joint_velocity": "differentiated", "joint_velocity_time": 0.004}}
    wire = Wire(changed(own, filtered), model, stance_of("go2"), make)
    speed = np.linspace(-1.0, 1.0, model.nj)
    for i in range(50):
        stamp = 1_000_000_000 + 2_000_000 * i
        wire.clock.time += 0.002
        wire.send("odom", make.odom(wire.q[:7], [0.0] * 6, model.base_link, stamp))
        position = wire.q[model.q_index] + 0.002 * i * speed
        wire.send("joint_states", make.joint_state(model.joints, position, [], time=stamp))
        latched = wire.inputs.latch()
        assert not latched.refused
    np.testing.assert_allclose(latched.state.v[model.v_index], speed, atol=1e-6)
    np.testing.assert_allclose(latched.joint_velocity, speed, atol=1e-6)
    assert wire.inputs.status() == {"joint_velocity": f"differentiated, delay {delay(0.004, 0.002):.4f} s"}
