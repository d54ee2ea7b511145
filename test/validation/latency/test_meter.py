"""Assignment of torques to states, and late states, for given times."""

from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.middleware.codec import encode, torques
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, counterpart, endpoints
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.validation.latency import meter
from wbc_controller.validation.latency.meter import Meter, RoundTrips, joined, round_trips

PERIOD = 0.002


def stamp(number):
    return 100, number


def trips(sent, efforts, commands, period=PERIOD):
    """States and commands: pairs of a time in ms and a number; efforts: times in ms."""
    return round_trips(
        [(1e-3 * when, stamp(number)) for when, number in sent],
        [1e-3 * when for when in efforts],
        [(1e-3 * when, stamp(number)) for when, number in commands],
        period,
    )


THREE = [(0, 1), (2, 2), (4, 3)]


@pytest.mark.parametrize(
    ("sent", "efforts", "commands", "seconds", "late"),
    [
        pytest.param(THREE, [0.9, 2.8, 4.7], [(1.0, 1), (2.9, 2), (4.8, 3)], [0.9, 0.8, 0.7], 0, id="in time"),
        # The torques of the first state arrive after the second state.
        pytest.param(THREE, [2.5, 5.0], [(2.6, 1), (5.1, 2)], [2.5, 3.0, np.inf], 3, id="longer than the period"),
        pytest.param(THREE, [1.0, 5.0], [(1.1, 1), (5.1, 3)], [1.0, np.inf, 1.0], 1, id="a state is left out"),
        pytest.param(THREE[:2], [1.0], [(1.1, 1), (3.3, 2)], [1.0, 1.3], 0, id="lost torques: the command counts"),
        pytest.param(THREE[:2], [1.0, 2.2, 3.0], [(1.1, 1), (3.1, 2)], [1.0, 1.0], 0, id="torques of another node"),
        pytest.param(THREE, [1.1, 3.1, 5.1], [(1.0, 1), (3.0, 2), (5.0, 3)], [1.0] * 3, 0, id="a command comes first"),
        pytest.param(THREE[:1], [1.0, 60.0], [(1.1, 1), (60.1, 1)], [1.0], 0, id="two commands with one stamp"),
        pytest.param(THREE[1:2], [0.5, 3.0], [(0.6, 1), (3.1, 2)], [1.0], 0, id="a command for an older state"),
    ],
)
def test_following_command_assigns_torques_to_a_state(sent, efforts, commands, seconds, late):
    found = trips(sent, efforts, commands)
    np.testing.assert_allclose(found.seconds, np.array(seconds) * 1e-3)
    assert (found.late, found.unanswered) == (late, seconds.count(np.inf))


def test_delays_and_quantiles_of_joined_blocks():
    for seconds, late in ((PERIOD, 0), (np.nextafter(PERIOD, 1.0), 1), (np.inf, 1), (np.nan, 1)):
        assert RoundTrips(np.array([0.001, seconds]), np.zeros(1), PERIOD).late == late
    found = RoundTrips(np.array([np.inf, *np.arange(1.0, 1001.0)]), np.zeros(1000), PERIOD)
    assert found.quantiles == (501.0, 991.0, 1000.0)
    assert np.isnan(RoundTrips(np.array([np.inf]), np.zeros(0), PERIOD).quantiles).all()
    found = trips([(0, 1), (2, 2), (7, 3), (8, 4)], [], [])
    np.testing.assert_allclose(found.delays, [0.0, 3.0e-3, 0.0], atol=1e-12)
    first = trips([(0, 1), (2, 2)], [1.0], [(1.1, 1)])
    second = trips([(1000, 3), (1003, 4)], [1001.0], [(1001.1, 3)])
    both = joined([first, second])
    np.testing.assert_allclose(both.seconds, [1e-3, np.inf, 1e-3, np.inf])
    np.testing.assert_allclose(both.delays, [0.0, 1e-3], atol=1e-12)
    assert both.period == PERIOD


def test_measurements_are_independent(make, monkeypatch):
    by_key = {topic.key: topic for topic in endpoints(CONTROLLER_TOPICS, "wbc_controller")}
    bus, now = MemoryBus(), [0.0]
    robot, other = Meter(MemoryTransport(bus)), MemoryTransport(bus)
    heard = []
    effort, commands = (other.advertise(by_key[key]) for key in ("effort", "joint_commands"))
    publish = robot.advertise(counterpart(by_key["joint_states"]))
    for key in ("effort", "joint_commands"):
        robot.subscribe(counterpart(by_key[key]), heard.append)

    def state(time):
        return encode(make.joint_state([], [], time=time))

    def at(time, send, payload):
        now[0] = time
        send(payload)

    def pass_time(seconds):
        if seconds == 0.1:  # time for the last torques
            at(9.0, publish, state(4))
            return
        for k in (1, 2, 3):
            at(k, publish, state(k))
            at(k + 0.1 * k, effort, encode(torques(np.zeros(3))))
            at(k + 0.5, commands, state(k))

    monkeypatch.setattr(meter, "time", SimpleNamespace(perf_counter=lambda: now[0], sleep=pass_time))
    for _ in range(2):
        np.testing.assert_allclose(robot.measure(5.0, 1.0)().seconds, [0.1, 0.2, 0.3])
    assert len(heard) == 12
    assert robot.answered
